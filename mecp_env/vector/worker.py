"""A worker of a batch: a process that holds some of the environments and steps them one after another.

Shared memory of a batch: arrays of observations and masks, and a record of each environment with all its numbers.

Environments under way in the asynchronous interface: which they are, and what has come back of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import AlreadyPendingCallError
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from mecp_env.core import processes
from mecp_env.core.processes import Failure, WorkerPool

OBSERVATION, INFO = "observation/", "info/"  # prefixes of the names of fields, and of the numbers in a record
MASK, RECORD = "mask", "record"
RESULT = ("reward", "terminated", "truncated", "listed")  # first in a record; `listed`: its info has all keys
ALONE = ""  # the name of an observation that is no Dict
Makers = Sequence[Callable[[], gymnasium.Env[Any, Any]]]
Info = dict[str, Any]
Infos = dict[int, Info]  # by number of the environment: the part of its info that has no place in the buffers
Result = tuple[float, bool, bool]  # reward, terminated, truncated
NOTHING: Result = (0.0, False, False)  # of a reset
ANSWER_S = 0.004  # while there is more to do, what is finished is reported so often; an answer costs 0.1 ms


class Block(NamedTuple):
    """An array in shared memory, a row for each environment; every process makes its own view on it."""

    memory: Any
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def view(self) -> NDArray[Any]:
        """The array."""
        return np.ndarray(self.shape, self.dtype, self.memory)


Blocks = dict[str, Block]
SharedBuffers = dict[str, NDArray[Any]]


def shared_blocks(n: int, space: spaces.Space[Any], info: Mapping[str, Any], masks: int, context: Any) -> Blocks:
    """Memory for `n` environments with an observation space, an `info` as theirs, and masks of so many choices.

    `context`: how processes are started. Raises `ValueError` for an observation space that is neither a Box nor a Dict
    of them.
    """
    rows: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]
    rows = {OBSERVATION + name: (box.shape, np.dtype(box.dtype)) for name, box in boxes(space).items()}
    rows |= {MASK: ((masks,), np.dtype(np.bool_)), RECORD: ((), record_type(info))}
    return {
        name: Block(context.RawArray("B", max(1, n * int(np.prod(shape)) * dtype.itemsize)), dtype, (n, *shape))
        for name, (shape, dtype) in rows.items()
    }


def record_type(info: Mapping[str, Any]) -> np.dtype[Any]:
    """The numbers of one environment, side by side: reward, ends, and the numbers of its info."""
    kinds: list[Any] = list(zip(RESULT, ("f8", "?", "?", "?"), strict=True))
    kinds += [(INFO + name, number.dtype, number.shape) for name, number in numbers(info).items()]
    return np.dtype(kinds, align=True)


def info_names(record: np.dtype[Any]) -> list[str]:
    """The keys of an info that a record holds."""
    return [name.removeprefix(INFO) for name in record.names or () if name.startswith(INFO)]


def boxes(space: spaces.Space[Any]) -> dict[str, spaces.Box]:
    """The parts of an observation space by name. Raises `ValueError` for what is neither Box nor Dict of Box."""
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {ALONE: space}
    for name, part in parts.items():
        if not isinstance(part, spaces.Box):
            raise ValueError(
                f"observation space{name and f' {name!r}'}: {part!r:.80}, a batch takes Box, or Dict of Box"
            )
    return parts  # type: ignore[return-value]


def numbers(info: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The entries of an info that are numbers, or arrays of numbers; the others travel by message."""
    kinds = (bool, int, float, np.number, np.bool_, np.ndarray)
    given = {name: np.asarray(value) for name, value in info.items() if isinstance(value, kinds)}
    return {name: value for name, value in given.items() if value.dtype.kind in "biuf"}


