"""What a layout must be as geometry: simple rooms, doors in walls between their rooms, free starts, rooms in reach."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon

from mecp_env.core.errors import LayoutError
from mecp_env.core.settings import guess
from mecp_env.world.outline import (
    GAP_POST_M,
    ROBOT_RADIUS_M,
    Array,
    Doors,
    Ints,
    Outline,
    build_outline,
    door_ring,
    obstacle_shape,
    reachable,
    require_walls,
    solid_shape,
    wall_lines,
)
from mecp_env.world.schema import DoorSpec, Layout, Pillar

ON_LINE_M = 0.01
SQUARE_DEG = 1.0
OVERLAP_M2 = 0.01
GRID_M = 1e-6  # without a grid, GEOS reports rooms that touch along a slanted wall as one inside the other
DOORSTEP_M = 0.15  # points this close to a room's border may be in its doorway
MAX_CROSSINGS = 10_000  # pairs of walls, obstacles and solids that touch
MAX_TOUCHING = 10_000  # pairs of rooms that touch
MAX_BOXES = 200_000  # pairs with touching bounding boxes; each counts twice, and with itself
MAX_SLANTED = 1_000_000  # the same for faces
MAX_NEAR = 200_000  # pairs of close faces; each counts twice, and with itself
NEAR_M = 0.44
CHUNK = 100
OPEN_SHARE = 0.9  # of a doorway that is a gap
SHARED_SHARE = 0.1  # of the smaller of two doorways if one is a gap; two cuts may not touch


def check_geometry(layout: Layout) -> Layout:
    """`layout` itself. Raises LayoutError with the field, the value and the bound of what is impossible."""
    checked_outline(layout)
    return layout


def checked_outline(layout: Layout) -> Outline:
    """The outline of `layout`, whose geometry is checked as in `check_geometry`."""
    _check_rooms(layout)
    _check_solids(layout)
    _check_obstacles(layout)
    _check_crowding(layout)
    _check_doors(layout)
    try:
        outline = build_outline(layout)
        _check_doors_apart(outline.doors)
        _check_gaps(layout, outline)
        _check_starts(layout, outline)
        _check_density(outline)
        _check_reach(layout, outline)
    except shapely.errors.GEOSException as error:
        raise LayoutError(f"walls: their union cannot be computed ({error})") from None
    return outline


def _check_rooms(layout: Layout) -> None:
    first: dict[str, int] = {}
    for i, room in enumerate(layout.rooms):
        if first.setdefault(room.name, i) != i:
            raise LayoutError(f"rooms.{i}.name: {room.name!r} is the name of rooms.{first[room.name]} too")
    shapes = np.array([Polygon(room.polygon) for room in layout.rooms], dtype=np.object_)
    for i, shape in enumerate(shapes):
        _require_simple(shape, f"rooms.{i}.polygon")
    one, other = _touching(shapes, MAX_TOUCHING, "rooms")
    shared = shapely.area(shapely.intersection(shapes[one], shapes[other], grid_size=GRID_M))
    for pair in np.flatnonzero(shared > OVERLAP_M2)[:1].tolist():
        what = f"shares {shared[pair]:.2f} m2 with rooms.{other[pair]}, at most {OVERLAP_M2} m2"
        raise LayoutError(f"rooms.{one[pair]}.polygon: {what}")


def _touching(shapes: NDArray[np.object_], most: int, field: str) -> tuple[Ints, Ints]:
    """The pairs i > j of shapes that touch or overlap. Raises LayoutError for too many of them."""
    tree, pairs = shapely.STRtree(shapes), [np.empty((2, 0), np.int64)]
    boxes, touching = 0, 0
    for first in range(0, len(shapes), CHUNK):
        some = shapes[first : first + CHUNK]
        boxes += tree.query(some).shape[1]
        if boxes <= MAX_BOXES:
            found = tree.query(some, predicate="intersects") + np.array([[first], [0]])
            pairs.append(found[:, found[0] > found[1]])
            touching += pairs[-1].shape[1]
        if boxes > MAX_BOXES or touching > most:
            bounds = f"at most {most} pairs, of the boxes around them at most {MAX_BOXES}"
            raise LayoutError(f"{field}: too many of them overlap, {bounds}")
    i, j = np.concatenate(pairs, axis=1)
    return i, j


def _check_solids(layout: Layout) -> None:
    for i, solid in enumerate(layout.solids):
        _require_simple(solid_shape(solid), f"solids.{i}")


def _check_obstacles(layout: Layout) -> None:
    for i, obstacle in enumerate(layout.obstacles):
        if not isinstance(obstacle, Pillar):
            _require_simple(obstacle_shape(obstacle), f"obstacles.{i}.points")


def _check_crowding(layout: Layout) -> None:
    """Walls, obstacles and solids overlap rarely enough for a fast union."""
    shapes = [*wall_lines(layout)[0], *map(obstacle_shape, layout.obstacles), *map(solid_shape, layout.solids)]
    _touching(np.array(shapes, dtype=np.object_), MAX_CROSSINGS, "walls")


def _require_simple(shape: Polygon, field: str) -> None:
    if not shape.is_valid:
        raise LayoutError(f"{field}: not a simple polygon ({shapely.is_valid_reason(shape)})")


def _check_doors(layout: Layout) -> None:
    require_walls(layout)
    lines, thickness = wall_lines(layout)
    tree = shapely.STRtree(lines)
    floors = {room.name: Polygon(room.polygon) for room in layout.rooms}
    for i, door in enumerate(layout.doors):
        _check_door_rooms(floors, door, i)
        if door.depth_m is not None:
            _check_door_sides(floors, door, door.depth_m, i)
            continue
        nearest = int(tree.nearest(Point(door.centre)))
        _check_door_wall(door, lines[nearest], i)
        _check_door_sides(floors, door, thickness[nearest], i)


def _check_door_rooms(floors: Mapping[str, Polygon], door: DoorSpec, index: int) -> None:
    for side, name in enumerate(door.rooms):
        if name not in floors:
            raise LayoutError(f"doors.{index}.rooms.{side}: no room is called {name!r}{guess(name, floors)}")


def _check_door_wall(door: DoorSpec, wall: LineString, index: int) -> None:
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


def _check_door_sides(floors: Mapping[str, Polygon], door: DoorSpec, thickness: float, index: int) -> None:
    """A point in front of the door is in the first room, a point behind it in the second."""
    step = thickness / 2.0 + 0.05
    heading = math.radians(door.direction_deg)
    ahead = step * np.array([math.cos(heading), math.sin(heading)])
    for name, point in zip(door.rooms, (door.centre - ahead, door.centre + ahead), strict=True):
        if not floors[name].contains(Point(point)):
            beside = f"{point.round(2).tolist()} beside it lies outside of {name!r}"
            raise LayoutError(f"doors.{index}.centre: {door.centre} is not between its rooms, {beside}")


def _check_doors_apart(doors: Doors) -> None:
    """No two doorways overlap: there are jambs between two doors."""
    rings = shapely.polygons(np.array([door_ring(doors, i, 0.0) for i in range(len(doors))]).reshape(-1, 4, 2))
    one, other = _touching(rings, MAX_TOUCHING, "doors")
    shared = shapely.area(shapely.intersection(rings[one], rings[other]))
    most = SHARED_SHARE * np.minimum(shapely.area(rings[one]), shapely.area(rings[other]))
    cuts = ~(doors.gap[one] | doors.gap[other])
    for pair in np.flatnonzero(cuts | (shared > most))[:1].tolist():
        given = f"{doors.centre[one[pair]].round(3).tolist()}, {doors.width[one[pair]]:g} m wide"
        raise LayoutError(f"doors.{one[pair]}.centre: {given}, touches the doorway of doors.{other[pair]}")


def _check_gaps(layout: Layout, outline: Outline) -> None:
    """A gap is open, and there is a wall at either end of its width."""
    gaps = np.flatnonzero(outline.doors.gap).tolist()
    rings = np.array([door_ring(outline.doors, i, 0.0) for i in gaps]).reshape(-1, 4, 2)
    ends = np.stack([rings[:, :2].mean(axis=1), rings[:, 2:].mean(axis=1)], axis=1)
    off = _from_faces(outline, ends.reshape(-1, 2)).reshape(-1, 2).max(axis=1)
    free = outline.free_area
    shapely.prepare(free)
    for i, ring, far in zip(gaps, rings, off.tolist(), strict=True):
        open_share = 1.0 if free.covers(Polygon(ring)) else _open_share(Polygon(ring), free)
        if open_share < OPEN_SHARE:
            raise LayoutError(f"doors.{i}: {open_share:.2f} of the gap is open, at least {OPEN_SHARE}")
        if far > GAP_POST_M:
            raise LayoutError(f"doors.{i}.width_m: an end is {far:.2f} m from a wall, at most {GAP_POST_M} m")


def _open_share(gap: Polygon, free: Polygon) -> float:
    around = gap.buffer(0.01).bounds
    return float(shapely.clip_by_rect(free, *around).buffer(0.0).intersection(gap).area / gap.area)


def _from_faces(outline: Outline, points: Array) -> Array:
    """Distance (n,) m of points (n,2) from the nearest face."""
    tree = shapely.STRtree(shapely.linestrings(outline.segments))
    _, far = tree.query_nearest(shapely.points(points), all_matches=False, return_distance=True)
    distances: Array = far
    return distances


def _check_starts(layout: Layout, outline: Outline) -> None:
    points = outline.starts[:, :2]
    inside = shapely.contains_xy(outline.free_area, points)
    for i, clearance in enumerate(_from_faces(outline, points).tolist()):
        given = f"starts.{i}.point: {layout.starts[i].point}"
        if not inside[i]:
            raise LayoutError(f"{given} lies inside a wall or cut off from starts.0")
        if clearance < ROBOT_RADIUS_M:
            raise LayoutError(f"{given} is {clearance:.3f} m from a wall, at least {ROBOT_RADIUS_M}")


def _check_density(outline: Outline) -> None:
    """Straight faces are close to each other rarely enough for a fast computation of the robot's reach."""
    lines = shapely.linestrings(outline.segments[~outline.round])
    tree, boxes, near = shapely.STRtree(lines), 0, 0
    for first in range(0, len(lines), CHUNK):
        some = lines[first : first + CHUNK]
        boxes += tree.query(some).shape[1]
        near += tree.query(some, predicate="dwithin", distance=NEAR_M).shape[1] if boxes <= MAX_SLANTED else 0
        if near > MAX_NEAR or boxes > MAX_SLANTED:
            raise LayoutError(f"walls: too many faces within {NEAR_M} m of each other, at most {MAX_NEAR} pairs")


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
        if not shapely.dwithin(reach, Point(start.point), ON_LINE_M):
            raise LayoutError(f"starts.{i}.point: {start.point} cannot be reached from starts.0")
