"""The observation in a form that is quick to learn from: the grid at two resolutions, and what each goal promises."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.policies.gain import Gain, Weights

Observation = dict[str, NDArray[Any]]

POOL = 4  # cells of the grid along a side of a coarse one
NEAR = 32  # cells of the grid along a side of the near view: 3.2 m to each side of the robot
TABLES = ("pose", "pose_cov", "landmarks", "goals")
VALID = 8  # column of `goals`
RECKONER = Gain(Weights(sight_m=6.0, beyond_m2=12.0))  # said here, because trained policies depend on it
MOST_M2 = np.float32(np.pi * RECKONER.weights.sight_m**2)


def compact(observation: Observation, goals: bool) -> Observation:
    """The tables as they are; `coarse` (8,24,24) and `near` (8,32,32) uint8 in place of `grid` (8,96,96).

    A coarse cell of 0.8 m holds the mean of its 16. With `goals` also `promise` (32,) m^2: the unknown floor that a
    scan from each goal would see by this map, as `gain` reckons it.
    """
    grid = observation["grid"]
    low = (grid.shape[-1] - NEAR) // 2
    parts = {name: observation[name] for name in TABLES}
    parts |= {"coarse": pooled(grid), "near": grid[:, low : low + NEAR, low : low + NEAR].copy()}
    return parts | {"promise": promises(observation)} if goals else parts


def promises(observation: Observation) -> NDArray[np.float32]:
    """(32,) m^2 of unknown floor in sight of each goal; 0 in rows that hold none."""
    table = observation["goals"]
    valid = table[:, VALID] > 0.5
    area = np.zeros(len(table), np.float32)
    if valid.any():
        expected = RECKONER.expected_area(observation["grid"], table[valid].astype(np.float64))
        area[valid] = np.minimum(expected, MOST_M2)
    return area


def pooled(grid: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(...,n/4,n/4) uint8 means of the blocks of 4 x 4 cells, each 0 or 255."""
    bits = (grid & 1).view(np.uint8)  # 255 -> 1
    rows = bits.reshape(*grid.shape[:-2], grid.shape[-2] // POOL, POOL, grid.shape[-1])
    tall = rows[..., 0, :] + rows[..., 1, :] + rows[..., 2, :] + rows[..., 3, :]
    both = tall.reshape(*tall.shape[:-1], -1, POOL)
    count = both[..., 0] + both[..., 1] + both[..., 2] + both[..., 3]
    means: NDArray[np.uint8] = np.minimum(count.astype(np.uint16) * 16, 255).astype(np.uint8)
    return means


def compact_space(space: spaces.Dict, goals: bool) -> spaces.Dict:
    """The space of compact observations. The grid's cells along a side must divide by 4."""
    grid = space["grid"].shape
    assert grid is not None
    parts: dict[str, spaces.Space[Any]] = {name: space[name] for name in TABLES}
    for name, side in (("coarse", grid[-1] // POOL), ("near", NEAR)):
        parts[name] = spaces.Box(0, 255, (grid[0], side, side), np.uint8)
    rows = space["goals"].shape
    if goals and rows is not None:
        parts["promise"] = spaces.Box(0.0, MOST_M2, (rows[0],), np.float32)
    return spaces.Dict(parts)


class Compact(gym.ObservationWrapper[Observation, Any, Observation]):
    """An environment with compact observations."""

    def __init__(self, env: gym.Env[Observation, Any], goals: bool) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.Dict)
        self.goals = goals
        self.observation_space = compact_space(env.observation_space, goals)
        self._plain: Observation = {}

    def observation(self, observation: Observation) -> Observation:
        """The compact form."""
        self._plain = observation
        return compact(observation, self.goals)

    def plain(self) -> Observation:
        """The last observation in its own form, for explorers that look at the grid."""
        return self._plain
