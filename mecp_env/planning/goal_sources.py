"""Sources of goals: open edges, floor outside polygons, rooms without a polygon, candidates, frontiers, doors.

Goals are few, so they are plain lists; only the cells of the grid are searched by a compiled function.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.planning import goal_search
from mecp_env.planning.config import GoalsConfig
from mecp_env.planning.goal_list import CANDIDATE, DOOR, FRONTIER, OPEN, Goal, GoalKind
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief, Door, EdgeLabel, rows_by_id
from mecp_env.slam.output import SlamOutput

Point = tuple[float, float]
OpenEdge = tuple[float, float, float, float, float, int]  # middle x, y, outward normal x, y, width, m, and room

OPEN_EDGE, GAP_EDGE = int(EdgeLabel.OPEN), int(EdgeLabel.GAP)


class DoorPlace(NamedTuple):
    """Position of a door in the map; nan without its jambs."""

    x: float  # m: its middle
    y: float
    onward_x: float  # unit normal from its first room on
    onward_y: float
    width: float  # m


@dataclass(frozen=True, slots=True, eq=False)
class GoalContext:
    """What the search for goals needs again and again."""

    slam_output: SlamOutput
    doors: list[DoorPlace]  # of the graph's doors

    @classmethod
    def of(cls, output: SlamOutput) -> GoalContext:
        """The context of a step."""
        return cls(output, door_places(output.graph.doors, output.belief))


def door_places(doors: Sequence[Door], belief: Belief) -> list[DoorPlace]:
    """Where doors are: the middle of the jambs of each, its width and direction from those of its first face."""
    jambs = np.array([door.jambs + (door.other_face or door.jambs) for door in doors], np.int64).reshape(-1, 4)
    p_map = np.concatenate((belief.p_map, [goal_search.NOWHERE]))
    first, second, third, fourth = p_map[rows_by_id(belief.ids, jambs)[jambs]].transpose(1, 0, 2)
    middle, across = (first + second + third + fourth) / 4.0, second - first
    width = np.maximum(np.hypot(across[:, 0], across[:, 1]), 1e-9)
    columns = (*middle.T, across[:, 1] / width, -across[:, 0] / width, width)
    return list(map(DoorPlace._make, np.stack(columns, axis=1).tolist()))


def length_of(dx: float, dy: float) -> float:
    """Length of a vector, with the last bit as compiled functions and arrays have it."""
    return float(np.hypot(dx, dy))


def find_everything(context: GoalContext, entry: dict[int, Array], config: GoalsConfig) -> list[Goal]:
    """All goals, reachable or not; `entry` tells where each room was entered, (2,) m, map frame.

    Where no polygon lies: beyond open edges; in rooms without one on floor outside polygons; in rooms that the robot
    has left not where it has been, as what can be seen from there was, and no polygon came of it. In rooms without
    either further in.
    """
    floor, frontiers = floor_goals(context, config)
    goals = open_goals(context, config)
    goals += without_rooms(floor, goals)
    goals = without_seen(goals, context.slam_output, config.seen_m)
    goals += without_rooms(empty_room_goals(context, entry, config), goals)
    return [*goals, *candidate_goals(context, config), *frontiers, *door_goals(context, config)]


def without_seen(goals: list[Goal], output: SlamOutput, near_m: float) -> list[Goal]:
    """The goals in the robot's room, and those that no key scan looked at from near.

    Near: from within `near_m` in the same room, or with no wall between.
    """
    here = output.graph.resolve(output.graph.current)
    places, beams = np.array([(goal.x, goal.y) for goal in goals], np.float64).reshape(-1, 2), output.beams
    half = 0.5 * (beams.bearings[-1] - beams.bearings[0]) if beams.blind else math.pi
    field = output.T_robot_laser.item(2) + beams.bearings.item(0) + half, half
    floor = output.grid.label, output.grid.origin, output.grid.resolution_m
    rooms, scans = np.array([goal.room for goal in goals], np.int64), (output.T_map_scans, output.scan_rooms)
    seen = goal_search.looked_at(places, rooms, scans, near_m, field, floor)
    return [goal for goal, done in zip(goals, seen.tolist(), strict=True) if goal.room == here or not done]


def without_rooms(goals: list[Goal], others: list[Goal]) -> list[Goal]:
    """The goals in rooms without any of the other goals."""
    rooms = {goal.room for goal in others}
    return [goal for goal in goals if goal.room not in rooms]


def open_goals(context: GoalContext, config: GoalsConfig) -> list[Goal]:
    """A goal beyond each wide open interval of a known polygon, unless another polygon covers the strip there.

    FREE cells do not close an open edge, or every edge would be closed by the scan that saw
    it; the paper asks for rooms divided into polygons, so that only a polygon does.
    Of those as near to each other as `apart_m` the widest.
    """
    found = uncovered_edges(context, (OPEN_EDGE, config.open_width_m, config.open_beyond_m))
    beyond = config.open_beyond_m
    goals = [Goal(OPEN, x + beyond * nx, y + beyond * ny, width, room) for x, y, nx, ny, width, room in found]
    return widest(goals, config.apart_m)


def widest(goals: list[Goal], apart_m: float) -> list[Goal]:
    """The widest of goals closer to each other than this."""
    if len(goals) < 2:
        return goals
    ordered = sorted(goals, key=lambda goal: -goal.size_m)
    kept = goal_search.far_apart(np.array([(goal.x, goal.y) for goal in ordered]), apart_m)
    return [ordered[k] for k in kept.tolist()]


def uncovered_edges(context: GoalContext, wanted: tuple[int, float, float]) -> list[OpenEdge]:
    """Intervals of known polygons beyond which none lies, however near: middle, outward normal, width, room.

    `wanted`: the EdgeLabel, the least width and the distance from the edge at which is looked, m.
    """
    output = context.slam_output
    polygons = [polygon for polygon in output.map_polygons if len(polygon.intervals)]
    if not polygons:
        return []
    edges = goal_search.uncovered_edges(polygons, output.belief, output.grid, wanted).tolist()
    rooms = [polygons[int(edge[5])].room for edge in edges]
    return [(*edge[:5], output.graph.resolve(room)) for edge, room in zip(edges, rooms, strict=True)]


def floor_goals(context: GoalContext, config: GoalsConfig) -> tuple[list[Goal], list[Goal]]:
    """The middle of each wide piece of floor that no polygon covers, and of each frontier to unknown cells.

    "There is no region of the room that is not occupied by at least one polygon" (III-B): a room just entered has no
    polygon yet, and none with an open edge. Frontiers lie between the floor of a room and unknown cells, away from
    doors and candidates.
    """
    uncovered, frontiers = goal_search.floor_clusters(context.slam_output.grid, barriers(context), config)
    return cluster_goals(OPEN, context, uncovered), cluster_goals(FRONTIER, context, frontiers)


def barriers(context: GoalContext) -> Array:
    """(d,2,2) the lines across the doors and the candidates, in cells: floor does not join floor there."""
    output, lines = context.slam_output, list[tuple[Point, Point]]()
    for door in context.doors:
        half_x, half_y = 0.5 * door.width * -door.onward_y, 0.5 * door.width * door.onward_x
        lines.append(((door.x - half_x, door.y - half_y), (door.x + half_x, door.y + half_y)))
    p_map = np.array([*lines, *(candidate.ends for candidate in output.graph.candidates)], np.float64)
    in_cells: Array = (p_map.reshape(-1, 2, 2) - output.grid.origin) / output.grid.resolution_m
    return in_cells


def cluster_goals(kind: GoalKind, context: GoalContext, clusters: Ints) -> list[Goal]:
    """A goal in the middle of each cluster (c,4) of cells: row, column, size, room."""
    grid, graph = context.slam_output.grid, context.slam_output.graph
    (left, low), cell = grid.origin.tolist(), grid.resolution_m
    return [
        Goal(kind, left + (column + 0.5) * cell, low + (row + 0.5) * cell, size * cell, graph.resolve(room))
        for row, column, size, room in clusters.tolist()
    ]


def empty_room_goals(context: GoalContext, entry: dict[int, Array], config: GoalsConfig) -> list[Goal]:
    """A place further into each room that was entered and has no polygon yet.

    Its floor may be covered all the same: when it is a known room, entered by another door, which a polygon will tell.
    """
    graph = context.slam_output.graph
    known = {graph.resolve(room) for room in {polygon.room for polygon in context.slam_output.map_polygons}}
    empty = sorted({room for room in entry if graph.resolve(room) == room} - known)
    places = [(room, further_in(entry[room], context.doors, config.further_m)) for room in empty]
    return [Goal(OPEN, x, y, config.uncovered_m, room) for room, (x, y) in places]


def further_in(p_entry: Array, doors: list[DoorPlace], further_m: float) -> Point:
    """A place so far from the nearest door beyond the one where a room was entered (2,) m."""
    if doors:
        middles = np.array([(door.x, door.y) for door in doors])
        onward = p_entry - middles[np.hypot(*(middles - p_entry).T).argmin()]
        p_entry = p_entry + further_m * onward / max(float(np.hypot(*onward)), 1e-9)
    return float(p_entry[0]), float(p_entry[1])


def candidate_goals(context: GoalContext, config: GoalsConfig) -> list[Goal]:
    """A place in front of each candidate."""
    gaps = list[OpenEdge]()
    for candidate in context.slam_output.graph.candidates:
        (ax, ay), (bx, by) = candidate.ends.tolist()  # right and left as seen from the room
        width = length_of(bx - ax, by - ay)
        onward_x, onward_y = (by - ay) / max(width, 1e-9), -(bx - ax) / max(width, 1e-9)
        room = context.slam_output.graph.resolve(candidate.room)
        gaps.append(((ax + bx) / 2.0, (ay + by) / 2.0, onward_x, onward_y, width, room))
    return in_front(gaps, context, config.candidate_m)


def gap_goals(context: GoalContext, config: GoalsConfig) -> list[Goal]:
    """A place in front of each gap in an edge of a known polygon where no door and no candidate is known.

    A door seen at a grazing angle shows one jamb or none, but the laser looks through it.
    """
    return widest(in_front(unexplained_gaps(context, config), context, config.candidate_m), config.apart_m)


def in_front(gaps: list[OpenEdge], context: GoalContext, away_m: float) -> list[Goal]:
    """A goal so far in front of each gap, or half way to a wall that is nearer, as in a narrow corridor."""
    if not gaps:
        return []
    wall_m = walls_ahead(context, gaps, -1.0, away_m)
    away = np.where(np.isinf(wall_m), away_m, 0.5 * wall_m).tolist()
    return [
        Goal(CANDIDATE, x - far * nx, y - far * ny, width, room)
        for (x, y, nx, ny, width, room), far in zip(gaps, away, strict=True)
    ]


def walls_ahead(context: GoalContext, gaps: list[OpenEdge], onward: float, most_m: float) -> Array:
    """(g,) m to the first wall within `most_m` behind each gap (`onward` 1) or in front of it (-1); inf without one."""
    grid, rays = context.slam_output.grid, np.array(gaps, np.float64)[:, :4]
    return goal_search.wall_ahead_m(
        grid.label, grid.origin, grid.resolution_m, rays * [1.0, 1.0, onward, onward], most_m
    )


def unexplained_gaps(context: GoalContext, config: GoalsConfig) -> list[OpenEdge]:
    """The gaps in edges of known polygons where a door is missing: none is known, nor a candidate, polygon or wall."""
    edges = uncovered_edges(context, (GAP_EDGE, 0.0, config.open_beyond_m))
    explained = are_explained(context, edges, config.same_gap_m) if edges else ()
    gaps = [gap for gap, known in zip(edges, explained, strict=True) if not known]
    if not gaps:
        return []
    walled = np.isfinite(walls_ahead(context, gaps, 1.0, config.wall_behind_m))
    return [gap for gap, wall in zip(gaps, walled.tolist(), strict=True) if not wall]


def are_explained(context: GoalContext, gaps: list[OpenEdge], near_m: float) -> list[bool]:
    """Whether a door or a candidate is known near each gap."""
    doors = [(door.x, door.y) for door in context.doors]
    candidates = [candidate.ends.mean(axis=0).tolist() for candidate in context.slam_output.graph.candidates]
    x, y = np.array([*doors, *candidates], np.float64).reshape(-1, 2).T
    gap_x, gap_y, *_ = np.array(gaps, np.float64).T[:, :, None]
    near: list[bool] = (np.hypot(gap_x - x, gap_y - y) < near_m).any(axis=1).tolist()
    return near


def door_goals(context: GoalContext, config: GoalsConfig) -> list[Goal]:
    """A place beyond each unexplored door."""
    graph, beyond = context.slam_output.graph, config.door_beyond_m
    return [
        Goal(
            DOOR,
            place.x + beyond * place.onward_x,
            place.y + beyond * place.onward_y,
            place.width,
            graph.resolve(door.rooms[0]),
            door.id,
        )
        for door, place in zip(graph.doors, context.doors, strict=True)
        if door.rooms[1] == UNKNOWN_ROOM
    ]
