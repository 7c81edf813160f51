"""One decorator for every compiled function: numba in nopython mode, cached on disk where that is possible."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

try:
    from mecp_env.core.jit_cache import cache_for
    from mecp_env.core.jit_dispatcher import LeanDispatcher
except ImportError:  # another numba keeps its cache elsewhere
    cache_for = None  # type: ignore[assignment]

CHECKED_CACHE = cache_for is not None  # False: numba's own cache
DISPATCHERS: list[Any] = []  # of all compiled functions

F = TypeVar("F", bound=Callable[..., Any])

# no wrapper for C, no test for 0 before every division
OPTIONS = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}


def compiled(function: F) -> F:
    """`function` compiled on its first call, or taken from the cache; without a cache, compiled in every process."""
    if numba.config.DISABLE_JIT:
        return function
    if CHECKED_CACHE:
        dispatcher: Any = LeanDispatcher(function, OPTIONS)
        dispatcher._cache = cache_for(function)
    else:
        dispatcher = with_plain_cache(function)
    DISPATCHERS.append(dispatcher)
    return dispatcher  # type: ignore[no-any-return]


def variants() -> int:
    """How many functions, each for one set of argument types, this process has compiled or loaded so far."""
    return sum(len(dispatcher.signatures) for dispatcher in DISPATCHERS)


def with_plain_cache(function: F) -> F:
    """`function` compiled with numba's own cache, which overlooks a change in another file.

    Each state of the package's source therefore has its own folder. Without a place to write: no cache.
    """
    kept = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(Path(kept or Path.home() / ".cache") / f"mecp_env-{_state_of_source()}")
    try:
        return numba.njit(cache=True, **OPTIONS)(function)  # type: ignore[no-any-return]
    except (RuntimeError, OSError):
        return numba.njit(**OPTIONS)(function)  # type: ignore[no-any-return]
    finally:
        numba.config.CACHE_DIR = kept


@functools.cache
def _state_of_source() -> str:
    digest = hashlib.sha256(f"{sys.version} {numba.__version__}".encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        with contextlib.suppress(OSError):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
