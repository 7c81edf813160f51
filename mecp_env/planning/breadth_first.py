"""The paper's explorer: breadth first over the polygons of a room, the room completed before the next door."""

from __future__ import annotations

from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.planning.goals import GoalKind

PATH, KIND, ROOM, LEVEL, VALID = 2, 4, 5, 6, 8  # columns of the observation's goals


class BreadthFirst:
    """Selects a row of the observation's `goals` (32,9); reads nothing else, and never `info`.

    Our reading of "breadth first landmark search thus exploring the entire room before going to the next room" (III):

    1. While the robot's room has an open edge, a door candidate or a frontier, select one of those: nearest level of
       the room's polygon graph first (neighbours share a vertex, level 0 is where the room was entered), in a level the
       shortest path.
    2. Then the same in the nearest room that was left early: it is completed before a new one.
    3. Then an unexplored door: of the room fewest doors away from the first room, in a level the shortest path.

    The list contains the goals of the robot's room first, and then those of other rooms by path length. The room of the
    first row that is not a door is therefore the one to complete now.
    """

    def reset(self) -> None:
        """Start an episode; the policy has no state."""

    def act(self, observation: dict[str, Any], mask: Bools | None = None) -> int:
        """Row of the goal to drive to; 0 without goals. `mask` (32,) excludes rows."""
        goals = np.asarray(observation["goals"], np.float64)
        valid = (goals[:, VALID] > 0.5) & (goals[:, KIND] <= GoalKind.DOOR)
        if mask is not None:
            valid &= np.asarray(mask, np.bool_)
        rows = np.flatnonzero(valid)
        return int(min(rows, key=lambda row: rank(goals, int(row)))) if len(rows) else 0


def rank(goals: Array, row: int) -> tuple[float, ...]:
    """Order of the rows: the smallest is next."""
    kind, path, level = goals[row, KIND], goals[row, PATH], goals[row, LEVEL]
    if kind == GoalKind.DOOR:
        return 2.0, level, path
    here = goals[row, ROOM] == room_to_complete(goals)
    return (0.0, level, path) if here else (1.0, path, level)


def room_to_complete(goals: Array) -> float:
    """The room of the first goal that is not a door: the robot's room, or else the nearest room with goals."""
    local = np.flatnonzero((goals[:, VALID] > 0.5) & (goals[:, KIND] < GoalKind.DOOR))
    return float(goals[local[0], ROOM]) if len(local) else -1.0
