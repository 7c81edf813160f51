"""Many episodes on a few processes: what fails is named, and what is done stays done."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from mecp_env.policies.rollout import EpisodeResult, EpisodeTask, run_episode


@dataclass(frozen=True, slots=True)
class FailedTask:
    """A task that came to nothing, and why."""

    task: EpisodeTask
    reason: str

    def __str__(self) -> str:
        return f"{self.task}: {self.reason}"


def attempt(task: EpisodeTask) -> EpisodeResult | FailedTask:
    """The episode of a task, or what went wrong in it: the error, and the line that raised it."""
    try:
        return run_episode(task)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return FailedTask(task, f"{type(error).__name__}: {error} ({place.name}, line {place.lineno})")


def finished(tasks: Sequence[EpisodeTask], jobs: int) -> Iterator[EpisodeResult | FailedTask]:
    """Each episode or failure as it comes, of `jobs` processes; with one job all is done here.

    After an exception at the `yield`, Ctrl-C among them, the processes are ended.
    """
    if jobs == 1:
        yield from map(attempt, tasks)
        return
    crew = [Worker() for _ in range(min(jobs, len(tasks)))]
    try:
        yield from work(crew, iter(tasks))
    finally:
        for worker in crew:
            worker.stop()


def work(crew: Sequence[Worker], waiting: Iterator[EpisodeTask]) -> Iterator[EpisodeResult | FailedTask]:
    """Keep the workers busy; each result as it comes."""
    for worker in crew:
        worker.begin(next(waiting, None))
    while any(worker.task for worker in crew):
        for worker in ready(crew):
            yield worker.end()
            worker.begin(next(waiting, None))


class Worker:
    """A process that plays one task after the other; one that dies is replaced, and its task has failed."""

    def __init__(self) -> None:
        self.task: EpisodeTask | None = None
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would inherit threads and the state of libraries
        self.line, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    @property
    def process_id(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    def begin(self, task: EpisodeTask | None) -> None:
        """Send the next task; None: there is none."""
        self.task = task
        if task is not None:
            with suppress(OSError):  # a process that is gone says so at the end
                self.line.send(task)

    def end(self) -> EpisodeResult | FailedTask:
        """What came of the task."""
        assert self.task is not None
        try:
            result: EpisodeResult | FailedTask = self.line.recv()
        except (EOFError, OSError):
            self._process.join()
            result = FailedTask(self.task, f"its process ended with code {self._process.exitcode}")
            self._start()
        return result

    def stop(self) -> None:
        """End the process, whatever it does."""
        self._process.terminate()
        self._process.join()
        self.line.close()


def ready(crew: Sequence[Worker]) -> list[Worker]:
    """Those of the workers that have something to say; waits until there is one."""
    lines: list[Any] = [worker.line for worker in crew if worker.task]
    speaking = wait(lines)
    return [worker for worker in crew if worker.task and worker.line in speaking]


def serve(line: Connection) -> None:
    """Play what comes over the line; Ctrl-C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task = line.recv()
        except EOFError:
            return
        line.send(attempt(task))
