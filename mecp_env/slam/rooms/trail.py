"""The robot's path since it entered a room: whether it has left the room unnoticed, through a door not known then."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.slam.config import RoomConfig


@dataclass(slots=True, eq=False)
class Trail:
    """Places `trail_step_m` apart, and when they were passed; the oldest are forgotten."""

    p_map: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n,2) m, map frame; the last is where it is now
    since: Ints = field(default_factory=lambda: np.empty((0, 2), np.int64))  # (n,2) step, number of features then

    def add(self, step: int, features: int, T_map_robot: Array, config: RoomConfig) -> None:
        """Note where the robot is in a step, and how many features there are."""
        here, n = T_map_robot[:2], len(self.p_map)
        if n > 1 and math.dist(self.p_map[n - 2].tolist(), here.tolist()) < config.trail_step_m:
            self.p_map[n - 1] = here
            return
        kept = slice(max(n - config.trail_places, 0), n)
        self.p_map = np.concatenate((self.p_map[kept], here[None]))
        self.since = np.concatenate((self.since[kept], ((step, features),)))

    def passed(self, jambs: Array) -> tuple[int, int] | None:
        """Step and number of features when the robot went through a gap (2,2) m for good; None if it did not."""
        at = last_crossing(self.p_map, jambs)
        return None if at < 0 else (int(self.since[at, 0]), int(self.since[at, 1]))


def last_crossing(path: Array, gap: Array) -> int:
    """The first place of the path (n,2) after it crossed a gap (2,2) for the last time; -1 if it ends where it began.

    A path that went through and came back crossed the gap as often one way as the other.
    """
    (dx, dy), p_gap = gap[1] - gap[0], path - gap[0]
    off = dx * p_gap[:, 1] - dy * p_gap[:, 0]
    before = np.flatnonzero((off[:-1] > 0.0) != (off[1:] > 0.0))
    share = off[before] / (off[before] - off[before + 1])
    crossing = p_gap[before] + share[:, None] * (p_gap[before + 1] - p_gap[before])
    along = crossing[:, 0] * dx + crossing[:, 1] * dy
    after = before[(along > 0.0) & (along < dx * dx + dy * dy)] + 1
    net = np.where(off[after] > 0.0, 1, -1).sum()
    return int(after[-1]) if net != 0 else -1
