"""One decorator for every compiled kernel: numba in nopython mode, cached on disk where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from mecp_env.kernel_cache import cache_for
from mecp_env.kernel_compiler import Kernel, KernelCompiler

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS = {"nopython": True, "nogil": True, "no_cfunc_wrapper": True}


def kernel(function: F) -> F:
    """`function` compiled on its first call, or taken from the cache; without a cache, compiled in every process."""
    if numba.config.DISABLE_JIT:
        return function
    compiled = Kernel(function, targetoptions=OPTIONS, pipeline_class=KernelCompiler)
    compiled._cache = cache_for(function)
    return compiled
