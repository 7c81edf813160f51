"""Which environment a model was trained in: its actions and its observation, from the spaces of the model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.config import merge
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess
from mecp_env.episode.actions import make_actions
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.learning.downsampled import COLUMNS, TRUST
from mecp_env.policies import active

Space = spaces.Space[Any]
ACTIONS: dict[str, Space] = {
    "goal": spaces.Discrete(GOALS),
    "discrete": make_actions("discrete").space,
    "velocity": make_actions("velocity").space,
}
ON_REQUEST = ("map", "scan")  # parts of a dict that an environment has on request


@dataclass(frozen=True, slots=True)
class Fit:
    """The actions and the fields of `EnvConfig` with which an environment has the spaces of a model."""

    actions: str
    settings: dict[str, Any]
    channels_last: bool = False  # the model takes images (64,64,3)

    @property
    def format(self) -> str:
        """Of the observation: "dict", "flat" or "image"."""
        return str(self.settings.get("observation", {}).get("format", "dict"))

    @property
    def uncertainty(self) -> bool:
        """True when the observation has the predicted columns."""
        return bool(self.settings.get("observation", {}).get("uncertainty"))


def fit(observations: Space, actions: Space, name: str) -> Fit:
    """The fit of a model's spaces. Raises `ConfigError` where no environment has them, with the nearest one."""
    kind = fitting_actions(actions, name)
    if isinstance(observations, spaces.Dict):
        return Fit(kind, dict_settings(observations, kind, name))
    for settings in one_array():
        ours = space_of(kind, **settings)
        if same_array(observations, ours):
            return Fit(kind, with_known_ground(settings))
        if same_array(observations, ours, last=True):
            return Fit(kind, with_known_ground(settings), channels_last=True)
    raise ConfigError(
        f"policy: {name} was trained on the observation {observations}, which no environment has with "
        f"actions={kind!r}; the nearest is {nearest_array(observations, kind)}"
    )


def fitting_actions(space: Space, name: str) -> str:
    """The word for an action space. Raises `ConfigError` for one that no environment has."""
    for word, ours in ACTIONS.items():
        if space == ours:
            return word
    near = "velocity"
    if isinstance(space, spaces.Discrete):
        near = min(("discrete", "goal"), key=lambda word: abs(choices_of(word) - int(space.n)))
    have = ", ".join(f"{ours} of actions={word!r}" for word, ours in ACTIONS.items())
    raise ConfigError(
        f"policy: {name} was trained with the actions {space}; environments have {have}; "
        f"the nearest is actions={near!r}"
    )


def choices_of(actions: str) -> int:
    """How many actions there are of a discrete kind; 0 for velocities."""
    space = ACTIONS[actions]
    return int(space.n) if isinstance(space, spaces.Discrete) else 0


def one_array() -> tuple[dict[str, Any], ...]:
    """The fields of `ObservationConfig` of each observation that is one array."""
    return {"format": "flat", "uncertainty": False}, {"format": "flat", "uncertainty": True}, {"format": "image"}


@lru_cache(maxsize=16)
def space_of(actions: str, **observation: Any) -> Space:
    """The observation space of an environment with those fields; that of a scan depends on the laser."""
    env = gymnasium.make("mecp_env/Layout-v0", actions=actions, observation=observation, disable_env_checker=True)
    space: Space = env.observation_space
    env.close()
    return space


def same_array(theirs: Space, ours: Space, last: bool = False) -> bool:
    """True for arrays of one shape, both of bytes or both of floats; `last`: with the first axis of ours at the end.

    Bounds may differ: `VecNormalize` and wrappers change them.
    """
    mine, other = ours.shape or (), theirs.shape
    if last:
        mine = (*mine[1:], *mine[:1]) if len(mine) > 1 else ()
    return isinstance(theirs, spaces.Box) and other == mine and (theirs.dtype == np.uint8) == (ours.dtype == np.uint8)


def nearest_array(theirs: Space, actions: str) -> str:
    """The observation that is one array and nearest to a space by its axes and its size, as a keyword and a space."""
    shape = theirs.shape or ()

    def distance(settings: dict[str, Any]) -> tuple[int, int]:
        ours = space_of(actions, **settings).shape or ()
        return abs(len(ours) - len(shape)), abs(int(np.prod(ours)) - int(np.prod(shape)))

    near = min(one_array(), key=distance)
    return f"observation={near}: {space_of(actions, **near)}"


def dict_settings(theirs: spaces.Dict, actions: str, name: str) -> dict[str, Any]:
    """The fields with which an observation has the parts of a model, or more. Raises `ConfigError`."""
    parts = theirs.spaces
    goals = parts["goals"].shape if "goals" in parts else None
    uncertainty = TRUST in parts or (goals is not None and goals[-1:] > (COLUMNS,))
    asked = {part: True for part in ON_REQUEST if part in parts}
    for part, space in parts.items():
        check_part(part, space, space_of(actions, uncertainty=uncertainty, **asked), name)
    return with_known_ground(asked | ({"uncertainty": True} if uncertainty else {}))


def check_part(part: str, space: Space, ours: Any, name: str) -> None:
    """Raise `ConfigError` for a part that an environment does not have, or with another shape (but for a scan)."""
    if part not in ours.spaces:
        raise ConfigError(
            f"policy: {name} was trained on the part {part!r}; environments have {', '.join(ours.spaces)}, "
            f"on request {', '.join((*ON_REQUEST, TRUST))}{guess(part, ours.spaces)}"
        )
    if part != "scan" and space.shape != ours[part].shape:
        raise ConfigError(f"policy: {name} was trained on {part} {space.shape}, environments have {ours[part].shape}")


def with_known_ground(observation: dict[str, Any]) -> dict[str, Any]:
    """The fields of a policy with that observation: with `uncertainty` known ground is offered, too."""
    below = dict(active.SETTINGS) if observation.get("uncertainty") else {}
    return merge(below, {"observation": observation})
