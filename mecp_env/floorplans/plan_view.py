"""From a layout to what its picture is drawn from."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.affinity import affine_transform, rotate
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient
from shapely.ops import nearest_points

from mecp_env.render.palette import LETTER, LINES, FloorPlan, PlanRoom, Shape
from mecp_env.world.outline import Outline, build_outline, door_ring, obstacle_shape, solid_shape, wall_solids
from mecp_env.world.schema import Layout

CLEAR_M = 0.06  # between a name and walls or furniture
START_M = 0.45  # names keep so far from a start
TURNED = 1.3  # a name without enough space is turned where it can be so many times as large
ENOUGH_M = 1.3  # height of name and area for which there is enough space
HALVINGS = 6  # of the interval in which the size of a name is searched
COLOURS = (0, 1, 2, 3, 4, 5, 7, 8)  # of the palette; brown is the furniture's

Label = tuple[tuple[float, float], float, float]


def floor_plan(layout: Layout, title: str = "") -> FloorPlan:
    """The picture's data of a checked layout, under its own name or another title."""
    outline = build_outline(layout)
    blocks = [obstacle_shape(obstacle) for obstacle in layout.obstacles]
    walls = [*wall_solids(layout), *map(solid_shape, layout.solids)]
    return FloorPlan(
        name=title or layout.name,
        walls=tuple(_shape(part) for part in shapely.get_parts(shapely.union_all(walls))),
        rooms=_rooms(outline),
        doors=tuple(door_ring(outline.doors, i, 0.0) for i in range(len(outline.doors))),
        obstacles=tuple(np.array(block.exterior.coords)[:-1] for block in blocks),
        starts=outline.starts,
        free_m2=float(outline.free_area.area),
    )


def _shape(part: Polygon) -> Shape:
    """Its rings, the holes in the opposite order to the outside, so that they are not filled."""
    part = orient(part)
    return tuple(np.array(ring.coords)[:-1] for ring in (part.exterior, *part.interiors))


def _rooms(outline: Outline) -> tuple[PlanRoom, ...]:
    starts = [Point(start[:2]).buffer(START_M) for start in outline.starts]
    clear = outline.free_area.buffer(-CLEAR_M).difference(shapely.union_all(starts))
    colours = _colours(outline.rooms)
    floors = [float(room.intersection(outline.free_area).area) for room in outline.rooms]
    return tuple(
        _room(name, room, clear, colour, area_m2)
        for name, room, colour, area_m2 in zip(outline.room_names, outline.rooms, colours, floors, strict=True)
    )


def _room(name: str, room: Polygon, clear: BaseGeometry, colour: int, area_m2: float) -> PlanRoom:
    free = room.intersection(clear)
    free = free if free.area > 0.0 else room
    aspect = max(LETTER * len(name) / LINES, 1.0)
    level, *others = (_space(free, aspect, turn) for turn in (0.0, *_directions(room)))
    best = max(others, key=lambda label: label[1])
    turned = level[1] < 0.9 * ENOUGH_M and best[1] > TURNED * level[1]
    place, height, turn = best if turned else level
    ring = np.array(room.exterior.coords)[:-1]
    return PlanRoom(name, ring, area_m2, colour, place, height, turn)


def _directions(room: Polygon) -> tuple[float, float]:
    """The directions of a room's sides, degrees: above -80, at most 100, so that a text along them can be read."""
    a, b = np.array(room.minimum_rotated_rectangle.exterior.coords)[:2]
    along = float(np.degrees(np.arctan2(*(b - a)[::-1])))
    return 100.0 - (100.0 - along) % 180.0, 100.0 - (10.0 - along) % 180.0


def _space(free: BaseGeometry, aspect: float, turn_deg: float) -> Label:
    """Where a box `aspect` times as long as high has space, as near to the middle as it goes: place, height, turn.

    A circle in a plan that is squeezed along the text is an ellipse around the text.
    """
    there = [1.0 / aspect, 0.0, 0.0, 1.0, 0.0, 0.0]
    squeezed = affine_transform(rotate(free, -turn_deg, origin=(0.0, 0.0)), there)
    largest = shapely.maximum_inscribed_circle(squeezed, tolerance=0.05)
    enough = min(0.98 * largest.length, ENOUGH_M / math.sqrt(2.0))
    places = squeezed.buffer(-enough, quad_segs=4)
    middle, _ = nearest_points(places, squeezed.centroid) if not places.is_empty else (Point(largest.coords[0]), None)
    place = rotate(Point(middle.x * aspect, middle.y), turn_deg, origin=(0.0, 0.0))
    return (place.x, place.y), _side(squeezed, middle), turn_deg


def _side(free: BaseGeometry, middle: Point) -> float:
    """The side of the largest upright square around a point, m: between that in its circle and that around it."""
    radius = float(free.boundary.distance(middle))
    least, most = math.sqrt(2.0) * radius, 2.0 * radius
    for _ in range(HALVINGS):
        half = 0.25 * (least + most)
        square = shapely.box(middle.x - half, middle.y - half, middle.x + half, middle.y + half)
        least, most = (2.0 * half, most) if free.contains(square) else (least, 2.0 * half)
    return least


def _colours(rooms: tuple[Polygon, ...]) -> list[int]:
    """For each room the colour that is used least, of those that no neighbour before it has."""
    tree, colours = shapely.STRtree(rooms), list[int]()
    for i, room in enumerate(rooms):
        taken = {colours[j] for j in tree.query(room.buffer(0.1), predicate="intersects").tolist() if j < i}
        left = [colour for colour in COLOURS if colour not in taken] or list(COLOURS)
        colours.append(min(left, key=colours.count))
    return colours
