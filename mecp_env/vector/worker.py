"""A worker of a batch: a process that holds some of the environments and steps them one after another."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode

from mecp_env.core import processes
from mecp_env.core.processes import Failure
from mecp_env.vector.shared_buffers import (
    ALONE,
    MASK,
    OBSERVATION,
    RECORD,
    RESULT,
    Fields,
    SharedBuffers,
    below,
    info_names,
    lay_out,
)

Makers = Sequence[Callable[[], gymnasium.Env[Any, Any]]]
Info = dict[str, Any]
Infos = dict[int, Info]  # by number of the environment: the part of its info that has no place in the buffers
Result = tuple[float, bool, bool]  # reward, terminated, truncated
NOTHING: Result = (0.0, False, False)  # of a reset
ANSWER_S = 0.004  # while there is more to do, what is finished is reported so often; an answer costs 0.1 ms


class WorkerEnvironments:
    """The environments of one worker and their rows of the shared buffers; it is made before the worker is started."""

    _buffers: SharedBuffers
    _seen: SharedBuffers
    _listed: dict[str, None]  # the keys of an info that a record holds

    def __init__(
        self, first: int, makers: Makers, fields: Fields, memory: Any, mode: AutoresetMode, spaces: tuple[Any, Any]
    ) -> None:
        """`first`: number of its first environment; `spaces`: of an observation and of an action, as in the batch."""
        self.env = self.first = first  # `env`: the one at work, for error messages
        self._makers, self._fields, self._memory, self._mode, self._spaces = makers, fields, memory, mode, spaces
        self._envs: list[gymnasium.Env[Any, Any]] = []
        self._masks: list[Callable[[], Any]] = []
        self._over = [False] * len(makers)
        self._started = [False] * len(makers)

    @property
    def place(self) -> str:
        return f"environment {self.env} of the batch"

    def open(self) -> None:
        """Make the environments. Raises `ValueError` for one with other spaces than the batch has."""
        self._buffers = lay_out(self._fields, self._memory)
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
