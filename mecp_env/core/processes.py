"""Worker processes: one with a pipe, the cause in words when it dies, and a pool of workers that answer together.

A worker starts with one thread per library, leaves Ctrl-C to the process that started it, and ends with it. One worker
of a pool may be the calling process itself: its target works here, when its answer is wanted.

How many cores this process may use: its affinity and the limits of its cgroups.

Memory that was freed but that the C library keeps for later: glibc returns it to the system, or keeps more of it.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import gc
import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NoReturn

from mecp_env.core.provenance import import_modules, imported_modules

ROOT = Path("/")


def cores(root: Path = ROOT) -> int:
    """At least 1: the cores of the affinity, or fewer where a cgroup limits CPU time; a limit of 1.5 cores is 2."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([allowed, *map(math.ceil, _limits(root))]))


def _limits(root: Path) -> Iterator[float]:
    """The CPU limits, in cores, of the cgroup (version 2) of this process and of those around it."""
    mount, groups = root / "sys/fs/cgroup", root / "proc/self/cgroup"
    lines = groups.read_text(encoding="utf-8").splitlines() if groups.exists() else []  # not Linux
    for path in [line.removeprefix("0::/") for line in lines if line.startswith("0::/")]:
        for folder in (mount / path, *(mount / path).parents):
            limit = folder / "cpu.max"  # inside a container the folders of its host are missing
            quota, period = limit.read_text(encoding="utf-8").split() if limit.exists() else ("max", "1")
            if quota != "max":
                yield float(quota) / float(period)


M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h


def trim() -> None:
    """Return freed memory to the system; nothing happens where the C library cannot."""
    _call_c("malloc_trim", 0)


def keep() -> None:
    """Keep what is freed from now on, so that large arrays are not taken from the system and cleared each time."""
    _call_c("mallopt", M_MMAP_THRESHOLD, 2**25)  # no more is allowed
    _call_c("mallopt", M_TRIM_THRESHOLD, 2**30)


def _call_c(name: str, *arguments: int) -> None:
    """Call a function of the C library, where there is such a function."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # another C library; Windows
        getattr(ctypes.CDLL(None), name)(*arguments)


PATIENCE_S = 2.0  # how often an idle worker checks that its parent process is alive
KILL_S = 2.0  # how long they then have to react to a signal
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
GONE = (EOFError, BrokenPipeError, ConnectionResetError)


class WorkerDied(RuntimeError):
    """A worker process ended; the message names it, its work and what ended it."""


class WorkerError(RuntimeError):
    """An exception in a worker that could not be sent as it is; the message is its text."""


@dataclass(frozen=True, slots=True)
class Failure:
    """An exception in a worker."""

    error: Exception  # a `WorkerError` when the exception itself cannot be sent
    note: str  # where the worker was, and the traceback
    reason: str  # in one line: the exception and the line that raised it

    @classmethod
    def of(cls, error: Exception, place: str = "") -> Failure:
        """The failure that an exception at a `place` stands for."""
        text = f"{type(error).__name__}: {error}"
        raised = traceback.extract_tb(error.__traceback__)[-1]
        note = f"in {place}:\n{traceback.format_exc()}" if place else traceback.format_exc()
        try:
            sent: Exception = pickle.loads(pickle.dumps(error))  # noqa: S301  (just written)
        except Exception:  # an exception with an argument that cannot be sent
            sent = WorkerError(text)
        return cls(sent, note, f"{text} ({raised.name}, line {raised.lineno})")


def start_method(wanted: str | None = None) -> str:
    """How to start workers: "fork" where this process has no other thread, else "forkserver" or "spawn".

    A forked worker has every compiled function loaded and starts in milliseconds; but a lock that another thread holds
    at that moment stays locked in it for ever. Raises `ValueError` for a method that this system lacks.
    """
    methods = multiprocessing.get_all_start_methods()
    if wanted is None:
        alone = threading.active_count() == 1 and sys.platform == "linux"
        return next(name for name in ("fork", "forkserver", "spawn") if name in methods and (alone or name != "fork"))
    if wanted not in methods:
        raise ValueError(f"context: {wanted!r}, expected one of {', '.join(methods)}")
    return wanted


class Worker:
    """A process that holds `target` and calls its methods, one at a time, as asked through a pipe."""

    def __init__(self, target: Any, name: str, method: str) -> None:
        context: Any = multiprocessing.get_context(method)
        self.name = name
        self.pipe, theirs = context.Pipe()
        inherited = self.pipe if method == "fork" else None
        self.process = context.Process(
            target=_serve, args=(theirs, inherited, imported_modules(), target), name=name, daemon=True
        )
        with _as_worker(method), warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*fork", DeprecationWarning)  # of libraries' threads, which heed it
            self.process.start()
        theirs.close()

    def ask(self, name: str, *arguments: Any) -> None:
        """Let it call the method `name` of its target. Raises `WorkerDied`."""
        try:
            self.pipe.send((name, arguments))
        except GONE as error:
            # The frames view a BytesIO: collected in a cycle, such a view ends Python 3.12.1 with SIGSEGV.
            traceback.clear_frames(error.__traceback__)
            self.report_death()

    def answer(self) -> Any:
        """What the method returned, or a `Failure`; waits for it. Raises `WorkerDied`."""
        try:
            return self.pipe.recv()
        except GONE:
            self.report_death()

    def report_death(self) -> NoReturn:
        """Raise `WorkerDied` with what ended the process."""
        self.process.join(KILL_S)
        raise WorkerDied(f"{self.name} {_cause(self.process.exitcode)}")

    def stop(self, deadline: float = 0.0) -> None:
        """End the process: by itself until the deadline, a time of `time.monotonic()`, then by signals."""
        with contextlib.suppress(*GONE, OSError):
            while self.pipe.poll(max(0.0, deadline - time.monotonic())):
                self.pipe.recv()  # what it still sends; otherwise it would wait for a reader
        self.process.join(max(0.0, deadline - time.monotonic()))
        for insist in (self.process.terminate, self.process.kill):
            if self.process.exitcode is None:
                insist()
                self.process.join(KILL_S)
        self.pipe.close()
        self.process.close()


def _serve(pipe: Connection, inherited: Connection | None, modules: Sequence[str], target: Any) -> None:
    """The process of a worker: call what the pipe names of `target`, whose `place` is what it is working on.

    What a method yields is sent at once, one answer after another. `modules` register the custom parts of the user.
    `inherited`: the other end of the pipe, which a fork keeps open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent process
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a window's library (SDL) catches it, and a fork inherits that
    gc.freeze()  # what a forked process inherits it would otherwise copy, page by page, to find that all is in use
    if inherited is not None:
        inherited.close()
    import_modules(modules)
    with contextlib.suppress(*GONE), pipe:
        for name, arguments in _questions(pipe):
            for answer in _answers(target, name, arguments):
                _send(pipe, answer)


