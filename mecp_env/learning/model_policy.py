"""A policy that acts by a model of another library, on the observation that the model was trained on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from mecp_env.core.carriers import Bools
from mecp_env.core.errors import ConfigError
from mecp_env.learning.downsampled import goal_masks, without_known_ground
from mecp_env.learning.fits import Fit
from mecp_env.policies import active


class Model(Protocol):
    """What `ModelPolicy` needs of a model."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def predict(self, inputs: Any, mask: Bools | None) -> Any:
        """An action for an observation; `mask` (32,) excludes rows of goals, where there are goals."""


class ModelPolicy:
    """Gives a model what it was trained on, and its action to the environment."""

    def __init__(self, model: Model, fit: Fit, name: str, parts: Mapping[str, tuple[int, ...]] | None = None) -> None:
        self.model, self.fit, self.name, self.parts = model, fit, name, parts
        self.actions: str = fit.actions
        self.settings: Mapping[str, Any] = fit.settings
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Start an episode."""
        self.model.reset(seed)

    def act(self, observation: Any, mask: Any = None) -> Any:
        """A row of the goals or a discrete action, or velocities (2,) float32; `mask` (32,) excludes rows.

        One that was trained on tables without goals on known ground never chooses one, unless there is no other. Raises
        `ConfigError` for an observation without what it was trained on.
        """
        if self.actions == "velocity":
            return np.clip(np.asarray(self.model.predict(self._inputs(observation), None), np.float32), -1.0, 1.0)
        if self.actions == "discrete" or self.fit.format != "dict":
            return int(self.model.predict(self._inputs(observation), mask))
        seen, mine, allowed = own_goals(observation, mask, self.fit.uncertainty, self.name)
        if not mine.any() and allowed.any():
            return int(allowed.argmax())
        return int(self.model.predict(self._inputs(seen), mine))

    def check_space(self, space: Any) -> None:
        """Raise `ConfigError` for the observation space of an environment without the parts of the model."""
        if self.parts is not None:
            here = {part: np.zeros(box.shape, np.float32) for part, box in space.spaces.items()}
            fitting(self._known(here), self.parts, self.name)

    def _inputs(self, observation: Any) -> Any:
        if self.fit.format == "dict":
            seen = self._known(observation)
            return seen if self.parts is None else fitting(seen, self.parts, self.name)
        return np.moveaxis(observation, 0, -1) if self.fit.channels_last else observation

    def _known(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The tables without what a task adds to those that the model was trained on."""
        return observation if self.fit.uncertainty else without_known_ground(observation)


def batched(inputs: Any) -> Any:
    """An observation, or each of its parts, with a first axis of length 1."""
    if isinstance(inputs, dict):
        return {name: np.asarray(values)[None] for name, values in inputs.items()}
    return np.asarray(inputs)[None]


def own_goals(observation: Any, mask: Any, uncertainty: bool, name: str) -> tuple[Any, Bools, Bools]:
    """The tables as a policy saw them in its training, (32,) the rows it may choose, and all rows that are allowed.

    Raises `ConfigError` for a policy with `uncertainty` in an environment without.
    """
    if uncertainty:
        active.check_columns(observation, name)
    allowed = np.asarray(goal_masks(observation) if mask is None else mask, np.bool_)
    seen = observation if uncertainty else without_known_ground(observation)
    return seen, allowed & goal_masks(seen), allowed


def fitting(observation: dict[str, Any], theirs: Mapping[str, tuple[int, ...]], name: str) -> dict[str, Any]:
    """The parts of an observation with those shapes. Raises `ConfigError` where they do not fit."""
    here = {part: np.shape(values) for part, values in observation.items()}
    if any(here.get(part) != shape for part, shape in theirs.items()):
        raise ConfigError(f"policy: {name} was trained on {dict(theirs)}, the observation has {here}")
    return {part: observation[part] for part in theirs}
