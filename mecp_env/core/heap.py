"""Memory that was freed but that the C library keeps for later: glibc returns it to the system, or keeps more of it."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h


def trim() -> None:
    """Return freed memory to the system; nothing happens where the C library cannot."""
    _function("malloc_trim")(0)


def keep() -> None:
    """Keep what is freed from now on, so that large arrays are not taken from the system and cleared each time."""
    for option, size in ((M_MMAP_THRESHOLD, 2**25), (M_TRIM_THRESHOLD, 2**30)):  # of the first no more is allowed
        _function("mallopt")(option, size)


@functools.cache
def _function(name: str) -> Callable[..., int]:
    """A function of the C library; one that does nothing where there is no such function."""
    try:
        function: Callable[..., int] = getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return lambda *_: 0
    return function