def _questions(pipe: Connection) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """What comes through the pipe, until it is "close", or the process at the other end is gone."""
    parent, name = os.getppid(), ""
    while name != "close" and os.getppid() == parent:
        if pipe.poll(PATIENCE_S):
            name, arguments = pipe.recv()
            yield name, arguments


def _answers(target: Any, name: str, arguments: tuple[Any, ...]) -> Iterator[Any]:
    """What a method of the target returns, or one after another what it yields; last a `Failure`, if it raises."""
    try:
        answer = getattr(target, name)(*arguments)
        yield from answer if isinstance(answer, Iterator) else (answer,)
    except Exception as error:
        yield Failure.of(error, getattr(target, "place", ""))


def _send(pipe: Connection, answer: Any) -> None:
    """Send an answer; a `Failure` in place of one that cannot be sent."""
    try:
        pipe.send(answer)
    except GONE:
        raise
    except Exception as error:
        pipe.send(Failure.of(error))


def _cause(exit_code: int | None) -> str:
    """What ended a process, in words."""
    signals = {-one: one.name for one in signal.Signals}
    return f"was killed by {signals[exit_code]}" if exit_code in signals else f"ended with exit code {exit_code}"


def _blocked_mask(method: str) -> set[int | signal.Signals] | None:
    """The signals that were blocked here before; Ctrl-C now is. None in another thread, and on Windows."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        return None
    if method != "fork":
        resource_tracker.ensure_running()  # its start would unblock the signal
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))


@contextlib.contextmanager
def _as_worker(method: str) -> Iterator[None]:
    """A process started in it uses one thread per library, and never receives Ctrl-C, also while it imports.

    This process receives it afterwards. Libraries of a forked process keep the threads that they have here.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    mask = _blocked_mask(method)
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


INTERRUPTED = "interrupted in the middle of its work, which is lost"
LOOK_S = 0.5  # how often a process that waits for an answer checks that all workers are alive
STOP_S = 5.0  # how long workers have to stop by themselves


