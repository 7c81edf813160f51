"""The paper's explorer: breadth first over the polygons of a room, the room completed before the next door."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.planning.goals import GoalKind

PATH, KIND, ROOM, LEVEL, VALID = 2, 4, 5, 6, 8  # columns of the observation's goals


class BreadthFirst:
    """Chooses a row of the observation's `goals` (32,9); reads nothing else, and never `info`.

    The reading of "breadth first landmark search thus exploring the entire room before going to the next room" (III):

    1. While the room in which the robot is holds an open edge, a door candidate or a frontier, one of those is next:
       the nearest level of the room's polygon graph first (neighbours share a vertex, level 0 is where the room was
       entered), in a level the shortest path.
    2. Then the same in the nearest room that was left early: it is completed before a new one.
    3. Then an unexplored door: of the room fewest doors away from the first room, in a level the shortest path.

    The list puts the goals of the robot's own room first, and then those of other rooms by the path there: so the room
    of the first row that is no door is the one to complete now.
    """

    def reset(self) -> None:
        """Begin an episode; the policy keeps nothing."""

    def act(self, observation: dict[str, Any], mask: NDArray[np.bool_] | None = None) -> int:
        """Row of the goal to drive to; 0 when there is none. `mask` (32,) bars rows."""
        goals = np.asarray(observation["goals"], np.float64)
        valid = goals[:, VALID] > 0.5
        if mask is not None:
            valid &= np.asarray(mask, np.bool_)
        rows = np.flatnonzero(valid)
        return int(min(rows, key=lambda row: rank(goals, int(row)))) if len(rows) else 0


def rank(goals: NDArray[np.float64], row: int) -> tuple[float, ...]:
    """Order of the rows: the least is next."""
    kind, path, level = goals[row, KIND], goals[row, PATH], goals[row, LEVEL]
    if kind == GoalKind.DOOR:
        return 2.0, level, path
    here = goals[row, ROOM] == room_to_complete(goals)
    return (0.0, level, path) if here else (1.0, path, level)


def room_to_complete(goals: NDArray[np.float64]) -> float:
    """The room of the first goal that is no door: the robot's own while that has any, else the nearest that has."""
    local = np.flatnonzero((goals[:, VALID] > 0.5) & (goals[:, KIND] != GoalKind.DOOR))
    return float(goals[local[0], ROOM]) if len(local) else -1.0
