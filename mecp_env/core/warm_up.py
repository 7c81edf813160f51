"""Compile what an episode calls before it is called, on all cores: `mecp-env warmup`, and the first use.

Each process takes one folder's functions after the other from the list (warm_up_list.py) and puts them into the cache.
What the list lacks is compiled when it is called. `MECP_ENV_WARM_UP` sets how many processes there may be on first
use; 0 switches it off.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import itertools
import json
import multiprocessing
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

from mecp_env.core import warm_up_list
from mecp_env.core.cores import cores
from mecp_env.core.warm_up_list import Entry

SWITCH = "MECP_ENV_WARM_UP"
FEW = 10  # so many functions are compiled when they are called
STALE_S = 900.0  # a lock older than this was left by a process that was killed
BAR = 30  # columns

Report = Callable[[int, int], None]  # functions done, functions in all


def prepare() -> None:
    """On first use: compile what the cache lacks, announced in one line, and wait for it."""
    if multiprocessing.parent_process() is None and processes_allowed():  # never in a worker of a pool
        _prepare_once()


@functools.cache
def _prepare_once() -> None:
    from mecp_env.core import jit_cache

    directory = jit_cache.cache_directory()
    if not jit_cache.usable(directory):
        return
    missing = missing_entries()
    with _lock(directory / "warm_up.lock") as free:
        if len(missing) < FEW or not free:
            return
        count = processes_allowed()
        cores = f"{count} cores" if count > 1 else "one core"
        jit_cache.announce(f"mecp_env: compiling {len(missing)} functions on {cores}; once, {SWITCH}=0 switches it off")
        compile_all(missing, count, show)


@functools.cache
def load() -> None:
    """Load the functions of the list, once per process: processes that are forked later share their memory.

    A few that the cache lacks are compiled; many are left to their first call.
    """
    missing = missing_entries()
    left = missing if len(missing) >= FEW else []
    for entry in warm_up_list.entries():
        if entry not in left:
            compile_entry(entry)


def processes_allowed() -> int:
    """How many processes the first use may start: one per core, or fewer by the environment variable."""
    if numba.config.DISABLE_JIT:
        return 0
    allowed = os.environ.get(SWITCH, "")
    return min(cores(), int(allowed)) if allowed.isdigit() else cores() * (allowed == "")


def missing_entries() -> list[Entry]:
    """The entries of the list that the cache lacks; those whose function was renamed are left out."""
    from mecp_env.core import jit_cache

    names = [path.name for path in jit_cache.cache_directory().glob("*.nbc")]

    def is_missing(entry: Entry) -> bool:
        with contextlib.suppress(Exception):  # renamed, or another type
            return not jit_cache.is_cached(warm_up_list.function_of(entry).py_func, names)
        return False

    return list(filter(is_missing, warm_up_list.entries()))


def show(done: int, total: int) -> None:
    """A progress bar on stderr, where that is a terminal."""
    if sys.stderr.isatty():
        filled = BAR * done // max(total, 1)
        end = "\n" if done == total else ""
        sys.stderr.write(f"\r[{'#' * filled:{BAR}}] {done}/{total} functions{end}")
        sys.stderr.flush()


def compile_all(entries: list[Entry], count: int, report: Report) -> None:
    """Compile the entries in `count` processes, or in this one; what fails or dies is compiled when it is called."""
    groups = [list(group) for _, group in itertools.groupby(sorted(entries, key=_folder), key=_folder)]
    groups.sort(key=len, reverse=True)
    todo: queue.SimpleQueue[list[Entry]] = queue.SimpleQueue()
    for group in groups:
        todo.put(group)
    progress = _Progress(len(entries), report)
    if count <= 1:
        _compile_here(todo, progress)
        return
    helpers = [_Helper(todo, progress) for _ in range(min(count, len(groups)))]
    _run(helpers)


def _compile_here(todo: queue.SimpleQueue[list[Entry]], progress: _Progress) -> None:
    for entry in _drain(todo):
        compile_entry(entry)
        progress.advance()


def _run(helpers: list[_Helper]) -> None:
    """Start the helpers and wait for them; whatever happens, none is left running."""
    try:
        for helper in helpers:
            helper.start()
        for helper in helpers:
            helper.join()
    finally:
        for helper in helpers:
            helper.stop()


def _folder(entry: Entry) -> str:
    """The package of a function: in one folder, functions share what they call, which is compiled once per process."""
    return str(entry[0]).rpartition(".")[0]


def compile_entry(entry: Entry) -> None:
    """Compile one function of the list; nothing happens where name or types are out of date."""
    with contextlib.suppress(Exception):
        warm_up_list.function_of(entry).compile(tuple(warm_up_list.decode(argument) for argument in entry[2]))


def _drain(todo: queue.SimpleQueue[list[Entry]]) -> Iterator[Entry]:
    with contextlib.suppress(queue.Empty):
        while True:
            yield from todo.get_nowait()


class _Progress:
    """Counts what is done, from several threads."""

    def __init__(self, total: int, report: Report) -> None:
        self._lock, self._done, self._total, self._report = threading.Lock(), 0, total, report
        report(0, total)

    def advance(self) -> None:
        with self._lock:
            self._done += 1
            self._report(self._done, self._total)


class _Helper(threading.Thread):
    """A process that compiles one entry per line that it reads, and the thread that feeds it.

    Not `multiprocessing`: that would import the user's script again, which need not be guarded.
    """

    def __init__(self, todo: queue.SimpleQueue[list[Entry]], progress: _Progress) -> None:
        super().__init__(daemon=True)
        self._todo, self._progress = todo, progress
        path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mecp_env.core.warm_up"],
            env=os.environ | {SWITCH: "0", "PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def run(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # the process died, or `stop` closed its pipes
            for _ in itertools.takewhile(self._compile, _drain(self._todo)):
                self._progress.advance()

    def _compile(self, entry: Entry) -> bool:
        """False when the process died."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps(entry) + "\n")
        self._process.stdin.flush()
        return bool(self._process.stdout.readline())

    def stop(self) -> None:
        """End the process, whatever it does."""
        self._process.terminate()
        self._process.wait()


@contextlib.contextmanager
def _lock(path: Path) -> Iterator[bool]:
    """True while this process holds the lock; False when another one does, or there is no place for it."""
    free = _take(path)
    try:
        yield free
    finally:
        if free:
            path.unlink(missing_ok=True)


def _take(lock: Path) -> bool:
    with contextlib.suppress(OSError):
        if time.time() - lock.stat().st_mtime > STALE_S:
            lock.unlink()
    try:
        os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
    except OSError:
        return False
    return True


def serve() -> None:
    """Compile one entry per line of the input, and answer each with a line."""
    gc.set_threshold(50_000, 20, 20)  # numba makes many objects, and most live on: a tenth of the time
    answers: Any = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a module prints at import is no answer
    for line in sys.stdin:
        compile_entry(json.loads(line))
        answers.write("done\n")
        answers.flush()


if __name__ == "__main__":
    serve()
