"""Environments under way in the asynchronous interface: which they are, and what has come back of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gymnasium.error import AlreadyPendingCallError

from mecp_env.core.processes import Failure
from mecp_env.core.worker_pool import WorkerPool
from mecp_env.vector.worker import Info


class Flights:
    """Sends single environments to their workers, and collects results in the order in which they are finished."""

    def __init__(self, pool: WorkerPool, slices: Sequence[range]) -> None:
        self._pool = pool
        self._worker = {env: number for number, own in enumerate(slices) for env in own}
        self._flying = set[int]()
        self._landed: dict[int, Info | Failure] = {}

    def __len__(self) -> int:
        """How many environments were sent and not yet taken."""
        return len(self._flying) + len(self._landed)

    def check_free(self, envs: Iterable[int], what: str) -> None:
        """Raise `AlreadyPendingCallError` for environments that are under way."""
        busy = sorted((self._flying | self._landed.keys()).intersection(envs)) if len(self) else []
        if busy:
            raise AlreadyPendingCallError(f"{what} while environments {busy} are under way: recv() them first", "send")

    def send(self, name: str, items: Mapping[int, tuple[Any, ...]]) -> None:
        """Let the workers do `name`, "step" or "reset", with the arguments of each environment. Raises `WorkerDied`."""
        parts: dict[int, list[tuple[int, tuple[Any, ...]]]] = {}
        for env, arguments in items.items():
            parts.setdefault(self._worker[env], []).append((env, arguments))
        self._flying.update(items)
        for worker, part in parts.items():
            self._pool.post(worker, "run", name, part)

    def take(self, count: int) -> dict[int, Info | Failure]:
        """The `count` environments that were finished first, by number; or one of them alone that failed.

        Raises `WorkerDied`.
        """
        while len(self._landed) < count:
            self._wait()
        return self._pop(sorted(list(self._landed)[:count]))

    def _pop(self, envs: Sequence[int]) -> dict[int, Info | Failure]:
        failed = [env for env in envs if isinstance(self._landed[env], Failure)]
        return {env: self._landed.pop(env) for env in failed[:1] or envs}

    def _wait(self) -> None:
        for answer in self._pool.arrived():
            self._land(answer)

    def _land(self, answer: dict[int, Info | Failure] | Failure) -> None:
        if isinstance(answer, Failure):  # an answer that could not be sent: nothing is known of its environments
            answer.error.add_note(answer.note)
            raise answer.error
        self._flying -= answer.keys()
        self._landed |= answer
