"""A goal, the list of goals, and how long each row of it takes: waiting has a time too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.planning.config import PlanningConfig
from mecp_env.slam.messages import NO_ID

AHEAD_M = 4.0  # where a deviation of the heading counts as one of the position
INTEGERS = ("kind", "room", "level", "visits", "door")  # columns of `Goals`
LENGTHS = ("size_m", "path_m", "sigma_m", "sigma_rad", "gain_nat")


class GoalKind(IntEnum):
    """Kinds of goals, in the order of the list."""

    OPEN = 0  # the floor beyond an open edge of a polygon
    CANDIDATE = 1  # a gap that may be a door
    FRONTIER = 2  # unknown cells beside the known floor of a room
    DOOR = 3  # an unexplored door
    PLACE = 4  # known ground, from which the robot may recognise what it has mapped
    WAIT = 5  # where the robot is
    LOOK = 6  # open floor ahead, while the pose is searched for: another view may be recognised


class PlaceKind(IntEnum):
    """Why a place on known ground is a goal."""

    GOOD = 0  # the last place where the pose was well known
    LOOP = 1  # left long ago, and near: to come back closes a loop
    LANDMARKS = 2  # many well-known landmarks are in view


class Outcome(IntEnum):
    """State of the drive to a goal."""

    RUNNING = 0
    REACHED = 1
    REFUSED = 2
    SETTLED = 3  # nothing was left to see before the robot arrived
    UNLOCALISED = 4  # the robot no longer knows where it is, and so where the goal is


OPEN, CANDIDATE, FRONTIER, DOOR, PLACE, WAIT, LOOK = (
    GoalKind  # a name is found much faster than a member of an enumeration
)
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
    level: int = 0  # of the polygon; door: of the room; place: `PlaceKind`
    sigma_m: float = 0.0  # predicted standard deviation of the position on arrival
    sigma_rad: float = 0.0  # the same, of the heading
    gain_nat: float = 0.0  # predicted gain of information about landmarks on the way


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
    sigma_m: Array = field(default_factory=lambda: np.empty(0))  # (g,) predicted sigma of the position on arrival
    sigma_rad: Array = field(default_factory=lambda: np.empty(0))  # (g,) the same, of the heading
    gain_nat: Array = field(default_factory=lambda: np.empty(0))  # (g,) predicted gain of landmark information

    def __len__(self) -> int:
        return len(self.kind)

    def rows(self, most: int) -> list[Goal]:
        """The first goals of the list, at most so many, one by one."""
        kinds, places = [GoalKind(kind) for kind in self.kind[:most].tolist()], self.p_map[:most].tolist()
        rest = [getattr(self, name)[:most].tolist() for name in (*INTEGERS[1:], *LENGTHS)]
        names = (*INTEGERS[1:], *LENGTHS)
        return [
            Goal(kind, x, y, **dict(zip(names, values, strict=True)))
            for kind, (x, y), *values in zip(kinds, places, *rest, strict=True)
        ]

    def in_order(self, order: Ints) -> Goals:
        """The goals `order` (k,) of the list."""
        return Goals(**{column.name: getattr(self, column.name)[order] for column in fields(self)})

    def actions(self, choices: int, apart: bool) -> Ints:
        """(g,) the action of each goal; if they are `apart`, known ground and waiting have the last of all `choices`.

        So where waiting is offered, the last action waits, and the one before it drives to the best place.
        """
        rows = np.arange(len(self))
        return np.where(self.kind < PLACE, rows, rows + choices - len(self)) if apart else rows

    def at(self, action: int, choices: int, apart: bool) -> int | None:
        """Where in the list the goal of that action is; None where it has none."""
        found = np.flatnonzero(self.actions(choices, apart) == action)
        return int(found[0]) if len(found) else None

    @classmethod
    def of(cls, goals: Sequence[Goal]) -> Goals:
        """The list of some goals, in their order."""
        p_map = np.array([(goal.x, goal.y) for goal in goals], np.float64).reshape(-1, 2)
        kinds = dict.fromkeys(INTEGERS, np.int64) | dict.fromkeys(LENGTHS, np.float64)
        columns: Any = {name: np.array([getattr(goal, name) for goal in goals], kind) for name, kind in kinds.items()}
        return cls(p_map, **columns)


def drawing_sigma(sigma_m: Array, sigma_rad: Array) -> Array:
    """(k,) m: standard deviation of where the robot draws a wall 4 m ahead, by those of its position and heading."""
    drawn: Array = np.hypot(sigma_m, AHEAD_M * sigma_rad)
    return drawn


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Seconds that a drive to a goal takes at least: its path at full speed; of waiting, all its steps."""

    speed_m_s: float = 0.75
    wait_s: float = 0.0

    @classmethod
    def of(cls, config: PlanningConfig) -> RowTimes:
        """Those of a configuration."""
        return cls(config.control.speed_m_s, config.known_ground.wait_steps * config.control.period_s)

    def seconds(self, goals: Goals) -> Array:
        """(g,) s of each goal."""
        seconds: Array = np.where(goals.kind == WAIT, self.wait_s, goals.path_m / self.speed_m_s)
        return seconds

    def best(self, goals: Goals, most: int) -> int | None:
        """The row, of the first `most`, that takes the least time of those that explore; None without a goal.

        Without one that explores: of open floor and places on known ground; waiting is the last resort.
        """
        kind = goals.kind[:most]
        if not len(kind):
            return None
        return int(np.lexsort((self.seconds(goals)[:most], kind >= PLACE, kind == WAIT))[0])
