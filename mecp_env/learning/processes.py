"""One environment per process, as `SubprocVecEnv`: a process that dies is named, and the others are ended."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import gymnasium as gym
from stable_baselines3.common.vec_env import SubprocVecEnv

from mecp_env.vector import WorkerDied

GONE = (EOFError, BrokenPipeError, ConnectionResetError)
END_S = 2.0  # for a process to end by itself


class Processes(SubprocVecEnv):
    """As `SubprocVecEnv`; every call raises `WorkerDied` after a process has died, and `close` never waits for one."""

    def __init__(self, makers: Sequence[Callable[[], gym.Env[Any, Any]]]) -> None:
        try:
            super().__init__(list(makers))
        except GONE:  # it asks the first one for its spaces
            raise self.died(0) from None
        self.remotes: tuple[Any, ...] = tuple(Line(remote, self, index) for index, remote in enumerate(self.remotes))

    def died(self, index: int) -> WorkerDied:
        """What to say of the process that died; all others are ended."""
        process = self.processes[index]
        process.join(END_S)
        how = cause(process.exitcode)
        self._end()
        return WorkerDied(f"the process of environment {index} {how}; the others are ended")

    def close(self) -> None:
        """End the processes; in the middle of a step at once, for whoever was interrupted may hold some answers."""
        if self.waiting:
            self._end()
        super().close()

    def _end(self) -> None:
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.join(END_S)
            process.kill()
        self.waiting, self.closed = False, True


class Line:
    """The connection to a process, which raises `WorkerDied` when the process is gone."""

    def __init__(self, remote: Any, processes: Processes, index: int) -> None:
        self.remote, self.processes, self.index = remote, processes, index

    def send(self, message: Any) -> None:
        """As of a connection. Raises `WorkerDied`."""
        try:
            self.remote.send(message)
        except GONE:
            raise self.processes.died(self.index) from None

    def recv(self) -> Any:
        """As of a connection. Raises `WorkerDied`."""
        try:
            return self.remote.recv()
        except GONE:
            raise self.processes.died(self.index) from None

    def close(self) -> None:
        """As of a connection."""
        self.remote.close()


def cause(exit_code: int | None) -> str:
    """What ended a process, in words."""
    if exit_code is None:
        return "does not answer"
    with suppress(ValueError):
        return f"was killed by {signal.Signals(-exit_code).name}"
    return f"ended with exit code {exit_code}, its error stands above"
