"""The robot's path since it entered a room: whether it has left the room unnoticed, through a door not known then."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.slam.rooms.limits import RoomLimits


@dataclass(slots=True, eq=False)
class Trail:
    """Places `doorway_m` apart, and when they were passed; the oldest are forgotten."""

    places: Array = field(default_factory=lambda: np.empty((0, 4)))
    """(n,4): x, y in m, map frame; the step and the number of features then. The last is where the robot is now."""

    def add(self, step: int, features: int, T_map_robot: Array, config: RoomLimits) -> None:
        """Note where the robot is in a step, and how many features there are."""
        (x, y, _), n = T_map_robot.tolist(), len(self.places)
        places = self.places
        if n > 1 and math.dist((places.item(n - 2, 0), places.item(n - 2, 1)), (x, y)) < config.doorway_m:
            places[n - 1, 0], places[n - 1, 1] = x, y
            return
        kept = self.places[max(n - config.trail_places, 0) :]
        self.places = np.empty((len(kept) + 1, 4))
        self.places[:-1], self.places[-1] = kept, (x, y, step, features)

    def passed(self, jambs: Array) -> tuple[int, int] | None:
        """Step and number of features when the robot went through a gap (2,2) m for good; None if it did not."""
        at = last_crossing(self.places[:, :2], jambs)
        return None if at < 0 else (int(self.places[at, 2]), int(self.places[at, 3]))


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
