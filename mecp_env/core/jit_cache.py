"""Where compiled kernels are kept between two processes.

numba's own cache has four weak points: it fails at import where nothing can be written; a truncated file in it raises
at every start until somebody deletes it; damaged machine code ends the process; and a kernel is not compiled again
when a kernel that it calls, or a constant that it uses, changed in another file. So the cache here lies in the user's
own cache directory (or NUMBA_CACHE_DIR), every entry carries a checksum, a damaged one is compiled again, and an entry
is keyed on all that the kernel uses (kernel_key.py). It is never put into a shared temporary directory: an entry is a
pickle, and reading somebody else's would run his code.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, NullCache, _CacheLocator
from numba.misc.appdirs import AppDirs

from mecp_env.core.jit_key import fingerprint

KEPT_DAYS = 30  # entries not written for so long are removed when something is compiled
DIGEST_BYTES = 32

log = logging.getLogger(__name__)


def cache_directory() -> Path:
    """Where compiled kernels are kept: below NUMBA_CACHE_DIR, or else in the user's own cache directory."""
    base = Path(numba.config.CACHE_DIR or AppDirs(appname="mecp_env", appauthor=False).user_cache_dir)
    version = f"py{sys.version_info[0]}{sys.version_info[1]}-numba{numba.__version__}"
    return base / "mecp_env_kernels" / version


def cache_for(function: Callable[..., Any]) -> NullCache:
    """The cache of one function: on disk, or none where there is no place for it."""
    return _KernelCache(function) if _usable(cache_directory()) else _NoCache()


@functools.cache
def _usable(directory: Path) -> bool:
    """True when `directory` is there or can be made, is ours, and can be written."""
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
        ours = not hasattr(os, "getuid") or directory.stat().st_uid == os.getuid()
    except OSError:
        ours = False
    if not ours:
        log.warning("mecp_env: no cache of kernels in %s: they are compiled in every process", directory)
    return ours


@functools.cache
def _announce() -> None:
    """Say once a process that the first start takes longer, and clear away what has not been written for long."""
    log.warning("mecp_env: compiling kernels; this happens once and takes about a minute")
    for entry in cache_directory().glob("*.nb*"):
        with contextlib.suppress(OSError):  # another process was faster
            _remove_old(entry)


@functools.cache
def _start_helpers() -> None:
    """Once a process: have the other cores compile, too."""
    from mecp_env.core.warm_up import start_helpers  # it knows this module, and few processes need it

    start_helpers(cache_directory())


def _remove_old(entry: Path) -> None:
    if entry.stat().st_mtime < time.time() - KEPT_DAYS * 86_400:
        entry.unlink()


class _NoCache(NullCache):  # type: ignore[misc]
    """No place to keep anything: every kernel is compiled, and the first one says so."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        _announce()


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Tells numba where the entry of a function lies and what it depends on."""

    def __init__(self, function: Callable[..., Any], path: str) -> None:
        self._py_file = path  # numba names it in a warning
        self._stamp = fingerprint(function)
        self._name = f"{function.__module__}-{self._stamp}"

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(cache_directory())

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return self._name


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """The machine code of one function behind a checksum: damaged code would end the process, not raise."""

    def _save_data(self, name: str, data: Any) -> None:
        body = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(body).digest() + body)

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        digest, body = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
        if hashlib.sha256(body).digest() != digest:
            raise pickle.UnpicklingError(f"{name}: wrong checksum")
        return pickle.loads(body)


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Entry(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, with our place, our key and our checksum."""

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )


class Inner:
    """Stands where numba keeps the machine code of a kernel, for a kernel that has none (`kernel_compiler`)."""


class _KernelCache(NullCache):  # type: ignore[misc]
    """The cache of one function; a damaged entry is no entry, and one that cannot be saved is not needed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @functools.cached_property
    def _entry(self) -> _Entry:
        """Made at the first call: what the function uses may be defined after it."""
        return _Entry(self._function)

    @property
    def cache_path(self) -> str:
        return str(cache_directory())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load_or_drop(sig, target_context)
        if found is None:
            _announce()
            _start_helpers()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        if isinstance(data.entry_point, Inner):
            return  # it is part of its caller's entry
        try:
            self._entry.save_overload(sig, data)
        except OSError as error:  # disk full, directory gone
            log.info("%s: not cached (%r)", self._function, error)

    def _load_or_drop(self, sig: Any, target_context: Any) -> Any:
        try:
            return self._entry.load_overload(sig, target_context)
        except Exception as error:  # unpickling damaged bytes can raise anything
            log.info("%s: damaged cache entry (%r)", self._function, error)
        with contextlib.suppress(OSError):
            self._entry.flush()
        return None
