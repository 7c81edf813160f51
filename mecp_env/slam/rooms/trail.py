"""The robot's path since it entered a room: whether it has left the room unnoticed, through a door not known then."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.config import RoomConfig

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class Trail:
    """Places `trail_step_m` apart, and when they were passed; the oldest are forgotten."""

    p_map: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n,2) m, map frame; the last is where it is now
    since: Ints = field(default_factory=lambda: np.empty((0, 2), np.int64))  # (n,2) step, number of features then

    def add(self, step: int, features: int, T_map_robot: Array, config: RoomConfig) -> None:
        """Note where the robot is in a step, and how many features there are."""
        here, now = T_map_robot[None, :2], np.array([[step, features]])
        n = len(self.p_map)
        still = n > 1 and bool(np.hypot(*(self.p_map[n - 2] - here[0])) < config.trail_step_m)
        kept = slice(max(n - config.trail_places, 0), n - 1 if still else n)
        self.p_map = np.concatenate([self.p_map[kept], here])
        self.since = np.concatenate([self.since[kept], self.since[n - 1 :] if still else now])

    def passed(self, jambs: Array) -> tuple[int, int] | None:
        """Step and number of features when the robot went through a gap (2,2) m for good; None if it did not."""
        at = last_crossing(self.p_map, jambs)
        return None if at < 0 else (int(self.since[at, 0]), int(self.since[at, 1]))


@compiled
def last_crossing(path: Array, gap: Array) -> int:
    """The first place of the path (n,2) after it crossed a gap (2,2) for the last time; -1 if it ends where it began.

    A path that went through and came back crossed the gap as often one way as the other.
    """
    dx, dy = gap[1, 0] - gap[0, 0], gap[1, 1] - gap[0, 1]
    square = dx * dx + dy * dy
    net, last = 0, -1
    for i in range(1, path.shape[0]):
        px, py = path[i - 1, 0] - gap[0, 0], path[i - 1, 1] - gap[0, 1]
        qx, qy = path[i, 0] - gap[0, 0], path[i, 1] - gap[0, 1]
        before, after = dx * py - dy * px, dx * qy - dy * qx
        if (before > 0.0) == (after > 0.0):
            continue
        share = before / (before - after)
        along = (px + share * (qx - px)) * dx + (py + share * (qy - py)) * dy
        if 0.0 < along < square:
            net += 1 if after > 0.0 else -1
            last = i
    return last if net != 0 else -1
