"""One decorator for every compiled function: `numba.njit`, cached in a folder that is named after the sources.

numba notices an edit in the file of a function, but not in that of a function which it calls; so each state of the
sources has a folder of its own. numba raises for a file that is truncated, a disk that is full or a folder that is
gone, and damaged machine code ends the process; so each function has a folder with a checksum there, and is compiled
again where that does not fit. An entry is a pickle, which runs what it says: only this user may write there.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np

from mecp_env.core.interrupts import interrupts_later

F = TypeVar("F", bound=Callable[..., Any])
OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # no test for 0 before a division
CHECKSUM = "checksum"
NOT_COMPILED = ("cli", "floorplans", "learning", "logs", "policies", "render", "vector")  # folders without any
KEPT = 4  # folders of other sources; the oldest are removed

log = logging.getLogger(__name__)


def compiled(function: F) -> F:
    """`function` compiled on its first call, or taken from the cache; without a cache, compiled in every process."""
    if numba.config.DISABLE_JIT:
        return function
    place = cache_directory()
    dispatcher: Any = _cached(function, place) if usable(place) else numba.njit(**OPTIONS)(function)
    dispatcher.compile = functools.partial(_compile, dispatcher, dispatcher.compile)
    return dispatcher  # type: ignore[no-any-return]


def _cached(function: Callable[..., Any], place: Path) -> Any:
    kept = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(place / f"{function.__module__}.{function.__qualname__}")
    try:
        return numba.njit(cache=True, **OPTIONS)(function)  # which reads the setting now, and never again
    finally:
        numba.config.CACHE_DIR = kept


def _compile(dispatcher: Any, compile_or_load: Callable[[Any], Any], types: Any) -> Any:
    """Compile or load a function for argument types, whatever became of its folder."""
    if types not in dispatcher.signatures:
        with interrupts_later():  # LLVM's bindings would lose one, or end the process
            if dispatcher.stats.cache_path:
                _keep(dispatcher, compile_or_load, types, Path(dispatcher.stats.cache_path))
            return compile_or_load(types)
    return compile_or_load(types)


def _keep(dispatcher: Any, compile_or_load: Callable[[Any], Any], types: Any, folder: Path) -> None:
    if not _is_sound(folder):
        shutil.rmtree(folder, ignore_errors=True)
    for _ in range(2):
        with contextlib.suppress(OSError):  # compiled, but not saved
            compile_or_load(types)
        if types in dispatcher.signatures:
            break
        shutil.rmtree(folder, ignore_errors=True)  # another process wrote at the same time
    if dispatcher.stats.cache_misses:
        with contextlib.suppress(OSError):
            (folder / CHECKSUM).write_bytes(_checksum(folder))


def _is_sound(folder: Path) -> bool:
    try:
        return (folder / CHECKSUM).read_bytes() == _checksum(folder)
    except OSError:
        return False


def _checksum(folder: Path) -> bytes:
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.glob("*.nb?")))).digest()


def cache_directory() -> Path:
    """Where compiled functions are kept: below NUMBA_CACHE_DIR, or else in the user's own cache directory."""
    own = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(numba.config.CACHE_DIR or own).absolute() / "mecp_env_functions" / _sources()


@functools.cache
def _sources() -> str:
    """A name that no other content of the source files has, nor another Python, NumPy or numba."""
    digest = hashlib.sha256(f"{sys.version} {np.__version__} {numba.__version__}".encode())
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0] not in NOT_COMPILED:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def usable(place: Path) -> bool:
    """True when this user can write to `place`, which is made if need be, and no other user can."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=place).close()
        os.utime(place)
        folders = sorted(place.parent.iterdir(), key=lambda folder: folder.stat().st_mtime)
        sound = not hasattr(os, "getuid") or all(map(_is_private, (place, *place.resolve().parents)))
    except OSError:
        folders, sound = [], False
    if not sound:
        log.warning("mecp_env: no cache in %s: functions are compiled in every process", place)
    for folder in folders[: -KEPT - 1]:
        shutil.rmtree(folder, ignore_errors=True)
    return sound


def _is_private(folder: Path) -> bool:
    """True when no other user can put a file there, or, in a shared temporary folder, take another's away."""
    about = folder.stat()
    others = stat.S_IWOTH | (0 if about.st_gid == os.getgid() == os.getuid() else stat.S_IWGRP)
    return about.st_uid in (0, os.getuid()) and bool(not about.st_mode & others or about.st_mode & stat.S_ISVTX)
