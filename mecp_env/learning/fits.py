"""What a network reads: the downsampled observation (the grid at two resolutions, the expected gain of each goal), and
the observations and actions that the model of another library fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.config import merge
from mecp_env.core.carriers import Bools, Bytes
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.episode.actions import make_actions
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.policies import active
from mecp_env.policies.explorers import Gain, Weights
from mecp_env.policies.registry import KIND, PLACE, VALID

Observation = dict[str, NDArray[Any]]

POOL = 4  # cells of the grid along a side of a coarse one
NEAR = 32  # cells of the grid along a side of the near view: 3.2 m to each side of the robot
COLUMNS = 9  # of `goals` without the predicted ones
TABLES = ("pose", "pose_cov", "landmarks", "goals")
TRUST = "localisation"  # the fifth table, with `uncertainty`
GAIN = Gain(Weights(sight_m=6.0, beyond_m2=12.0))  # fixed here, because trained policies depend on it
MOST_M2 = np.float32(np.pi * GAIN.weights.sight_m**2)
Space = spaces.Space[Any]
ACTIONS: dict[str, Space] = {
    "goal": spaces.Discrete(GOALS),
    "discrete": make_actions("discrete").space,
    "velocity": make_actions("velocity").space,
}
OTHERS = "docs/submissions.md#other-models-and-wrappers"
ONE_ARRAY: tuple[dict[str, Any], ...] = (  # fields of `ObservationConfig` of each observation that is one array
    {"format": "flat", "uncertainty": False},
    {"format": "flat", "uncertainty": True},
    {"format": "image"},
)
ON_REQUEST = ("map", "scan")  # parts of a dict that an environment has on request


def downsample(observation: Observation, goals: bool) -> Observation:
    """The tables unchanged; `coarse` (8,24,24) and `near` (8,32,32) uint8 instead of `grid` (8,96,96).

    A coarse cell of 0.8 m is the mean of its 16 cells. With `goals` also `promise` (32,) m^2: the unknown floor that a
    scan from each goal would see according to this map, as the policy `gain` computes it; 0 on known ground.
    """
    grid = observation["grid"]
    low = (grid.shape[-1] - NEAR) // 2
    parts = {name: observation[name] for name in tables_in(observation)}
    parts |= {"coarse": pooled(grid), "near": grid[:, low : low + NEAR, low : low + NEAR].copy()}
    return parts | {"promise": promises(observation)} if goals else parts


def without_known_ground(observation: Observation) -> Observation:
    """The observation as of an environment without `uncertainty`: nine columns, no rows of places or waiting."""
    goals = observation["goals"]
    if goals.shape[-1] == COLUMNS:
        return observation
    table = goals[:, :COLUMNS].copy()
    table[table[:, KIND] >= PLACE] = 0.0
    return {name: values for name, values in observation.items() if name != TRUST} | {"goals": table}


def promises(observation: Observation) -> NDArray[np.float32]:
    """(32,) m^2 of unknown floor visible from each goal; 0 in empty rows."""
    table = observation["goals"]
    valid = goal_masks(observation) & (table[:, KIND] < PLACE)
    area = np.zeros(len(table), np.float32)
    if valid.any():
        expected = GAIN.expected_area(observation["grid"], table[valid].astype(np.float64))
        area[valid] = np.minimum(expected, MOST_M2)
    return area


def goal_masks(observation: Any) -> Any:
    """(...,32) which rows of `goals` hold one, of NumPy arrays or tensors, of one observation or a batch."""
    return observation["goals"][..., VALID] > 0.5


def tables_in(parts: Any) -> tuple[str, ...]:
    """The tables among the parts of an observation, or of its space."""
    return (*TABLES, TRUST) if TRUST in parts else TABLES


def pooled(grid: Bytes) -> Bytes:
    """(...,n/4,n/4) uint8 means of blocks of 4 x 4 cells, each 0 or 255."""
    bits = (grid & 1).view(np.uint8)  # 255 -> 1
    rows = bits.reshape(*grid.shape[:-2], grid.shape[-2] // POOL, POOL, grid.shape[-1])
    tall = rows[..., 0, :] + rows[..., 1, :] + rows[..., 2, :] + rows[..., 3, :]
    both = tall.reshape(*tall.shape[:-1], -1, POOL)
    count = both[..., 0] + both[..., 1] + both[..., 2] + both[..., 3]
    means: Bytes = np.minimum(count.astype(np.uint16) * 16, 255).astype(np.uint8)
    return means


def downsampled_space(space: Any, goals: bool) -> spaces.Dict:
    """The space of downsampled observations, of those in a `Dict`; the grid has 4 n cells per side."""
    grid = space["grid"].shape
    parts: dict[str, spaces.Space[Any]] = {name: space[name] for name in tables_in(space.spaces)}
    for name, side in (("coarse", grid[-1] // POOL), ("near", NEAR)):
        parts[name] = spaces.Box(0, 255, (grid[0], side, side), np.uint8)
    if goals:
        parts["promise"] = spaces.Box(np.float32(0.0), MOST_M2, space["goals"].shape[:1], np.float32)
    return spaces.Dict(parts)


def downsampled(env: gym.Env[Observation, Any], goals: bool) -> gym.Env[Observation, Any]:
    """An environment with downsampled observations."""
    space: Any = downsampled_space(env.observation_space, goals)
    return gym.wrappers.TransformObservation(env, partial(downsample, goals=goals), space)


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


def fit(observations: Space, actions: Space, name: str, normalised: bool = False) -> Fit:
    """The fit of a model's spaces. Raises `ConfigError` where no environment has them, with those that there are.

    `normalised`: the statistics of `VecNormalize` are known, which changes the bounds of the observation.
    """
    kind = next((word for word, ours in ACTIONS.items() if actions == ours), None)
    if kind is None:
        raise unfit(name, "the actions", actions, {f" with actions={word!r}": ours for word, ours in ACTIONS.items()})
    asked = (settings_of(observations),) if isinstance(observations, spaces.Dict) else ONE_ARRAY
    for settings, last in product(asked, (False, True)):
        if is_same(observations, space_of(kind, **settings), last, normalised):
            return Fit(kind, with_known_ground(settings), channels_last=last)
    have = {f" with observation={settings}": space_of(kind, **settings) for settings in asked}
    raise unfit(name, "the observation", observations, have)


def unfit(name: str, what: str, theirs: Space, ours: Mapping[str, Space]) -> ConfigError:
    """The error of a model with a space that no environment has; `ours` by the option that selects each."""
    have = ", ".join(f"{in_words(space)}{option}" for option, space in ours.items())
    return ConfigError(
        f"policy: {name} was trained on {what} {in_words(theirs)}; environments have {have}; what wrappers change in "
        f"training, as by stacking frames, a class repeats ({OTHERS})"
    )


def in_words(space: Space) -> str:
    """A space without the bounds of each of its numbers."""
    if isinstance(space, spaces.Dict):
        return f"Dict({', '.join(f'{part} {in_words(inner)}' for part, inner in space.items())})"
    if not isinstance(space, spaces.Box):
        return f"{space!s:.200}"
    return f"Box({space.low.min():g}, {space.high.max():g}, {space.shape}, {space.dtype})"


def settings_of(theirs: spaces.Dict) -> dict[str, Any]:
    """The fields with which an observation has the parts of a model, or more."""
    goals = theirs.spaces["goals"].shape if "goals" in theirs.spaces else None
    uncertainty = TRUST in theirs.spaces or (goals is not None and goals[-1:] > (COLUMNS,))
    asked = {part: True for part in ON_REQUEST if part in theirs.spaces}
    return asked | ({"uncertainty": True} if uncertainty else {})


def is_same(theirs: Space, ours: Any, last: bool, normalised: bool) -> bool:
    """True for arrays of one shape and with the same bounds, unless `normalised`; of parts, each of them is in ours.

    Other bounds are those of a wrapper: the model would see other values here. `last`: with the first axis of ours at
    the end. The shape and the bounds of a scan are the laser's, which the model does not select.
    """
    if isinstance(theirs, spaces.Dict) and isinstance(ours, spaces.Dict):
        own = [(space, ours.spaces.get(part)) for part, space in theirs.items() if part != "scan"]
        return not last and all(is_same(their, our, last, normalised) for their, our in own)
    return isinstance(theirs, spaces.Box) and isinstance(ours, spaces.Box) and same_box(theirs, ours, last, normalised)


def same_box(theirs: spaces.Box, ours: spaces.Box, last: bool, normalised: bool) -> bool:
    """The same for arrays."""
    bounds = normalised or (theirs.low.min(), theirs.high.max()) == (ours.low.min(), ours.high.max())
    return bounds and theirs.shape == ((*ours.shape[1:], *ours.shape[:1]) if last else ours.shape)


def choices_of(actions: str) -> int:
    """How many actions there are of a discrete kind; 0 for velocities."""
    space = ACTIONS[actions]
    return int(space.n) if isinstance(space, spaces.Discrete) else 0


@lru_cache(maxsize=16)
def space_of(actions: str, **observation: Any) -> Space:
    """The observation space of an environment with those fields; that of a scan depends on the laser."""
    env = gym.make("mecp_env/Layout-v0", actions=actions, observation=observation, disable_env_checker=True)
    space: Space = env.observation_space
    env.close()
    return space


def with_known_ground(observation: dict[str, Any]) -> dict[str, Any]:
    """The fields of a policy with that observation: with `uncertainty` known ground is offered, too."""
    below = dict(active.SETTINGS) if observation.get("uncertainty") else {}
    return merge(below, {"observation": observation})


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
        seen = self._inputs(observation)
        if self.actions == "velocity":
            return np.clip(np.asarray(self._predict(seen, None), np.float32), -1.0, 1.0)
        if self.actions == "discrete" or self.fit.format != "dict":
            return int(self._predict(seen, mask))
        allowed = np.asarray(goal_masks(observation) if mask is None else mask, np.bool_)
        mine = allowed & goal_masks(self._known(observation))
        if not mine.any() and allowed.any():
            return int(allowed.argmax())
        return int(self._predict(seen, mine))

    def _predict(self, seen: Any, mask: Any) -> Any:
        try:
            return self.model.predict(seen, mask)
        except MecpError:
            raise
        except Exception as error:  # a model of the user may raise anything
            what = {part: np.shape(values) for part, values in seen.items()} if isinstance(seen, dict) else seen.shape
            lines = str(error).strip().split("\n")
            reason = lines[-1] if lines[-1].startswith("RuntimeError") else lines[0]  # below a trace of TorchScript
            raise ConfigError(f"policy: {self.name} cannot act on the observation {what}: {reason:.200}") from error

    def _inputs(self, observation: Any) -> Any:
        if self.fit.format == "dict":
            seen = self._known(observation)
            return seen if self.parts is None else fitting(seen, self.parts, self.name)
        return np.moveaxis(observation, 0, -1) if self.fit.channels_last else observation

    def _known(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The tables without what a task adds to those that the model was trained on."""
        if not self.fit.uncertainty:
            return without_known_ground(observation)
        active.check_columns(observation, self.name)
        return observation


def batched(inputs: Any) -> Any:
    """An observation, or each of its parts, with a first axis of length 1."""
    if isinstance(inputs, dict):
        return {name: np.asarray(values)[None] for name, values in inputs.items()}
    return np.asarray(inputs)[None]


def fitting(observation: dict[str, Any], theirs: Mapping[str, tuple[int, ...]], name: str) -> dict[str, Any]:
    """The parts of an observation with those shapes. Raises `ConfigError` where they do not fit."""
    here = {part: np.shape(values) for part, values in observation.items()}
    if any(here.get(part) != shape for part, shape in theirs.items()):
        raise ConfigError(f"policy: {name} was trained on {dict(theirs)}, the observation has {here}")
    return {part: observation[part] for part in theirs}
