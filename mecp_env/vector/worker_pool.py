"""The workers of a batch as the process that started them sees them: start, ask, notice a death, stop."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from mecp_env.vector.worker import GONE, Failure, Task, work

LOOK_S = 0.5  # how often a process that waits for an answer looks whether all workers are alive
STOP_S = 5.0  # how long workers have to stop by themselves
KILL_S = 2.0  # how long they then have to obey
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerDied(RuntimeError):
    """A worker process ended; the message names it, its environments and what ended it."""


class WorkerError(RuntimeError):
    """An exception in an environment that could not be sent as it is; the message is its text."""


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


def slices(count: int, workers: int | None, each_core: int = 1) -> list[range]:
    """Numbers of the environments of each worker; `workers` None makes `each_core` a core."""
    workers = min(count, workers or each_core * cores())
    ends = [count * k // workers for k in range(workers + 1)]
    return [range(first, end) for first, end in itertools.pairwise(ends)]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class WorkerPool:
    """Processes that each do a slice of the work. `ask` all of them, then `gather` their answers."""

    def __init__(self, tasks: Sequence[Task], method: str) -> None:
        if multiprocessing.current_process().daemon:
            raise RuntimeError('a worker process may start no others; vectorization_mode="sync" needs none')
        self._owner = os.getpid()
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        self._ranges = [(task.first, task.first + len(task.makers) - 1) for task in tasks]
        self._answers: dict[int, Any] = {}  # of this question, so far
        try:
            self._start(tasks, method)
            self.gather()
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> list[int]:
        """Of the processes."""
        return [process.pid for process in self._processes]

    def ask(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> None:
        """Let each worker call its method `name` with its arguments. Raises `WorkerDied`."""
        for worker, (pipe, own) in enumerate(zip(self._pipes, arguments, strict=True)):
            try:
                pipe.send((name, own))
            except GONE:
                self._report_death(worker)

    def gather(self) -> list[Any]:
        """The answers of all workers. Raises `WorkerDied`, or the exception of the first environment that had one."""
        for worker in range(len(self._pipes)):
            if worker not in self._answers:  # Ctrl-C may have ended an earlier wait
                self._answers[worker] = self._answer(worker)
        answers, self._answers = [self._answers[worker] for worker in range(len(self._pipes))], {}
        for answer in answers:
            if isinstance(answer, Failure):
                _raise(answer)
        return answers

    def close(self) -> None:
        """Stop the workers: ask, then insist. Another process than the one that started them does nothing."""
        if os.getpid() != self._owner:
            return
        for pipe in self._pipes:
            with contextlib.suppress(*GONE, OSError):
                pipe.send(("close", ()))
        deadline = time.monotonic() + STOP_S
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            _drain(pipe, deadline)
            _stop(process, deadline)
            pipe.close()
            process.close()
        self._pipes, self._processes = [], []

    def _start(self, tasks: Sequence[Task], method: str) -> None:
        context: Any = multiprocessing.get_context(method)
        with _one_thread_each(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*fork", DeprecationWarning)  # of libraries' threads, which heed it
            for worker, task in enumerate(tasks):
                ours, theirs = context.Pipe()
                inherited = [*self._pipes, ours] if method == "fork" else []
                arguments, name = (theirs, inherited, task), f"mecp_env worker {worker}"
                process = context.Process(target=work, args=arguments, name=name, daemon=True)
                process.start()  # one that cannot be started is none to stop
                theirs.close()
                self._processes.append(process)
                self._pipes.append(ours)

    def _answer(self, worker: int) -> Any:
        try:
            while not self._pipes[worker].poll(LOOK_S):
                self._look_for_deaths()
            return self._pipes[worker].recv()
        except GONE:
            self._report_death(worker)

    def _look_for_deaths(self) -> None:
        for worker, process in enumerate(self._processes):
            if not process.is_alive():
                self._report_death(worker)

    def _report_death(self, worker: int) -> NoReturn:
        """Stop the others, too, and say who is gone."""
        process, (first, last) = self._processes[worker], self._ranges[worker]
        process.join(KILL_S)
        how = _cause(process.exitcode)
        for other in self._processes:
            other.terminate()
        self.close()
        raise WorkerDied(f"worker {worker} (environments {first} to {last}) {how}; the batch is closed")


def _raise(failure: Failure) -> None:
    where = f"in environment {failure.env} of the batch"
    error = failure.error or WorkerError(failure.text)
    error.add_note(f"{where}:\n{failure.trace}")
    raise error


def _cause(exit_code: int | None) -> str:
    """What ended a process, in words."""
    if exit_code is None or exit_code >= 0:
        return f"ended with exit code {exit_code}"
    with contextlib.suppress(ValueError):
        return f"was killed by {signal.Signals(-exit_code).name}"
    return f"was killed by signal {-exit_code}"


def _drain(pipe: Connection, deadline: float) -> None:
    """Take what a worker still has to say, until it is gone or the time is up."""
    with contextlib.suppress(*GONE, OSError):
        while pipe.poll(max(0.0, deadline - time.monotonic())):
            pipe.recv()


def _stop(process: Any, deadline: float) -> None:
    process.join(max(0.0, deadline - time.monotonic()))
    for insist in (process.terminate, process.kill):
        if process.exitcode is None:
            insist()
            process.join(KILL_S)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Started so, libraries of a new process use one thread; a forked one keeps the setting of this process."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
