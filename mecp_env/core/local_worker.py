"""A worker without a process: its target works in the calling process, when its answer is wanted."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Iterator
from typing import Any

from mecp_env.core.processes import Failure, WorkerError

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
