"""One decorator for every compiled kernel: numba in nopython mode, cached on disk where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """`function` compiled on first call; without a writable cache directory it is compiled in every process."""
    try:
        return numba.njit(cache=True, nogil=True)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # no writable cache location
        return numba.njit(cache=False, nogil=True)(function)  # type: ignore[no-any-return]
