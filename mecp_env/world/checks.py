"""What a layout must be as geometry: simple rooms, doors in walls between their rooms, free starts, rooms in reach."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from mecp_env.errors import LayoutError
from mecp_env.world.outline import (
    GAP_POST_M,
    ROBOT_RADIUS_M,
    Outline,
    build_outline,
    door_ring,
    obstacle_shape,
    reachable,
    require_walls,
    solid_shape,
    wall_lines,
)
from mecp_env.world.schema import Door, Layout, Pillar

ON_LINE_M = 0.01
SQUARE_DEG = 1.0
OVERLAP_M2 = 0.01
GRID_M = 1e-6  # without one, GEOS finds rooms that touch along a slanted wall to be one inside the other
DOORSTEP_M = 0.15  # what lies so near to a room's border may be its doorway
MAX_PAIRS = 200_000  # every wall counts with itself, and every pair twice
CHUNK = 100
OPEN_SHARE = 0.9  # of a doorway that is a gap


def check_geometry(layout: Layout) -> Layout:
    """`layout` itself. Raises LayoutError with the field, the value and the bound of what is impossible."""
    _check_rooms(layout)
    _check_solids(layout)
    _check_obstacles(layout)
    _check_crowding(layout)
    _check_doors(layout)
    try:
        outline = build_outline(layout)
        _check_gaps(layout, outline)
        _check_starts(layout, outline)
        _check_reach(layout, outline)
    except shapely.errors.GEOSException as error:
        raise LayoutError(f"walls: their union cannot be computed ({error})") from None
    return layout


def _check_rooms(layout: Layout) -> None:
    names = [room.name for room in layout.rooms]
    shapes = [Polygon(room.polygon) for room in layout.rooms]
    for i, shape in enumerate(shapes):
        if names.index(names[i]) != i:
            raise LayoutError(f"rooms.{i}.name: {names[i]!r} is the name of rooms.{names.index(names[i])} too")
        _require_simple(shape, f"rooms.{i}.polygon")
    for i, j in shapely.STRtree(shapes).query(shapes).T.tolist():
        shared = shapely.intersection(shapes[i], shapes[j], grid_size=GRID_M).area
        if j < i and shared > OVERLAP_M2:
            raise LayoutError(f"rooms.{i}.polygon: shares {shared:.2f} m2 with rooms.{j}, at most {OVERLAP_M2} m2")


def _check_solids(layout: Layout) -> None:
    for i, solid in enumerate(layout.solids):
        _require_simple(solid_shape(solid), f"solids.{i}")


def _check_obstacles(layout: Layout) -> None:
    for i, obstacle in enumerate(layout.obstacles):
        if not isinstance(obstacle, Pillar):
            _require_simple(obstacle_shape(obstacle), f"obstacles.{i}.points")


def _check_crowding(layout: Layout) -> None:
    """The boxes around walls and obstacles overlap seldom enough for their union to be quick."""
    shapes = [*wall_lines(layout)[0], *map(obstacle_shape, layout.obstacles), *map(solid_shape, layout.solids)]
    tree, pairs = shapely.STRtree(shapes), 0
    for first in range(0, len(shapes), CHUNK):
        pairs += tree.query(shapes[first : first + CHUNK]).shape[1]
        if pairs > MAX_PAIRS:
            raise LayoutError(f"walls: too many of them lie across each other, at most {MAX_PAIRS} pairs")


def _require_simple(shape: Polygon, field: str) -> None:
    if not shape.is_valid:
        raise LayoutError(f"{field}: not a simple polygon ({shapely.is_valid_reason(shape)})")


def _check_doors(layout: Layout) -> None:
    require_walls(layout)
    lines, thickness = wall_lines(layout)
    tree = shapely.STRtree(lines)
    for i, door in enumerate(layout.doors):
        _check_door_rooms(layout, door, i)
        if door.depth_m is not None:
            _check_door_sides(layout, door, door.depth_m, i)
            continue
        nearest = int(tree.nearest(Point(door.centre)))
        _check_door_wall(door, lines[nearest], i)
        _check_door_sides(layout, door, thickness[nearest], i)


def _check_door_rooms(layout: Layout, door: Door, index: int) -> None:
    for side, name in enumerate(door.rooms):
        if layout.room_index(name) < 0:
            raise LayoutError(f"doors.{index}.rooms.{side}: no room is called {name!r}")


def _check_door_wall(door: Door, wall: LineString, index: int) -> None:
    """The door lies with its whole width in one straight wall, and is square to it."""
    off = wall.distance(Point(door.centre))
    if off > ON_LINE_M:
        raise LayoutError(
            f"doors.{index}.centre: {door.centre} is {off:.3f} m off the nearest wall, at most {ON_LINE_M} m"
        )
    (x0, y0), (x1, y1) = wall.coords
    square = math.degrees(math.atan2(y1 - y0, x1 - x0)) + 90.0 - door.direction_deg
    if abs((square + 90.0) % 180.0 - 90.0) > SQUARE_DEG:
        raise LayoutError(f"doors.{index}.direction_deg: {door.direction_deg:g} is not square to its wall")
    widest = 2.0 * min(math.dist(door.centre, end) for end in wall.coords)
    if door.width_m > widest:
        raise LayoutError(
            f"doors.{index}.width_m: {door.width_m:g} is wider than its wall allows, at most {widest:.3f} m"
        )


def _check_door_sides(layout: Layout, door: Door, thickness: float, index: int) -> None:
    """A step before the door lies in the first room, a step behind it in the second."""
    step = thickness / 2.0 + 0.05
    heading = math.radians(door.direction_deg)
    ahead = step * np.array([math.cos(heading), math.sin(heading)])
    for name, point in zip(door.rooms, (door.centre - ahead, door.centre + ahead), strict=True):
        room = layout.rooms[layout.room_index(name)]
        if not Polygon(room.polygon).contains(Point(point)):
            beside = f"{point.round(2).tolist()} beside it lies outside of {name!r}"
            raise LayoutError(f"doors.{index}.centre: {door.centre} is not between its rooms, {beside}")


def _check_gaps(layout: Layout, outline: Outline) -> None:
    """A gap is open, and there is a wall at either end of its width."""
    free = outline.free_area
    shapely.prepare(free)
    for i in np.flatnonzero(outline.doors.gap).tolist():
        ring = door_ring(outline.doors, i, 0.0)
        open_share = 1.0 if free.covers(Polygon(ring)) else Polygon(ring).intersection(free).area / Polygon(ring).area
        if open_share < OPEN_SHARE:
            raise LayoutError(f"doors.{i}: {open_share:.2f} of the gap is open, at least {OPEN_SHARE}")
        ends = shapely.points([ring[:2].mean(axis=0), ring[2:].mean(axis=0)])
        off = float(free.boundary.distance(ends).max())
        if off > GAP_POST_M:
            raise LayoutError(f"doors.{i}.width_m: an end is {off:.2f} m from a wall, at most {GAP_POST_M} m")


def _check_starts(layout: Layout, outline: Outline) -> None:
    for i, start in enumerate(layout.starts):
        point = Point(start.point)
        if not outline.free_area.contains(point):
            raise LayoutError(f"starts.{i}.point: {start.point} lies inside a wall or cut off from starts.0")
        clearance = outline.free_area.boundary.distance(point)
        if clearance < ROBOT_RADIUS_M:
            raise LayoutError(
                f"starts.{i}.point: {start.point} is {clearance:.3f} m from a wall, at least {ROBOT_RADIUS_M}"
            )


def _check_reach(layout: Layout, outline: Outline) -> None:
    """Every room, every door and every start can be reached by the robot's centre from the first start."""
    reach = reachable(outline)
    shapely.prepare(reach)
    for i, room in enumerate(outline.rooms):
        if not reach.intersects(room.buffer(-DOORSTEP_M)):
            raise LayoutError(
                f"rooms.{i}: {layout.rooms[i].name!r} cannot be reached by a radius of {ROBOT_RADIUS_M} m"
            )
    for i, centre in enumerate(outline.doors.centre):
        if not reach.intersects(Point(centre)):
            raise LayoutError(f"doors.{i}: too narrow or blocked for a radius of {ROBOT_RADIUS_M} m")
    for i, start in enumerate(layout.starts):
        if reach.distance(Point(start.point)) > ON_LINE_M:
            raise LayoutError(f"starts.{i}.point: {start.point} cannot be reached from starts.0")
