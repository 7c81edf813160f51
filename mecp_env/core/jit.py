"""One decorator for every compiled kernel: numba in nopython mode, cached on disk where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from mecp_env.core.jit_cache import cache_for

F = TypeVar("F", bound=Callable[..., Any])

SHARED = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}  # no test for 0 before every division
OPTIONS = {"nopython": True, **SHARED}
TESTED_NUMBA = ("0.68.",)  # `kernel_compiler` leans on the inside of numba; with any other version it stays out


def compiled(function: F) -> F:
    """`function` compiled on its first call, or taken from the cache; without a cache, compiled in every process."""
    if numba.config.DISABLE_JIT:
        return function
    dispatcher = _dispatcher(function)
    dispatcher._cache = cache_for(function)
    return dispatcher  # type: ignore[no-any-return]


def _dispatcher(function: Callable[..., Any]) -> Any:
    if not numba.__version__.startswith(TESTED_NUMBA):
        return numba.njit(**SHARED)(function)
    from mecp_env.core.jit_compiler import Kernel, KernelCompiler

    return Kernel(function, targetoptions=OPTIONS, pipeline_class=KernelCompiler)
