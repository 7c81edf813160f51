"""The cache of compiled functions on disk.

numba's own cache has four weak points: it fails at import where nothing can be written; a truncated file in it raises
at every start until it is deleted; damaged machine code ends the process; and a function is not compiled again when a
function that it calls, or a constant that it uses, changed in another file. So this cache is in the user's own cache
directory (or NUMBA_CACHE_DIR), every entry carries a checksum, a damaged one is compiled again, and the key of an
entry covers everything that the function uses (jit_key.py). It is never in a shared temporary directory: an entry is
a pickle, and reading one that another user wrote would run that user's code.

An entry is one file per function and argument types. A function that was compiled as part of a caller is part of the
caller's entry and has none of its own, unless Python calls it too (warm_up.py lists those).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numba
from llvmlite import binding
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, NullCache, _CacheLocator
from numba.core.codegen import JITCodeLibrary

from mecp_env.core.jit_key import fingerprint
from mecp_env.core.warm_up_list import called_from_python

KEPT_DAYS = 30  # entries not written for so long are removed when something is compiled
DIGEST_BYTES = 32
ABOUT = "mecp_env: compiling functions; this happens once and takes about a minute"

log = logging.getLogger(__name__)


def cache_directory() -> Path:
    """Where compiled functions are kept: below NUMBA_CACHE_DIR, or else in the user's own cache directory."""
    version = f"py{sys.version_info[0]}{sys.version_info[1]}-numba{numba.__version__}"
    return Path(numba.config.CACHE_DIR or _user_cache()) / "mecp_env_functions" / version


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def cache_for(function: Callable[..., Any]) -> NullCache:
    """The cache of one function: on disk, or none where there is no place for it."""
    return _FunctionCache(function) if usable(cache_directory()) else _NoCache()


@functools.cache
def usable(directory: Path) -> bool:
    """True when `directory` exists or can be made, belongs to this user, and can be written to."""
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
        ours = is_private(directory)
    except OSError:
        ours = False
    if not ours:
        log.warning("mecp_env: no cache in %s: functions are compiled in every process", directory)
    return ours


def is_private(directory: Path) -> bool:
    """True when no other user but the administrator can put a file into `directory`, or another folder in its place.

    Folders above it may be writable to all where only the owner of a file removes it, as in a temporary directory.
    Raises `OSError`.
    """
    if not hasattr(os, "getuid"):
        return True
    place = directory.resolve()
    return owned(place, shared=False) and all(owned(above, shared=True) for above in place.parents)


def owned(folder: Path, shared: bool) -> bool:
    """True when a folder is this user's or the administrator's and no other can change it; `shared`: except add."""
    about = folder.stat()
    own_group = about.st_gid == os.getgid() == os.getuid()  # the group of one user, whose number is that of the user
    open_to = about.st_mode & (stat.S_IWOTH | (0 if own_group else stat.S_IWGRP))
    return about.st_uid in (os.getuid(), 0) and (not open_to or (shared and bool(about.st_mode & stat.S_ISVTX)))


_announced: list[str] = []  # what this process wrote, at most one line


def announce(line: str = ABOUT) -> None:
    """Write once per process that functions are compiled, and remove entries that were not written for long."""
    if _announced:
        return
    _announced.append(line)
    log.warning(line)
    for entry in cache_directory().glob("*.nbc"):
        with contextlib.suppress(OSError):  # another process was faster
            _remove_old(entry)


def _remove_old(entry: Path) -> None:
    if entry.stat().st_mtime < time.time() - KEPT_DAYS * 86_400:
        entry.unlink()


@functools.cache
def entry_name(function: Callable[..., Any]) -> str:
    """The name that the files of a function begin with."""
    return f"{function.__module__}.{function.__name__}-{fingerprint(function)}"


def is_cached(function: Callable[..., Any], names: list[str]) -> bool:
    """True when one of the file `names` is an entry of the function."""
    return any(name.startswith(entry_name(function)) for name in names)


class _NoCache(NullCache):  # type: ignore[misc]
    """No place to keep anything: every function is compiled, and the first one announces it."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        announce()


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Tells numba where the entry of a function is and what it depends on."""

    def __init__(self, function: Callable[..., Any], path: str) -> None:
        self._py_file = path  # numba names it in a warning
        self._name = entry_name(function)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(cache_directory())

    def get_source_stamp(self) -> str:
        return self._name

    def get_disambiguator(self) -> str:
        return self._name


class _EntryFile(IndexDataCacheFile):  # type: ignore[misc]
    """One file per argument types, behind a checksum: damaged machine code would end the process, not raise."""

    def save(self, key: Any, data: Any) -> None:
        body = self._dump((key, data))
        with self._open_for_write(self._path(key)) as file:
            file.write(hashlib.sha256(body).digest() + body)

    def load(self, key: Any) -> Any:
        """What was saved under the key; None where there is nothing. Raises `UnpicklingError` for a damaged file."""
        try:
            content = own_bytes(Path(self._path(key)))
        except FileNotFoundError:
            return None
        digest, body = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
        if hashlib.sha256(body).digest() != digest:
            raise pickle.UnpicklingError("wrong checksum")
        saved, data = pickle.loads(body)
        return data if saved == key else None

    def _path(self, key: Any) -> str:
        words = hashlib.sha256(str(key).encode()).hexdigest()[:16]
        return str(Path(self._cache_path) / f"{self._source_stamp}-{words}.nbc")


def own_bytes(path: Path) -> bytes:
    """The content of a file of this user or the administrator. Raises `PermissionError` for that of another user."""
    with path.open("rb") as file:
        about = os.fstat(file.fileno())
        if hasattr(os, "getuid") and about.st_uid not in (os.getuid(), 0):
            raise PermissionError(f"{path} belongs to another user")
        return file.read()


class _LoadedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Machine code from the cache; its intermediate code is parsed when a caller is compiled that links it in."""

    bitcode: bytes

    def _get_module_for_linking(self) -> Any:
        return binding.parse_bitcode(self.bitcode)


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """The loaded function, without what numba would keep of it for callers and for inspection."""
        found = super().rebuild(target_context, payload)
        _, _, (_, found.library.bitcode) = payload[0]
        found.library._shared_module = None
        found.library.__class__ = _LoadedLibrary
        return found._replace(type_annotation="")


class _Entries(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, with our place, our key and our checksum."""

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _EntryFile(str(cache_directory()), "", entry_name(function))


class _FunctionCache(NullCache):  # type: ignore[misc]
    """The cache of one function; a damaged entry counts as missing, and one that cannot be saved is not needed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @functools.cached_property
    def _entries(self) -> _Entries:
        """Made at the first call: what the function uses may be defined after it."""
        return _Entries(self._function)

    @property
    def cache_path(self) -> str:
        return str(cache_directory())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = self._entries.load_overload(sig, target_context)
        except Exception as error:  # unpickling damaged bytes can raise anything
            log.info("%s: damaged cache entry (%r)", self._function, error)
            found = None
        if found is None:
            announce()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        if within_another_compilation(sys._getframe(1)) and not called_from_python(self._function):
            return  # it is part of its caller's entry
        try:
            self._entries.save_overload(sig, data)
        except Exception as error:  # disk full, directory gone, another numba
            log.info("%s: not cached (%r)", self._function, error)


def within_another_compilation(frame: FrameType) -> bool:
    """True when the function of `frame`, numba's `compile`, runs further up the stack, too."""
    compile_code, above = frame.f_code, frame.f_back
    while above is not None and above.f_code is not compile_code:
        above = above.f_back
    return above is not None
