"""A goal, and the list of goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.slam.messages import NO_ID


class GoalKind(IntEnum):
    """Kinds of goals, in the order of the list."""

    OPEN = 0  # the floor beyond an open edge of a polygon
    CANDIDATE = 1  # a gap that may be a door
    FRONTIER = 2  # unknown cells beside the known floor of a room
    DOOR = 3  # an unexplored door


class Outcome(IntEnum):
    """State of the drive to a goal."""

    RUNNING = 0
    REACHED = 1
    REFUSED = 2
    SETTLED = 3  # nothing was left to see before the robot arrived


OPEN, CANDIDATE, FRONTIER, DOOR = GoalKind  # a name is found much faster than a member of an enumeration
INTEGERS, LENGTHS = ("kind", "room", "level", "visits", "door"), ("size_m", "path_m")  # columns of `Goals`
LOCAL = (OPEN, CANDIDATE, FRONTIER)  # a room is complete without these


@dataclass(slots=True, eq=False)
class Goal:
    """One goal; visits, path and level are filled in later."""

    kind: GoalKind
    x: float  # m, map frame
    y: float
    size_m: float  # width of the opening
    room: int  # on this side
    door: int = NO_ID  # id, for a door
    visits: int = 0  # drives that ended there or were refused
    path_m: float = 0.0  # length of the path there
    level: int = 0  # of the polygon; door: of the room


@dataclass(frozen=True, slots=True, eq=False)
class Goals:
    """All goals: the current room first, in the order of kinds; then doors; then other rooms."""

    p_map: Array = field(default_factory=lambda: np.empty((0, 2)))  # (g,2) m, map frame
    kind: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) GoalKind
    size_m: Array = field(default_factory=lambda: np.empty(0))  # (g,) width of the opening
    room: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) on this side
    level: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) of the polygon; door: of the room
    path_m: Array = field(default_factory=lambda: np.empty(0))  # (g,) length of the path there
    visits: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) drives that ended there or were refused
    door: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) door id, NO_ID for the other kinds

    def __len__(self) -> int:
        return len(self.kind)

    @classmethod
    def of(cls, goals: Sequence[Goal]) -> Goals:
        """The list of some goals, in their order."""
        p_map = np.array([(goal.x, goal.y) for goal in goals], np.float64).reshape(-1, 2)
        kinds = dict.fromkeys(INTEGERS, np.int64) | dict.fromkeys(LENGTHS, np.float64)
        columns: Any = {name: np.array([getattr(goal, name) for goal in goals], kind) for name, kind in kinds.items()}
        return cls(p_map, **columns)