class LocalWorker:
    """The questions and answers of a `Worker`, for a target of this process.

    Arguments are copied, as a pipe would, because the caller may overwrite them before the work is done.
    """

    def __init__(self, target: Any, name: str) -> None:
        self.name = name
        self._target = target
        self._work = deque[Iterator[Any]]()

    def ask(self, name: str, *arguments: Any) -> None:
        """Note what to call; `answer` calls it."""
        self._work.append(_answers(self._target, name, copy.deepcopy(arguments)))

    def answer(self) -> Any:
        """The next answer, or a `Failure`; None where there is no other."""
        while self._work:
            try:
                return next(self._work[0])
            except StopIteration:
                self._work.popleft()
            except BaseException:  # Ctrl-C: who asks again learns that there is no answer
                self._work[0] = iter([Failure(WorkerError(f"{self.name} was {INTERRUPTED}"), "", INTERRUPTED)])
                raise
        return None

    def stop(self) -> None:
        """Close the target, and forget what was asked."""
        self._work.clear()
        self._target.close()


class WorkerPool:
    """Workers that each hold a target, by the name of the worker. `ask` all of them, then `gather` their answers.

    A target has the methods `open`, which is called first, and `close`. With `local`, the first needs no process:
    this one does its work while it waits for the others.
    """

    def __init__(self, targets: Mapping[str, Any], method: str, local: bool = False) -> None:
        if len(targets) > local and multiprocessing.current_process().daemon:
            raise RuntimeError('a worker process may start no others; vectorization_mode="sync" needs none')
        self._owner = os.getpid()
        self._workers: list[Worker] = []
        self._local = [LocalWorker(target, name) for name, target in list(targets.items())[:local]]
        self._answers: list[Any] = []  # to this question, so far: Ctrl-C may end a wait
        try:
            for name, target in list(targets.items())[local:]:
                self._workers.append(Worker(target, name, method))
            self.ask("open", [()] * len(targets))
            self.gather()
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> list[int]:
        """Of the processes."""
        return [worker.process.pid for worker in self._workers]

    def ask(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> None:
        """Let each worker call the method `name` of its target with its arguments. Raises `WorkerDied`."""
        with self._all_or_none():
            for worker, own in zip(self._all, arguments, strict=True):
                worker.ask(name, *own)

    def gather(self) -> list[Any]:
        """The answers of all workers. Raises `WorkerDied`, or the exception of the first target that had one."""
        with self._all_or_none():
            while len(self._answers) < len(self._all):
                self._answers.append(self._answer(len(self._answers)))
        answers, self._answers = self._answers, []
        for answer in answers:
            if isinstance(answer, Failure):
                answer.error.add_note(answer.note)
                raise answer.error
        return answers

    def post(self, number: int, name: str, *arguments: Any) -> None:
        """Let one worker call the method `name` after what it was asked before; `arrived` has its answers."""
        with self._all_or_none():
            self._all[number].ask(name, *arguments)

    def arrived(self) -> list[Any]:
        """The next answer of each worker that has one; waits for at least one. Raises `WorkerDied`."""
        with self._all_or_none():
            own = [answer for worker in self._local if (answer := worker.answer()) is not None]
            ready = wait([worker.pipe for worker in self._workers], 0.0 if own else None)
            return own + [worker.answer() for worker in self._workers if worker.pipe in ready]

    def close(self) -> None:
        """Stop the workers: ask, then insist. Another process than the one that started them does nothing."""
        if os.getpid() != self._owner:
            return
        for worker in self._workers:
            with contextlib.suppress(*GONE, OSError):
                worker.pipe.send(("close", ()))
        deadline = time.monotonic() + STOP_S
        for worker in self._workers:
            worker.stop(deadline)
        for local in self._local:
            local.stop()
        self._workers, self._local = [], []

    @property
    def _all(self) -> list[Worker | LocalWorker]:
        return [*self._local, *self._workers]

    def _answer(self, number: int) -> Any:
        """The answer of a worker. Raises `WorkerDied` soon after any of them died, though this one be busy."""
        worker = self._all[number]
        while isinstance(worker, Worker) and not worker.pipe.poll(LOOK_S):
            for other in self._workers:
                if not other.process.is_alive():
                    other.report_death()
        return worker.answer()

    @contextlib.contextmanager
    def _all_or_none(self) -> Iterator[None]:
        """After the death of a worker, stop the others, too."""
        try:
            yield
        except WorkerDied as error:
            for worker in self._workers:
                worker.process.terminate()
            self.close()
            raise WorkerDied(f"{error}; the others are stopped") from None
