"""Where there is something left to see (design 4.12): open edges, door candidates, frontiers, unexplored doors.

A goal lies in a room and has a level, so that a policy can explore breadth first. What cannot be reached, or is not
settled by going there, is given up: closed in the `GoalBook`. Without a goal the exploration is complete, only then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mecp_env.planning import goal_kernels as kernels
from mecp_env.planning.config import GoalsConfig, PlanningConfig
from mecp_env.planning.levels import door_levels, polygon_levels
from mecp_env.planning.paths import WayField, way_field
from mecp_env.slam.data import NO_ID, UNKNOWN_ROOM, Array, Belief, Door, Ints, KnownPolygon, RoomGraph, StepReport


class GoalKind(IntEnum):
    """What there is to see, in the order of the list."""

    OPEN = 0  # the floor beyond an open edge of a polygon
    CANDIDATE = 1  # a gap that may be a door
    FRONTIER = 2  # unknown cells beside the known floor of a room
    DOOR = 3  # a door nobody has gone through


BARRIER_CELLS = 1.5  # floor does not join floor so near to the line of a door
LOCAL = (GoalKind.OPEN, GoalKind.CANDIDATE, GoalKind.FRONTIER)  # a room is complete without these


@dataclass(frozen=True, slots=True, eq=False)
class Goals:
    """What is left to see: the current room first, in the order of kinds; then doors; then what other rooms hold."""

    p_map: Array = field(default_factory=lambda: np.empty((0, 2)))  # (g,2) m, map frame
    kind: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) GoalKind
    size_m: Array = field(default_factory=lambda: np.empty(0))  # (g,) width of the opening
    room: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) on this side
    level: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) of the polygon; door: of the room
    path_m: Array = field(default_factory=lambda: np.empty(0))  # (g,) length of the way there
    visits: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) drives that ended there or were refused
    door: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) door id, NO_ID for the other kinds

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, rows: Ints) -> Goals:
        """The goals of some rows (n,), in that order."""
        return Goals(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """What the search for goals needs of the map besides the grid."""

    room: NDArray[np.int16]  # (H,W) room of each cell, also of floor seen from outside that joins the floor of a room
    middles: Array  # (d,2) middles of the doors and the candidates, in cells


@dataclass(slots=True, eq=False)
class Remembered:
    """What became of the drives to one goal."""

    kind: int
    p_map: Array  # (2,) m
    visits: int = 0
    refusals: int = 0
    closed: bool = False  # given up: what lies there is no goal any more


@dataclass(slots=True, eq=False)
class GoalBook:
    """Memory over the periods of an episode: drives, and where each room was entered."""

    drives: list[Remembered] = field(default_factory=list)
    entry: dict[int, Array] = field(default_factory=dict)  # room -> (2,) m, where the robot first stood in it
    first_room: int = UNKNOWN_ROOM

    def notice(self, report: StepReport) -> None:
        """Remember where a room was entered."""
        room = report.graph.resolve(report.graph.current)
        if room not in self.entry:
            self.entry[room] = report.belief.T_map_robot[:2].copy()
        if self.first_room == UNKNOWN_ROOM:
            self.first_room = room

    def record(self, goals: Goals, row: int, reached: bool, config: GoalsConfig) -> None:
        """Remember that a drive to a goal ended: there, or refused. Often enough, and the goal is closed."""
        remembered = self.find(int(goals.kind[row]), goals.p_map[row], config.apart_m)
        if remembered is None:
            remembered = Remembered(int(goals.kind[row]), goals.p_map[row].copy())
            self.drives.append(remembered)
        remembered.visits += int(reached)
        remembered.refusals += int(not reached)
        remembered.closed = remembered.refusals >= config.refusals or remembered.visits >= config.visits

    def find(self, kind: int, p_map: Array, apart_m: float) -> Remembered | None:
        """What is remembered of a goal: the drive to one of its kind nearest to it, within `apart_m`."""
        same = [drive for drive in self.drives if drive.kind == kind]
        if not same:
            return None
        distance = [float(np.hypot(*(drive.p_map - p_map))) for drive in same]
        nearest = int(np.argmin(distance))
        return same[nearest] if distance[nearest] <= apart_m else None


def find_goals(report: StepReport, book: GoalBook, config: PlanningConfig) -> Goals:
    """All goals of a step that can be reached and are not closed in the book; see `Goals` for their order.

    Where none can be reached, the candidates out of reach: no episode ends while a candidate remains (design 4.12).
    """
    book.notice(report)
    if not report.grid.label.size:
        return Goals()
    field_ = way_field(report.grid, report.belief.T_map_robot, config.paths)
    floor = floor_of(report)
    goals = join(
        [
            uncovered_goals(report, floor, book, config.goals),
            candidate_goals(report, config.goals),
            frontier_goals(report, floor, config.goals),
            door_goals(report, config.goals),
        ]
    )
    goals = without_closed(goals, book, config.goals)
    near = with_paths(goals, field_, config.goals)
    goals = near if len(near) else out_of_reach(goals, report.belief.T_map_robot[:2])
    goals = with_levels(goals, report, book)
    return in_order(goals, report.graph.resolve(report.graph.current))


def complete_rooms(goals: Goals, book: GoalBook, graph: RoomGraph) -> tuple[int, ...]:
    """Rooms entered that hold no goal of the first three kinds any more."""
    busy = {int(room) for room, kind in zip(goals.room, goals.kind, strict=True) if kind in LOCAL}
    entered = {graph.resolve(room) for room in book.entry}
    return tuple(sorted(entered - busy - {UNKNOWN_ROOM}))


def make_goals(kind: GoalKind, p_map: Array, size_m: Array, room: Ints, door: Ints | None = None) -> Goals:
    """Goals of one kind; levels, ways and visits are not known yet."""
    n = len(p_map)
    zeros = np.zeros(n, np.int64)
    doors = np.full(n, NO_ID) if door is None else door
    return Goals(p_map, np.full(n, int(kind)), size_m, room, zeros, np.zeros(n), zeros.copy(), doors)


def join(parts: list[Goals]) -> Goals:
    """All goals in one list."""
    return Goals(*(np.concatenate([getattr(part, name) for part in parts]) for name in Goals.__dataclass_fields__))


def positions(belief: Belief, ids: Ints) -> Array:
    """(n,2) m, map frame: where the landmarks `ids` (n,) lie; nan for what is no landmark."""
    last = max(int(ids.max(initial=-1)), int(belief.ids.max(initial=-1)))
    p_map = np.full((last + 1, 2), np.nan)
    p_map[belief.ids] = belief.p_map
    return p_map[ids]


def uncovered_goals(report: StepReport, floor: Floor, book: GoalBook, config: GoalsConfig) -> Goals:
    """Where no polygon lies: beyond open edges; in rooms without one on bare floor; without either further in."""
    goals = open_goals(report, config)
    goals = join([goals, without_rooms(bare_goals(report, floor, config), goals)])
    return join([goals, without_rooms(empty_room_goals(report, book, config), goals)])


def without_rooms(goals: Goals, others: Goals) -> Goals:
    """The goals in rooms that hold none of the others."""
    return goals.take(np.flatnonzero(~np.isin(goals.room, others.room)))


def open_goals(report: StepReport, config: GoalsConfig) -> Goals:
    """A goal beyond each wide open interval of a known polygon, unless another polygon covers the strip there.

    Differs from the design: FREE cells do not close an open edge, or every edge would be closed by the scan that saw
    it; the paper asks for rooms divided into polygons, so that only a polygon does (front-end notes, section 3).
    """
    polygons = [polygon for polygon in report.known_polygons if len(polygon.intervals)]
    if not polygons:
        return Goals()
    strips = thin_out(strips_beyond(polygons, report, config), config.apart_m)
    rooms = np.array([report.graph.resolve(polygons[int(owner)].room) for owner in strips[:, 7]], np.int64)
    return make_goals(GoalKind.OPEN, strips[:, 2:4].copy(), strips[:, 6].copy(), rooms)


def strips_beyond(polygons: list[KnownPolygon], report: StepReport, config: GoalsConfig) -> Array:
    """(s,8) the uncovered strips beyond wide open edges, as from `goal_kernels.open_strips`."""
    ids = [polygon.ids for polygon in polygons]
    first = np.cumsum([0, *map(len, ids)])
    rings = positions(report.belief, np.concatenate(ids))
    owner = np.repeat(np.arange(len(polygons)), [len(polygon.intervals) for polygon in polygons])
    intervals = np.concatenate([polygon.intervals for polygon in polygons])
    limits = np.array([config.open_width_m, config.open_beyond_m])
    strips = kernels.open_strips(rings, first, intervals, owner, limits)
    grid = report.grid
    kept: Array = strips[kernels.uncovered(grid.polygon, strips, grid.origin, grid.resolution_m)]
    return kept


def thin_out(strips: Array, apart_m: float) -> Array:
    """The strips (s,8), the widest first, without those as near as `apart_m` to a wider one."""
    kept: list[int] = []
    for row in np.argsort(-strips[:, 6], kind="stable").tolist():
        x, y = strips[row, 2], strips[row, 3]
        if all(math.hypot(x - strips[other, 2], y - strips[other, 3]) > apart_m for other in kept):
            kept.append(row)
    return strips[kept]


def candidate_goals(report: StepReport, config: GoalsConfig) -> Goals:
    """A place in front of each gap that may be a door."""
    candidates = report.graph.candidates
    ends = np.array([candidate.ends for candidate in candidates]).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]  # from right to left as seen from the room
    width = np.hypot(along[:, 0], along[:, 1])
    back = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(width, 1e-9)[:, None]
    rooms = np.array([report.graph.resolve(candidate.room) for candidate in candidates], np.int64)
    return make_goals(GoalKind.CANDIDATE, ends.mean(axis=1) + config.candidate_m * back, width, rooms)


def door_places(doors: Sequence[Door], belief: Belief) -> tuple[Array, Array, Array]:
    """Of each door: its middle (d,2) m, map frame, the unit normal (d,2) from its first room on, its width (d,) m."""
    ids = np.array([(*door.jambs, *(door.other_face or door.jambs)) for door in doors], np.int64).reshape(-1, 4)
    p_jamb = positions(belief, ids.reshape(-1)).reshape(-1, 4, 2)
    along = p_jamb[:, 1] - p_jamb[:, 0]
    width = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
    onward = np.stack([along[:, 1], -along[:, 0]], axis=1) / width[:, None]
    return p_jamb.mean(axis=1), onward, width


def door_goals(report: StepReport, config: GoalsConfig) -> Goals:
    """A place beyond each door behind which nobody has been."""
    doors = [door for door in report.graph.doors if door.rooms[1] == UNKNOWN_ROOM]
    middle, onward, width = door_places(doors, report.belief)
    rooms = np.array([report.graph.resolve(door.rooms[0]) for door in doors], np.int64)
    ids = np.array([door.id for door in doors], np.int64)
    return make_goals(GoalKind.DOOR, middle + config.door_beyond_m * onward, width, rooms, ids)


def bare_goals(report: StepReport, floor: Floor, config: GoalsConfig) -> Goals:
    """The middle of each wide piece of floor that no polygon covers.

    "There is no region of the room that is not occupied by at least one polygon" (III-B): a room just entered has no
    polygon yet, and none with an open edge.
    """
    grid, cell = report.grid, report.grid.resolution_m
    span = max(round(config.bare_m / 2 / cell), 1)
    layers = (grid.label, grid.polygon, floor.room)
    marked = kernels.bare_cells(layers, span, floor.middles, config.door_clear_m / cell)
    return cluster_goals(GoalKind.OPEN, report, floor, marked, config.bare_cells)


def empty_room_goals(report: StepReport, book: GoalBook, config: GoalsConfig) -> Goals:
    """A place further into each room that was entered and has no polygon yet.

    Its floor may be covered all the same: when it is a known room, entered by another door, which a polygon will tell.
    """
    graph = report.graph
    known = {graph.resolve(polygon.room) for polygon in report.known_polygons}
    empty = sorted({room for room in book.entry if graph.resolve(room) == room} - known)
    doors, _, _ = door_places(graph.doors, report.belief)
    entries = np.array([book.entry[room] for room in empty]).reshape(-1, 2)
    for p_entry in entries if len(doors) else ():
        onward = p_entry - doors[np.hypot(*(doors - p_entry).T).argmin()]
        p_entry += config.further_m * onward / max(float(np.hypot(*onward)), 1e-9)
    return make_goals(GoalKind.OPEN, entries, np.full(len(empty), config.bare_m), np.array(empty, np.int64))


def frontier_goals(report: StepReport, floor: Floor, config: GoalsConfig) -> Goals:
    """The middle of each frontier between the floor of a room and unknown cells, away from doors and candidates."""
    clear = config.door_clear_m / report.grid.resolution_m
    marked = kernels.frontier_cells(report.grid.label, floor.room, floor.middles, clear)
    return cluster_goals(GoalKind.FRONTIER, report, floor, marked, config.frontier_cells)


def floor_of(report: StepReport) -> Floor:
    """The floor as goals are looked for on it."""
    grid = report.grid
    middle, onward, width = door_places(report.graph.doors, report.belief)
    half = 0.5 * width[:, None] * np.stack([-onward[:, 1], onward[:, 0]], axis=1)
    gaps = np.array([candidate.ends for candidate in report.graph.candidates]).reshape(-1, 2, 2)
    p_map = np.concatenate([np.stack([middle - half, middle + half], axis=1), gaps])
    lines = np.asarray((p_map - grid.origin) / grid.resolution_m, np.float64)
    return Floor(kernels.adopt_rooms(grid.label, grid.room, lines, BARRIER_CELLS), lines.mean(axis=1))


def cluster_goals(
    kind: GoalKind, report: StepReport, floor: Floor, marked: tuple[NDArray[np.uint8], Ints], least: int
) -> Goals:
    """A goal in the middle of each cluster of at least so many marked cells: flags (H,W), and the cells (n,2)."""
    grid = report.grid
    found = kernels.clusters(marked[0], marked[1], floor.room, least)
    p_map = np.asarray(grid.origin + (found[:, 1::-1] + 0.5) * grid.resolution_m, np.float64)
    rooms = np.array([report.graph.resolve(room) for room in found[:, 3].tolist()], np.int64)
    return make_goals(kind, p_map, np.asarray(found[:, 2] * grid.resolution_m, np.float64), rooms)


def with_paths(goals: Goals, field_: WayField, config: GoalsConfig) -> Goals:
    """The goals that can be reached, with the length of the way. A door counts from its near side."""
    cells = [field_.nearest(p_map, reach_of(kind, config)) for p_map, kind in zip(goals.p_map, goals.kind, strict=True)]
    rows = np.array([row for row, cell in enumerate(cells) if cell is not None], np.int64)
    goals = goals.take(rows)
    goals.path_m[:] = [field_.length_m(cell) for cell in cells if cell is not None]
    return goals


def reach_of(kind: int, config: GoalsConfig) -> float:
    """How near the robot must come, m: what lies beyond a door need not be known yet, its near side must be."""
    return config.reach_m + (config.door_beyond_m if kind == GoalKind.DOOR else 0.0)


def out_of_reach(goals: Goals, p_robot: Array) -> Goals:
    """The candidates, where no goal can be reached; no way is known, so that its length is the straight one."""
    goals = goals.take(np.flatnonzero(goals.kind == GoalKind.CANDIDATE))
    goals.path_m[:] = np.hypot(*(goals.p_map - p_robot).T)
    return goals


def without_closed(goals: Goals, book: GoalBook, config: GoalsConfig) -> Goals:
    """The goals that are not closed, with their visits."""
    memory = [book.find(int(k), p, config.apart_m) for k, p in zip(goals.kind, goals.p_map, strict=True)]
    still = [m for m in memory if m is None or not m.closed]
    goals = goals.take(np.flatnonzero([m is None or not m.closed for m in memory]))
    goals.visits[:] = [0 if m is None else m.visits + m.refusals for m in still]
    return goals


def with_levels(goals: Goals, report: StepReport, book: GoalBook) -> Goals:
    """The goals with their level: of the polygon nearest to them, or of the room for a door."""
    rooms = door_levels(report.graph, book.first_room)
    for row in range(len(goals)):
        room = int(goals.room[row])
        if goals.kind[row] == GoalKind.DOOR:
            goals.level[row] = rooms.get(room, len(rooms))
    for room in sorted({int(r) for r, k in zip(goals.room, goals.kind, strict=True) if k != GoalKind.DOOR}):
        centres, levels = polygon_levels(report, room, book.entry.get(room))
        rows = np.flatnonzero((goals.room == room) & (goals.kind != GoalKind.DOOR))
        if len(centres):
            far = np.hypot(*(goals.p_map[rows, None] - centres[None]).transpose(2, 0, 1))
            goals.level[rows] = levels[far.argmin(axis=1)]
    return goals


def in_order(goals: Goals, current: int) -> Goals:
    """Of the current room first: kind, level, way; then doors: level, way; then what is left in other rooms: way."""
    elsewhere = (goals.room != current) & (goals.kind != GoalKind.DOOR)
    kind, level = np.where(elsewhere, 0, goals.kind), np.where(elsewhere, 0, goals.level)
    return goals.take(np.lexsort((goals.path_m, level, kind, elsewhere)))
