"""Rooms as what is left of the floor when its doors are closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.polygon import orient

from mecp_env.floorplans.door_detection import Gap
from mecp_env.floorplans.options import PlanOptions
from mecp_env.world.outline import ROBOT_RADIUS_M

CLOSED_M = 2e-3  # thickness of a closed door: the polygons of the rooms are so far apart
SLIT_M = 0.01  # width of the cut that makes one ring of a room with others inside of it
BEHIND_M = 0.08  # how far behind a doorway its room is looked up


@dataclass(frozen=True, slots=True, eq=False)
class Rooms:
    """The floor in parts."""

    floors: list[Polygon]  # m
    doors: list[Gap]
    sides: list[tuple[int, int]]  # rooms before and behind each door


def split(area: Polygon, doors: list[Gap], options: PlanOptions) -> Rooms:
    """The rooms of `area` and those of its `doors` that part two of them.

    A room that is too small, or that the robot cannot enter, is part of the one behind its widest door.
    """
    while True:
        rooms = _parted(area, doors)
        needless = [i for i, (a, b) in enumerate(rooms.sides) if a == b or min(a, b) < 0]
        needless = needless or _door_of_a_nook(rooms, options)
        if not needless:
            return Rooms([_one_ring(floor, rooms.floors) for floor in rooms.floors], doors, rooms.sides)
        doors = [door for i, door in enumerate(doors) if i not in needless]


def _parted(area: Polygon, doors: list[Gap]) -> Rooms:
    lines = shapely.union_all([LineString(door.closing).buffer(CLOSED_M / 2.0, cap_style="flat") for door in doors])
    parts = shapely.get_parts(area.difference(lines)).tolist()
    floors = sorted((orient(part, 1.0) for part in parts), key=lambda part: -part.area)
    tree = shapely.STRtree(floors)
    return Rooms(floors, doors, [(_beside(door, tree, -1), _beside(door, tree, 1)) for door in doors])


def _beside(door: Gap, floors: shapely.STRtree, side: int) -> int:
    """Index of the floor a step before or behind a door, or -1."""
    point = Point(door.centre + side * (0.5 * door.depth_m + BEHIND_M) * door.through)
    return next(iter(floors.query(point, predicate="within").tolist()), -1)


def _door_of_a_nook(rooms: Rooms, options: PlanOptions) -> list[int]:
    """The widest door of the smallest room that is none, if there is one."""
    for index in range(len(rooms.floors) - 1, -1, -1):
        if _is_room(rooms.floors[index], options):
            continue
        doors = [i for i, sides in enumerate(rooms.sides) if index in sides] or _touching(rooms, index)
        if doors:
            return [max(doors, key=lambda i: rooms.doors[i].width_m)]
    return []


def _touching(rooms: Rooms, index: int) -> list[int]:
    """The doors on either side of a sliver of floor."""
    lines = shapely.linestrings(np.array([door.closing for door in rooms.doors]).reshape(-1, 2, 2))
    touching: list[int] = np.flatnonzero(shapely.distance(lines, rooms.floors[index]) < 2.0 * CLOSED_M).tolist()
    return touching


def _is_room(floor: Polygon, options: PlanOptions) -> bool:
    return floor.area >= options.smallest_room_m2 and not floor.buffer(-ROBOT_RADIUS_M - 0.1).is_empty


def _one_ring(floor: Polygon, floors: list[Polygon]) -> Polygon:
    """`floor` without holes; from one that holds another room a slit leads outside."""
    inside = [hole for hole in floor.interiors if any(Polygon(hole).contains(other) for other in floors)]
    ring = Polygon(floor.exterior, inside)
    for hole in inside:
        cut = LineString(shapely.get_coordinates(shapely.shortest_line(hole, ring.exterior)))
        longer = shapely.affinity.scale(cut, 1.0 + 0.1 / cut.length, 1.0 + 0.1 / cut.length)
        ring = max(shapely.get_parts(ring.difference(longer.buffer(SLIT_M / 2.0))), key=lambda part: part.area)
    return orient(Polygon(ring.exterior), 1.0)
