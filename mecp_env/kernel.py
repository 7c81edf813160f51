"""One decorator for every compiled kernel: numba in nopython mode, cached on disk where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from mecp_env.kernel_cache import cache_for

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """`function` compiled on its first call, or taken from the cache; without a cache, compiled in every process."""
    compiled = numba.njit(nogil=True)(function)
    if hasattr(compiled, "_cache"):  # NUMBA_DISABLE_JIT hands back the function itself
        compiled._cache = cache_for(function)
    return compiled  # type: ignore[no-any-return]
