"""A pool of workers that are asked and answer together; one of them may be the calling process itself.

A worker without a process: its target works in the calling process, when its answer is wanted.
"""

from __future__ import annotations

import contextlib
import copy
import multiprocessing
import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import wait
from typing import Any, NoReturn

from mecp_env.core.processes import GONE, Failure, Worker, WorkerDied, WorkerError

INTERRUPTED = "interrupted in the middle of its work, which is lost"


class LocalWorker:
    """The questions and answers of `mecp_env.core.processes.Worker`, for a target of this process.

    Arguments are copied, as a pipe would, because the caller may overwrite them before the work is done.
    """

    def __init__(self, target: Any, name: str) -> None:
        self.name = name
        self._target = target
        self._work = deque[Iterator[Any]]()

    def ready(self, seconds: float) -> bool:
        """True: there is nothing to wait for."""
        return True

    def ask(self, name: str, *arguments: Any) -> None:
        """Note what to call; `answer` calls it."""
        self._work.append(self._answers(name, copy.deepcopy(arguments)))

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

    def _answers(self, name: str, arguments: tuple[Any, ...]) -> Iterator[Any]:
        try:
            answer = getattr(self._target, name)(*arguments)
            yield from answer if isinstance(answer, Iterator) else (answer,)
        except Exception as error:
            yield Failure.of(error, getattr(self._target, "place", ""))


LOOK_S = 0.5  # how often a process that waits for an answer checks that all workers are alive
STOP_S = 5.0  # how long workers have to stop by themselves


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
                self._workers.append(Worker(target, name, method, [worker.pipe for worker in self._workers]))
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
        try:
            for worker, own in zip(self._all, arguments, strict=True):
                worker.ask(name, *own)
        except WorkerDied as error:
            self._end(error)

    def gather(self) -> list[Any]:
        """The answers of all workers. Raises `WorkerDied`, or the exception of the first target that had one."""
        try:
            while len(self._answers) < len(self._all):
                self._answers.append(self._answer(len(self._answers)))
        except WorkerDied as error:
            self._end(error)
        answers, self._answers = self._answers, []
        for answer in answers:
            if isinstance(answer, Failure):
                answer.error.add_note(answer.note)
                raise answer.error
        return answers

    def post(self, number: int, name: str, *arguments: Any) -> None:
        """Let one worker call the method `name` after what it was asked before; `arrived` has its answers."""
        try:
            self._all[number].ask(name, *arguments)
        except WorkerDied as error:
            self._end(error)

    def arrived(self) -> list[Any]:
        """The next answer of each worker that has one; waits for at least one. Raises `WorkerDied`."""
        try:
            own = [answer for worker in self._local if (answer := worker.answer()) is not None]
            while not (ready := wait([worker.pipe for worker in self._workers], 0.0 if own else LOOK_S)) and not own:
                self._look()
            return own + [worker.answer() for worker in self._workers if worker.pipe in ready]
        except WorkerDied as error:
            self._end(error)

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
        worker = self._all[number]
        while not worker.ready(LOOK_S):
            self._look()
        return worker.answer()

    def _look(self) -> None:
        """Raise `WorkerDied` if a worker is no longer alive."""
        for worker in self._workers:
            if not worker.process.is_alive():
                worker.report_death()

    def _end(self, error: WorkerDied) -> NoReturn:
        """After the death of a worker, stop the others, too."""
        for worker in self._workers:
            worker.process.terminate()
        self.close()
        raise WorkerDied(f"{error}; the others are stopped") from None