def below(buffers: SharedBuffers, prefix: str) -> SharedBuffers:
    """The arrays whose names have the `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in buffers.items() if name.startswith(prefix)}


def copied(records: NDArray[Any]) -> NDArray[Any]:
    """A copy of records (n,) as a whole; NumPy copies them field by field."""
    return records.view(np.uint8).copy().view(records.dtype)


class WorkerEnvironments:
    """The environments of one worker and their rows of the shared buffers; it is made before the worker is started."""

    _buffers: SharedBuffers
    _seen: SharedBuffers
    _listed: dict[str, None]  # the keys of an info that a record holds

    def __init__(
        self, first: int, makers: Makers, blocks: Blocks, mode: AutoresetMode, spaces: tuple[Any, Any]
    ) -> None:
        """`first`: number of its first environment; `spaces`: of an observation and of an action, as in the batch."""
        self.env = self.first = first  # `env`: the one at work, for error messages
        self._makers, self._blocks, self._mode, self._spaces = makers, blocks, mode, spaces
        self._envs: list[gymnasium.Env[Any, Any]] = []
        self._masks: list[Callable[[], Any]] = []
        self._over = [False] * len(makers)
        self._started = [False] * len(makers)

    @property
    def place(self) -> str:
        return f"environment {self.env} of the batch"

    def open(self) -> None:
        """Make the environments. Raises `ValueError` for one with other spaces than the batch has."""
        self._buffers = {name: block.view() for name, block in self._blocks.items()}
        self._seen = below(self._buffers, OBSERVATION)
        self._listed = dict.fromkeys(info_names(self._buffers[RECORD].dtype))
        for env, maker in enumerate(self._makers, self.first):
            self.env = env
            self._envs.append(maker())
            if (self._envs[-1].observation_space, self._envs[-1].action_space) != self._spaces:
                raise ValueError(f"environment {env} has other spaces than the first one")
        if self._buffers[MASK].size:
            self._masks = [env.get_wrapper_attr("action_masks") for env in self._envs]

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None, chosen: Sequence[bool]) -> Infos:
        """Begin new episodes in the chosen environments."""
        numbered = ((place, self.first + place) for place in self._places() if chosen[place])
        return {env: self._begin(place, seeds[place], options) for place, env in numbered}

    def step(self, actions: Sequence[Any]) -> Infos:
        """One step in each environment, or in one whose episode is over what the autoreset mode says."""
        return {self.first + place: self._step(place, actions[place]) for place in self._places()}

    def run(self, name: str, items: Sequence[tuple[int, tuple[Any, ...]]]) -> Iterator[dict[int, Info | Failure]]:
        """One environment after another what `name` says, "step" or "reset", each with its own arguments.

        Yields what is finished every few milliseconds. An exception takes the place of the result.
        """
        act: Callable[..., Info] = self._step if name == "step" else self._begin
        finished: dict[int, Info | Failure] = {}
        begun = time.monotonic()
        for env, arguments in items:
            self.env = env
            try:
                finished[env] = act(env - self.first, *arguments)
            except Exception as error:
                finished[env] = Failure.of(error, self.place)
            if time.monotonic() - begun > ANSWER_S:
                yield finished
                finished, begun = {}, time.monotonic()
        if finished:
            yield finished

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

    def _step(self, place: int, action: Any) -> Info:
        return self._begin(place) if self._over[place] else self._advance(place, action)

    def _advance(self, place: int, action: Any) -> Info:
        """A step; in the mode SAME_STEP, a new episode where one ends."""
        observation, reward, terminated, truncated, info = self._envs[place].step(action)
        result = (float(reward), terminated, truncated)
        over = terminated or truncated
        if over and self._mode == AutoresetMode.SAME_STEP:
            last = {"final_obs": observation, "final_info": info}
            return last | self._begin(place, result=result)
        self._over[place] = over and self._mode == AutoresetMode.NEXT_STEP
        return self._show(place, observation, info, result)

    def _begin(
        self, place: int, seed: int | None = None, options: dict[str, Any] | None = None, result: Result = NOTHING
    ) -> Info:
        """The first observation of a new episode, beside the result of a step."""
        self._started[place] = True
        observation, info = self._envs[place].reset(seed=seed, options=options)
        processes.trim()  # buildings differ in size; what freed blocks leave behind grows from episode to episode
        self._over[place] = False
        return self._show(place, observation, info, result)

    def _show(self, place: int, observation: Any, info: Info, result: Result) -> Info:
        """Write all to the buffers; the part of the info without a place there is returned."""
        row = self.first + place
        parts = observation if isinstance(observation, dict) else {ALONE: observation}
        for name, array in self._seen.items():
            array[row] = parts[name]
        self._show_mask(place)
        records = self._buffers[RECORD]
        if not info.keys() >= self._listed.keys():
            for name, value in zip(RESULT, (*result, False), strict=True):
                records[name][row] = value
            return info
        records[row] = (*result, True, *map(info.__getitem__, self._listed))
        return {name: value for name, value in info.items() if name not in self._listed}

    def _show_mask(self, place: int) -> None:
        if self._masks and self._started[place]:
            self._buffers[MASK][self.first + place] = self._masks[place]()


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
            for answer in self._pool.arrived():
                self._land(answer)
        envs = sorted(list(self._landed)[:count])
        failed = [env for env in envs if isinstance(self._landed[env], Failure)]
        return {env: self._landed.pop(env) for env in failed[:1] or envs}

    def _land(self, answer: dict[int, Info | Failure] | Failure) -> None:
        if isinstance(answer, Failure):  # an answer that could not be sent: nothing is known of its environments
            answer.error.add_note(answer.note)
            raise answer.error
        self._flying -= answer.keys()
        self._landed |= answer
