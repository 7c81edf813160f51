"""A worker of a batch: a process that holds some of the environments and steps them one after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, SupportsFloat

import gymnasium
from gymnasium.vector import AutoresetMode

from mecp_env.vector.shared_buffers import ALONE, INFO, OBSERVATION, Fields, SharedBuffers, below, lay_out

Makers = Sequence[Callable[[], gymnasium.Env[Any, Any]]]
Infos = dict[int, dict[str, Any]]  # by number of the environment: the part of its info that has no place in the buffers


class WorkerEnvironments:
    """The environments of one worker and their rows of the shared buffers; it is made before the worker is started."""

    _buffers: SharedBuffers
    _seen: SharedBuffers
    _listed: SharedBuffers

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
        self._seen, self._listed = below(self._buffers, OBSERVATION), below(self._buffers, INFO)
        for env, maker in enumerate(self._makers, self.first):
            self.env = env
            self._envs.append(maker())
            if (self._envs[-1].observation_space, self._envs[-1].action_space) != self._spaces:
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
