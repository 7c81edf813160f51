"""A worker of a batch: a process that holds some of the environments and steps them one after another."""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, SupportsFloat

import gymnasium
from gymnasium.vector import AutoresetMode

from mecp_env.vector.shared_buffers import ALONE, INFO, OBSERVATION, Fields, SharedBuffers, below, lay_out

PATIENCE_S = 2.0  # after which an idle worker checks that its parent process is alive
GONE = (EOFError, BrokenPipeError, ConnectionResetError)

Makers = Sequence[Callable[[], gymnasium.Env[Any, Any]]]
Infos = dict[int, dict[str, Any]]  # by number of the environment: the part of its info that has no place in the buffers


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker is given at its start."""

    first: int  # number of its first environment
    makers: Makers
    fields: Fields
    memory: Any  # the block that all processes share
    mode: AutoresetMode
    spaces: tuple[Any, Any]  # of an observation and of an action, as the batch has them


@dataclass(frozen=True, slots=True)
class Failure:
    """An exception in a worker."""

    env: int  # number of the environment
    error: BaseException | None  # None when it cannot be sent
    text: str  # the last line of the traceback
    trace: str


class WorkerEnvironments:
    """The environments of one worker and their rows of the shared buffers."""

    def __init__(self, task: Task, buffers: SharedBuffers) -> None:
        self.env = self.first = task.first  # `env`: the one at work, for error messages
        self._mode = task.mode
        self._buffers, self._seen, self._listed = buffers, below(buffers, OBSERVATION), below(buffers, INFO)
        self._envs: list[gymnasium.Env[Any, Any]] = []
        self._masks: list[Callable[[], Any]] = []
        self._over = [False] * len(task.makers)
        self._started = [False] * len(task.makers)

    def open(self, makers: Makers, kinds: tuple[Any, Any]) -> None:
        """Make the environments. Raises `ValueError` for one with other spaces than the batch has."""
        for env, maker in enumerate(makers, self.first):
            self.env = env
            self._envs.append(maker())
            if (self._envs[-1].observation_space, self._envs[-1].action_space) != kinds:
                raise ValueError(f"environment {env} has other spaces than the first one")
        if self._buffers["mask"].size:
            self._masks = [env.get_wrapper_attr("action_masks") for env in self._envs]

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None, chosen: Sequence[bool]) -> Infos:
        """Begin new episodes in the chosen environments."""
        numbered = ((place, self.first + place) for place in self._places() if chosen[place])
        return {env: self._begin(place, seeds[place], options) for place, env in numbered}

    def step(self, actions: Sequence[Any]) -> Infos:
        """One step in each environment, or in one whose episode is over what the autoreset mode says."""
        step = self._advance if self._mode != AutoresetMode.NEXT_STEP else self._advance_or_begin
        return {self.first + place: step(place, actions[place]) for place in self._places()}

    def each(self, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """What `function(environment, *its arguments)` returns, for each environment that has arguments."""
        chosen = (place for place in self._places() if arguments[place] is not None)
        found = [function(self._envs[place], *arguments[place]) for place in chosen]
        for place in self._places():
            self._show_mask(place)
        return found

    def close(self) -> None:
        """Close the environments."""
        for place in self._places():
            self._envs[place].close()

    def _places(self) -> Any:
        """0, 1, 2, ..., with a note of which environment is at work."""
        for place in range(len(self._envs)):
            self.env = self.first + place
            yield place

    def _advance_or_begin(self, place: int, action: Any) -> dict[str, Any]:
        return self._begin(place) if self._over[place] else self._advance(place, action)

    def _advance(self, place: int, action: Any) -> dict[str, Any]:
        """A step; in the mode SAME_STEP, a new episode where one ends."""
        observation, reward, terminated, truncated, info = self._envs[place].step(action)
        over = terminated or truncated
        if over and self._mode == AutoresetMode.SAME_STEP:
            last = {"final_obs": observation, "final_info": info}
            rest = last | self._begin(place)
        else:
            rest = self._show(place, observation, info)
        self._note(place, reward, terminated, truncated)
        self._over[place] = over and self._mode == AutoresetMode.NEXT_STEP
        return rest

    def _begin(self, place: int, seed: int | None = None, options: dict[str, Any] | None = None) -> dict[str, Any]:
        self._started[place] = True
        observation, info = self._envs[place].reset(seed=seed, options=options)
        self._note(place, 0.0, False, False)
        self._over[place] = False
        return self._show(place, observation, info)

    def _note(self, place: int, reward: SupportsFloat, terminated: bool, truncated: bool) -> None:
        row, buffers = self.first + place, self._buffers
        buffers["reward"][row], buffers["terminated"][row], buffers["truncated"][row] = reward, terminated, truncated

    def _show(self, place: int, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        """Write observation, info and mask to the buffers; the part of the info without a place there is returned."""
        row = self.first + place
        parts = observation if isinstance(observation, dict) else {ALONE: observation}
        for name, array in self._seen.items():
            array[row] = parts[name]
        self._show_mask(place)
        listed = self._buffers["listed"][row] = info.keys() >= self._listed.keys()
        if not listed:
            return info
        for name, column in self._listed.items():
            column[row] = info[name]
        return {name: value for name, value in info.items() if name not in self._listed}

    def _show_mask(self, place: int) -> None:
        if self._masks and self._started[place]:
            self._buffers["mask"][self.first + place] = self._masks[place]()


def work(pipe: Connection, others: Sequence[Connection], task: Task) -> None:
    """The process: run the commands that arrive on the pipe, until `stop` or until the other end is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent process
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a window's library (SDL) catches it, and a fork inherits that
    gc.freeze()  # what a forked process inherits it would otherwise copy, page by page, to find that all is in use
    for other in others:  # a copy of its ends of the pipes would keep workers from noticing that it is gone
        other.close()
    environments = WorkerEnvironments(task, lay_out(task.fields, task.memory))
    with contextlib.suppress(*GONE), pipe:
        _answer(pipe, environments, "open", (task.makers, task.spaces))
        for name, arguments in _questions(pipe):
            _answer(pipe, environments, name, arguments)


def _questions(pipe: Connection) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """What comes through the pipe, until it is to close, or the process at the other end is gone."""
    parent, name = os.getppid(), ""
    while name != "close" and os.getppid() == parent:
        if pipe.poll(PATIENCE_S):
            name, arguments = pipe.recv()
            yield name, arguments


def _answer(pipe: Connection, environments: WorkerEnvironments, name: str, arguments: tuple[Any, ...]) -> None:
    """Send what the method `name` returns, or what went wrong."""
    try:
        pipe.send(getattr(environments, name)(*arguments))
    except GONE:
        raise
    except Exception as error:  # of an environment, or an answer that cannot be sent
        pipe.send(_failure(environments.env, error))


def _failure(env: int, error: Exception) -> Failure:
    """What to say of an exception; itself, where it survives the way."""
    text = "".join(traceback.format_exception_only(error)).strip()
    try:
        sent: BaseException | None = pickle.loads(pickle.dumps(error))  # noqa: S301  (just written)
    except Exception:  # an exception with an argument that cannot be sent
        sent = None
    return Failure(env, sent, text, traceback.format_exc())
