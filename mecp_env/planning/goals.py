"""Goals: open edges, door candidates, frontiers, unexplored doors; levels of polygons and rooms, breadth first.

A goal belongs to a room and has a level, so that a policy can explore breadth first. A goal that cannot be reached, or
that stays open after visits, is given up: closed in the `GoalHistory`. Exploration is complete only when no goal is
left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.planning.config import GoalsConfig, PlanningConfig
from mecp_env.planning.goal_list import CANDIDATE, DOOR, LOCAL, OPEN, PLACE, Goal, GoalKind, Goals, Outcome
from mecp_env.planning.goal_sources import GoalContext, find_everything, gap_goals, length_of
from mecp_env.planning.navigator import CostToGoField, cost_to_go_field
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief, RoomGraph, rows_by_id
from mecp_env.slam.output import SlamOutput

__all__ = ["Goal", "GoalHistory", "GoalKind", "Goals", "Outcome", "Remembered", "complete_rooms", "find_goals"]


def levels_from(start: int, neighbours: dict[int, set[int]]) -> dict[int, int]:
    """Number of steps from `start` to every node that can be reached."""
    level, wave = {start: 0}, [start]
    while wave:
        onward = sorted({other for node in wave for other in neighbours.get(node, set())} - level.keys())
        level |= dict.fromkeys(onward, level[wave[0]] + 1)
        wave = onward
    return level


def door_levels(graph: RoomGraph, first_room: int) -> dict[int, int]:
    """Level of each room: how many doors lie between it and the first room."""
    neighbours: dict[int, set[int]] = {}
    for door in graph.doors:
        a, b = (UNKNOWN_ROOM if room == UNKNOWN_ROOM else graph.resolve(room) for room in door.rooms)
        if UNKNOWN_ROOM not in (a, b):
            neighbours.setdefault(a, set()).add(b)
            neighbours.setdefault(b, set()).add(a)
    return levels_from(graph.resolve(first_room), neighbours)


def polygon_levels(rings: list[Ints], belief: Belief, p_entry: Array | None) -> tuple[Array, Ints]:
    """Centres (p,2) (m, map frame) and levels (p,) of the polygons of a room, `rings` of vertex ids.

    Neighbours share a vertex. Level 0 is the polygon nearest to where the room was entered; polygons out of reach have
    the number of all as their level. A polygon with a vertex that is no landmark is left out.
    """
    ids = np.concatenate([np.empty(0, np.int64), *rings])
    rows, first = rows_by_id(belief.ids, ids)[ids], np.array([0, *accumulate(map(len, rings))], np.int64)
    entry = np.full(2, math.nan) if p_entry is None else p_entry
    return _ring_levels(rows, first, belief.p_map, entry)


@compiled
def _ring_levels(rows: Ints, first: Ints, p_map: Array, p_entry: Array) -> tuple[Array, Ints]:
    """See `polygon_levels`: ring p has the landmarks `rows` from first[p] on, -1: none; nan: entered at the first."""
    centres, ring = np.empty((first.shape[0] - 1, 2)), np.empty(first.shape[0] - 1, np.int64)
    count, start, best = 0, 0, math.inf
    for p in range(ring.shape[0]):
        own = np.sort(rows[first[p] : first[p + 1]])
        if own[0] < 0:
            continue
        x, y = 0.0, 0.0
        for row in own:
            x, y = x + p_map[row, 0], y + p_map[row, 1]
        centres[count, 0], centres[count, 1], ring[count] = x / own.shape[0], y / own.shape[0], p
        at = p_entry if p_entry[0] == p_entry[0] else centres[0]
        far = math.hypot(centres[count, 0] - at[0], centres[count, 1] - at[1])
        if far < best:
            start, best = count, far
        count += 1
    level, reached = np.full(count, count, np.int64), np.zeros(p_map.shape[0], np.bool_)
    level[start : start + 1] = 0
    wave, last = 0, 0
    while wave <= last:
        for k in range(count):
            for i in range(first[ring[k]], first[ring[k] + 1] if level[k] == wave else first[ring[k]]):
                reached[rows[i]] = True
        for k in range(count):
            for i in range(first[ring[k]], first[ring[k] + 1] if level[k] == count else first[ring[k]]):
                level[k], last = (wave + 1, wave + 1) if reached[rows[i]] else (level[k], last)
        wave += 1
    return centres[:count], level


def rings_by_room(output: SlamOutput, rooms: set[int]) -> dict[int, list[Ints]]:
    """The vertex ids of the known polygons of each room."""
    became = {room: output.graph.resolve(room) for room in {polygon.room for polygon in output.map_polygons}}
    rings: dict[int, list[Ints]] = {room: [] for room in rooms}
    for polygon in output.map_polygons:
        if became[polygon.room] in rooms:
            rings[became[polygon.room]].append(polygon.ids)
    return rings


@dataclass(slots=True, eq=False)
class Remembered:
    """Outcomes of the drives to one goal."""

    kind: int
    room: int  # on this side
    p_map: Array  # (2,) m
    visits: int = 0  # drives that ended there
    refusals: int = 0
    settled: int = 0  # drives that ended early because nothing was left to see
    closed: bool = False  # given up: no longer a goal


@dataclass(slots=True, eq=False)
class GoalHistory:
    """Memory over the steps of an episode: drives, and where each room was entered."""

    drives: list[Remembered] = field(default_factory=list)
    entry: dict[int, Array] = field(default_factory=dict)  # room -> (2,) m, first position of the robot in it
    first_room: int = UNKNOWN_ROOM
    retries: int = 0  # number of retries of refused goals
    good_place: Array | None = None  # (2,) m: the last one where the pose was well known
    searching: bool = False  # for the pose: only drives since then are remembered

    def notice(self, output: SlamOutput) -> None:
        """Record where a room was entered, and whether the pose is searched for.

        When it is lost, and when it is found, all drives are forgotten: no goal stays given up for a wrong pose.
        """
        if self.searching == output.localised:
            self.searching, self.drives = not output.localised, []
        room = output.graph.resolve(output.graph.current)
        if room not in self.entry:
            self.entry[room] = output.belief.T_map_robot[:2].copy()
        if self.first_room == UNKNOWN_ROOM:
            self.first_room = room
        merged = output.graph.merged
        for drive in self.drives if merged else ():
            if drive.room in merged:
                drive.room = output.graph.resolve(drive.room)

    def remember_good_place(self, belief: Belief, sigma_m: float) -> None:
        """Remember where the robot is, if the standard deviation of its position is at most `sigma_m`."""
        if math.sqrt(0.5 * (belief.pose_cov[0, 0] + belief.pose_cov[1, 1])) <= sigma_m:
            self.good_place = belief.T_map_robot[:2].copy()

    def record(self, goals: Goals, row: int, ended: Outcome, config: GoalsConfig) -> Remembered:
        """What is remembered of a goal after one more drive to it. Ended often enough, and the goal is closed.

        One visit to an open edge is enough: all that can be seen from there was, and no polygon came of it.
        One that was settled on the way has shown something: what is still to be seen there is a goal again.
        """
        kind, room, p_map = int(goals.kind[row]), int(goals.room[row]), goals.p_map[row]
        remembered = self.find(kind, room, (float(p_map[0]), float(p_map[1])), config.apart_m)
        if remembered is None:
            remembered = Remembered(kind, room, p_map.copy())
            self.drives.append(remembered)
        remembered.visits += int(ended == Outcome.REACHED)
        remembered.refusals += int(ended == Outcome.REFUSED)
        remembered.settled += int(ended == Outcome.SETTLED)
        remembered.closed = (
            remembered.refusals >= config.refusals
            or (remembered.visits >= (1 if kind == OPEN else config.visits) and kind != PLACE)
            or remembered.settled >= config.settled
        )
        return remembered

    def retry_refused(self, config: GoalsConfig) -> None:
        """Try refused goals again: a person in the path may have left."""
        refused = [drive for drive in self.drives if drive.closed and drive.refusals]
        if refused and self.retries < config.retries:
            self.retries += 1
            for drive in refused:
                drive.closed, drive.refusals = False, 0

    def find(self, kind: int, room: int, place: tuple[float, float], apart_m: float) -> Remembered | None:
        """What is remembered of a goal: the drive to one of its kind and room nearest to it, within `apart_m`.

        A drive in another room does not close a goal of this one.
        """
        alike = [drive for drive in self.drives if drive.kind == kind and drive.room == room]
        return nearest([(drive.p_map.tolist(), drive) for drive in alike], place, apart_m)

    def find_all(self, goals: list[Goal], apart_m: float) -> list[Remembered | None]:
        """The same for each goal."""
        alike: dict[tuple[int, int], list[Drive]] = {}
        for drive in self.drives:
            alike.setdefault((drive.kind, drive.room), []).append((drive.p_map.tolist(), drive))
        return [nearest(alike.get((goal.kind, goal.room), []), (goal.x, goal.y), apart_m) for goal in goals]


Drive = tuple[list[float], Remembered]  # where it went (x, y) m, and what is remembered of it


def nearest(drives: list[Drive], place: tuple[float, float], apart_m: float) -> Remembered | None:
    """The drive that went nearest to a place, within `apart_m`."""
    x, y = place
    beside = [(p, drive) for p, drive in drives if abs(p[0] - x) <= apart_m and abs(p[1] - y) <= apart_m]
    near = [(math.hypot(p[0] - x, p[1] - y), drive) for p, drive in beside]
    far, found = min(near, key=lambda pair: pair[0], default=(math.inf, None))
    return found if far <= apart_m else None


def find_goals(output: SlamOutput, history: GoalHistory, config: PlanningConfig) -> Goals:
    """All goals of a step that can be reached and are not closed in the history; see `Goals` for their order.

    Where none can be reached, the candidates and doors out of reach: no episode ends while one remains. While the pose
    is searched for, all are tried again when none is left.
    """
    history.notice(output)
    if not output.grid.label.size:
        return Goals()
    context = GoalContext.of(output)
    goals = without_closed(find_everything(context, history.entry, config.goals), history, config.goals)
    found = with_gaps(reachable(goals, output, config), context, history, config)
    found = found or out_of_reach(goals, output.belief.T_map_robot)
    if not found and history.searching and history.drives:
        history.drives = []
        return find_goals(output, history, config)
    goals = with_levels(found, output, history)
    return Goals.of(in_order(goals, output.graph.resolve(output.graph.current)))


def with_gaps(found: list[Goal], context: GoalContext, history: GoalHistory, config: PlanningConfig) -> list[Goal]:
    """The goals, and the gaps that nothing explains: of the robot's room when it has no other goal but doors, as it is
    completed before the next, and of all rooms when none has.
    """
    output = context.slam_output
    here = output.graph.resolve(output.graph.current)
    if any(goal.room == here and goal.kind in LOCAL for goal in found):
        return found
    gaps = not_visited(gap_goals(context, config.goals), history, config.goals)
    return found + reachable([gap for gap in gaps if gap.room == here or not found], output, config)


def complete_rooms(goals: Goals, history: GoalHistory, graph: RoomGraph) -> tuple[int, ...]:
    """Rooms entered that hold no goal of the first three kinds any more."""
    busy = {room for room, kind in zip(goals.room.tolist(), goals.kind.tolist(), strict=True) if kind in LOCAL}
    entered = {graph.resolve(room) for room in history.entry}
    return tuple(sorted(entered - busy - {UNKNOWN_ROOM}))


def without_closed(goals: list[Goal], history: GoalHistory, config: GoalsConfig) -> list[Goal]:
    """The goals that are not closed, with their visits."""
    still = []
    for goal, memory in zip(goals, history.find_all(goals, config.apart_m), strict=True):
        if memory is not None:
            goal.visits = memory.visits + memory.refusals + memory.settled
        if memory is None or not memory.closed:
            still.append(goal)
    return still


def not_visited(goals: list[Goal], history: GoalHistory, config: GoalsConfig) -> list[Goal]:
    """The goals where no drive ended and that are not closed; a door is confirmed in the time of one visit."""
    memories = history.find_all(goals, config.apart_m)
    seen = [memory is not None and (memory.closed or memory.visits > 0) for memory in memories]
    return [goal for goal, done in zip(goals, seen, strict=True) if not done]


def reachable(goals: list[Goal], output: SlamOutput, config: PlanningConfig) -> list[Goal]:
    """The goals that can be reached; over tight paths only where there is no other: a narrow door leads on."""
    if not goals:
        return []
    for tight in (False, True):
        found = with_paths(
            goals, cost_to_go_field(output.grid, output.belief.T_map_robot, config.paths, tight), config.goals
        )
        if found:
            break
    return found


def with_paths(goals: list[Goal], costs: CostToGoField, config: GoalsConfig) -> list[Goal]:
    """The goals that can be reached, with the length of the path. A door counts from its near side."""
    places = [(goal.x, goal.y, reach_of(goal.kind, config)) for goal in goals]
    near = []
    for goal, length_m in zip(goals, costs.lengths_m(places), strict=True):
        goal.path_m = length_m
        if length_m >= 0.0:
            near.append(goal)
    return near


def reach_of(kind: GoalKind, config: GoalsConfig) -> float:
    """How near the robot must come, m: what lies beyond a door need not be known yet, its near side must be."""
    return config.reach_m + (config.door_beyond_m if kind == DOOR else 0.0)


def out_of_reach(goals: list[Goal], T_map_robot: Array) -> list[Goal]:
    """The candidates and doors, where no goal can be reached; as no path is known, its length is the straight one."""
    x, y, _ = T_map_robot.tolist()
    kept = [goal for goal in goals if goal.kind in (CANDIDATE, DOOR)]
    for goal in kept:
        goal.path_m = length_of(goal.x - x, goal.y - y)
    return kept


def with_levels(goals: list[Goal], output: SlamOutput, history: GoalHistory) -> list[Goal]:
    """The goals with their level: of the polygon nearest to them, or of the room for a door."""
    doors = [goal for goal in goals if goal.kind == DOOR]
    rooms = door_levels(output.graph, history.first_room) if doors else {}
    for goal in doors:
        goal.level = rooms.get(goal.room, len(rooms))
    local = [goal for goal in goals if goal.kind != DOOR]
    for room, rings in rings_by_room(output, {goal.room for goal in local}).items():
        of_room = [goal for goal in local if goal.room == room]
        set_levels(of_room, *polygon_levels(rings, output.belief, history.entry.get(room)))
    return goals


def set_levels(goals: list[Goal], centres: Array, levels: Ints) -> None:
    """Give goals of a room the level of the polygon nearest to each, if there is one."""
    if not len(levels):
        return
    x, y = np.array([(goal.x, goal.y) for goal in goals]).T[:, :, None]
    nearest_one = np.hypot(x - centres[:, 0], y - centres[:, 1]).argmin(axis=1)
    for goal, level in zip(goals, levels[nearest_one].tolist(), strict=True):
        goal.level = level


def in_order(goals: list[Goal], current: int) -> list[Goal]:
    """Of the current room first: kind, level, path; then doors: level, path; then what is left in other rooms: path."""

    def rank(goal: Goal) -> tuple[bool, int, int, float]:
        elsewhere = goal.room != current and goal.kind != DOOR
        return elsewhere, 0 if elsewhere else goal.kind, 0 if elsewhere else goal.level, goal.path_m

    return sorted(goals, key=rank)
