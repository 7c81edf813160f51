"""The downsampled observation: the grid at two resolutions, and the expected gain of each goal."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.carriers import Bytes
from mecp_env.policies.gain import Gain, Weights
from mecp_env.policies.registry import KIND, PLACE, VALID

Observation = dict[str, NDArray[Any]]

POOL = 4  # cells of the grid along a side of a coarse one
NEAR = 32  # cells of the grid along a side of the near view: 3.2 m to each side of the robot
COLUMNS = 9  # of `goals` without the predicted ones
TABLES = ("pose", "pose_cov", "landmarks", "goals")
TRUST = "localisation"  # the fifth table, with `uncertainty`
GAIN = Gain(Weights(sight_m=6.0, beyond_m2=12.0))  # fixed here, because trained policies depend on it
MOST_M2 = np.float32(np.pi * GAIN.weights.sight_m**2)


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


class DownsampledObservation(gym.ObservationWrapper[Observation, Any, Observation]):
    """An environment with downsampled observations."""

    def __init__(self, env: gym.Env[Observation, Any], goals: bool) -> None:
        super().__init__(env)
        self.goals = goals
        self.observation_space: Any = downsampled_space(env.observation_space, goals)
        self._full: Observation = {}

    def observation(self, observation: Observation) -> Observation:
        """The downsampled form."""
        self._full = observation
        return downsample(observation, self.goals)

    def full_observation(self) -> Observation:
        """The last observation at full resolution, for explorers that use the grid."""
        return self._full
