"""Layouts by name, path, dict or object: read, checked, and refused with the field, the value and the bound.

What a layout must be as geometry: simple rooms, doors in walls between their rooms, free starts, rooms in reach.
"""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.core.files import exists, read_bytes, text_of
from mecp_env.core.settings import MOST_TOLD, guess
from mecp_env.world.outline import (
    GAP_POST_M,
    ROBOT_RADIUS_M,
    Doors,
    Outline,
    build_outline,
    door_ring,
    obstacle_shape,
    reachable,
    solid_shape,
    wall_lines,
)
from mecp_env.world.schema import DoorSpec, Layout

__all__ = ["MAX_BYTES", "Layout", "load_layout", "shipped_layouts"]

Walls = tuple[shapely.STRtree, list[LineString], Array]  # with the thickness of each

LIBRARY = Path(__file__).parent / "library"
MAX_BYTES = 2_000_000
ON_LINE_M = 0.01
SQUARE_DEG = 1.0
OVERLAP_M2 = 0.01
GRID_M = 1e-6  # without a grid, GEOS reports rooms that touch along a slanted wall as one inside the other
DOORSTEP_M = 0.15  # points this close to a room's border may be in its doorway
MAX_CROSSINGS = 10_000  # pairs of walls, obstacles and solids that touch
MAX_TOUCHING = 10_000  # pairs of rooms that touch
MAX_NEAR, NEAR_M = 100_000, 0.44  # pairs of faces so close to each other; many make the robot's reach slow to compute
MAX_BOXES = 1_000_000  # pairs with touching bounding boxes; each counts twice, and with itself
CHUNK = 100
OPEN_SHARE = 0.9  # of a doorway that is a gap
SHARED_SHARE = 0.1  # of the smaller of two doorways if one is a gap; two cuts may not touch


def shipped_layouts() -> tuple[str, ...]:
    """The names of the layouts that come with the package."""
    return tuple(sorted(path.stem for path in LIBRARY.glob("*.json")))


def load_layout(given: str | os.PathLike[str] | dict[str, Any] | Layout) -> Layout:
    """The layout of a shipped name, a path to a JSON file, a dict of its fields, or a `Layout`.

    Raises LayoutError naming the source, the field, the value and the bound: for a file that is missing, larger than
    2 MB or no JSON; for unknown, missing or wrong fields; for impossible geometry.
    """
    if isinstance(given, str) and given in shipped_layouts():
        return _shipped(given)
    return _checked(Path(given) if isinstance(given, os.PathLike) else given)


@cache
def _shipped(name: str) -> Layout:
    return _checked(name)


def _checked(given: str | Path | dict[str, Any] | Layout) -> Layout:
    try:
        layout = with_directions(_parse(given))
        check_geometry(layout)
        return layout
    except LayoutError as error:
        source = f"{given}: " if isinstance(given, str | Path) else ""
        raise LayoutError(f"{source}{error}") from None


def _parse(given: str | Path | dict[str, Any] | Layout) -> Layout:
    if isinstance(given, Layout):
        return given
    if isinstance(given, str | Path):
        given = decode_json(_read(given))
    if not isinstance(given, dict):
        raise LayoutError(f"expected a name, a path, a dict or a Layout, given {type(given).__name__}")
    if not all(isinstance(key, str) for key in given):
        raise LayoutError("keys of a layout are strings")
    return Layout(**given)


def _read(given: str | Path) -> bytes:
    """The bytes of the file that a shipped name or a path stands for."""
    names = shipped_layouts()
    path = LIBRARY / f"{given}.json" if str(given) in names else Path(given)
    if not exists(path) or path.is_dir():
        raise LayoutError(f"no such file; shipped layouts are {', '.join(names)}{guess(given, names)}")
    if path.suffix != ".json":
        raise LayoutError(f"a layout file ends in .json, given {path.suffix!r:.80}")
    return read_bytes(path, MAX_BYTES)


def decode_json(data: bytes) -> dict[str, Any]:
    """The object of a JSON text. Raises LayoutError for other JSON and for keys given twice."""
    try:
        document = json.loads(text_of(data), object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:  # neither text nor JSON, or nested too deeply
        raise LayoutError(f"no JSON: {error}") from None
    if not isinstance(document, dict):
        raise LayoutError(f"expected an object, given {type(document).__name__}")
    return document


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        raise ValueError(f"{Counter(key for key, _ in pairs).most_common(1)[0][0]:.80}: given twice")
    return document


def check_geometry(layout: Layout) -> Outline:
    """The outline of `layout`. Raises LayoutError with the fields, the values and the bounds of what is impossible.

    All that is wrong with shapes is told at once; if nothing is, all that is wrong with rooms and doors; and so on.
    """
    rooms = [Polygon(room.polygon) for room in layout.rooms]
    solids, obstacles = [solid_shape(solid) for solid in layout.solids], list(map(obstacle_shape, layout.obstacles))
    _refuse(_not_simple({"rooms.{}.polygon": rooms, "solids.{}": solids, "obstacles.{}.points": obstacles}))
    _close_pairs(np.array([*wall_lines(layout)[0], *obstacles, *solids]), MAX_CROSSINGS, "walls")
    _refuse(chain(_wrong_rooms(layout, np.array(rooms)), _wrong_doors(layout)))
    try:
        outline = build_outline(layout)
        _refuse(chain(_doors_that_touch(outline.doors), _wrong_gaps(outline), _wrong_starts(outline)))
        _close_pairs(shapely.linestrings(outline.segments[~outline.round]), MAX_NEAR, "walls: faces", NEAR_M)
        _refuse(_out_of_reach(outline))
    except shapely.errors.GEOSException as error:
        raise LayoutError(f"walls: their union cannot be computed ({error})") from None
    return outline


def _refuse(faults: Iterable[str]) -> None:
    """Raise LayoutError for the first few `faults`, with the number of the others."""
    told = list(faults)
    if told:
        more = [f"and {len(told) - MOST_TOLD} more"] if len(told) > MOST_TOLD else []
        raise LayoutError("; ".join(told[:MOST_TOLD] + more))


def _not_simple(shapes: Mapping[str, list[Polygon]]) -> Iterator[str]:
    for field, some in shapes.items():
        for i in np.flatnonzero(~shapely.is_valid(some)).tolist():
            yield f"{field.format(i)}: not a simple polygon ({shapely.is_valid_reason(some[i])})"


def _wrong_rooms(layout: Layout, shapes: NDArray[np.object_]) -> Iterator[str]:
    """Rooms have different names, and do not overlap."""
    first: dict[str, int] = {}
    for i, room in enumerate(layout.rooms):
        if first.setdefault(room.name, i) != i:
            yield f"rooms.{i}.name: {room.name!r} is the name of rooms.{first[room.name]} too"
    one, other = _close_pairs(shapes, MAX_TOUCHING, "rooms")
    with np.errstate(all="ignore"):  # of coordinates such as 1e-230 the area is right, but flags are set
        shared = shapely.area(shapely.intersection(shapes[one], shapes[other], grid_size=GRID_M))
    for pair in np.flatnonzero(shared > OVERLAP_M2).tolist():
        what = f"shares {shared[pair]:.2f} m2 with rooms.{other[pair]}, at most {OVERLAP_M2} m2"
        yield f"rooms.{one[pair]}.polygon: {what}"


def _close_pairs(shapes: NDArray[np.object_], most: int, field: str, near_m: float = 0.0) -> tuple[Ints, Ints]:
    """The pairs i > j of shapes that touch, or within `near_m` of each other. Raises LayoutError for too many."""
    tree, pairs = shapely.STRtree(shapes), [np.empty((2, 0), np.int64)]
    boxes = close = 0
    for first in range(0, len(shapes), CHUNK):
        some = shapes[first : first + CHUNK]
        boxes += tree.query(some).shape[1]
        if boxes <= MAX_BOXES:
            found = tree.query(some, predicate="dwithin" if near_m else "intersects", distance=near_m) + np.array(
                [[first], [0]]
            )
            pairs.append(found[:, found[0] > found[1]])
            close += pairs[-1].shape[1]
        if boxes > MAX_BOXES or close > most:
            bounds = f"at most {most} pairs, of the boxes around them at most {MAX_BOXES}"
            raise LayoutError(f"{field}: too many within {near_m:g} m of each other, {bounds}")
    i, j = np.concatenate(pairs, axis=1)
    return i, j


def with_directions(layout: Layout) -> Layout:
    """The same layout; a cut without `direction_deg` gets the one that is square to its wall and leads to its rooms."""
    if all(door.direction_deg is not None for door in layout.doors):
        return layout
    lines, thickness = wall_lines(layout)
    tree, floors = shapely.STRtree(lines), _floors(layout)

    def directed(door: DoorSpec) -> DoorSpec:
        if door.direction_deg is not None:
            return door
        nearest = int(tree.nearest(Point(door.centre)))
        (x0, y0), (x1, y1) = lines[nearest].coords
        square = math.degrees(math.atan2(x0 - x1, y1 - y0))
        both = (round(square + turn, 9) for turn in (0.0, 180.0, -180.0))
        ways = [door.model_copy(update={"direction_deg": deg + 0.0}) for deg in both if -180.0 < deg <= 180.0]
        return min(ways, key=lambda way: len(list(_not_between(floors, way, thickness[nearest], ""))))

    return layout.model_copy(update={"doors": tuple(map(directed, layout.doors))})


def _floors(layout: Layout) -> dict[str, Polygon]:
    return {room.name: Polygon(room.polygon) for room in layout.rooms}


def _wrong_doors(layout: Layout) -> Iterator[str]:
    """Doors join two rooms; one that is cut is in a wall. The first fault of each."""
    lines, thickness = wall_lines(layout)
    tree, floors = shapely.STRtree(lines), _floors(layout)
    for i, door in enumerate(layout.doors):
        yield from islice(_wrong_door(door, f"doors.{i}", floors, (tree, lines, thickness)), 1)


def _wrong_door(door: DoorSpec, field: str, floors: Mapping[str, Polygon], walls: Walls) -> Iterator[str]:
    for side, name in enumerate(door.rooms):
        if name not in floors:
            yield f"{field}.rooms.{side}: no room is called {name!r}{guess(name, floors)}"
            return
    tree, lines, thickness = walls
    depth = door.depth_m
    if depth is None:
        nearest = int(tree.nearest(Point(door.centre)))
        depth = thickness[nearest]
        yield from _off_its_wall(door, lines[nearest], field)
    yield from _not_between(floors, door, depth, field)


def _off_its_wall(door: DoorSpec, wall: LineString, field: str) -> Iterator[str]:
    """The door lies with its whole width in one straight wall, and is square to it."""
    off = wall.distance(Point(door.centre))
    if off > ON_LINE_M:
        yield f"{field}.centre: {door.centre} is {off:.3f} m off the nearest wall, at most {ON_LINE_M} m"
    (x0, y0), (x1, y1) = wall.coords
    square = math.degrees(math.atan2(y1 - y0, x1 - x0) - door.heading) + 90.0
    if abs((square + 90.0) % 180.0 - 90.0) > SQUARE_DEG:
        yield f"{field}.direction_deg: {door.direction_deg:g} is not square to its wall"
    widest = 2.0 * min(math.dist(door.centre, end) for end in wall.coords)
    if door.width_m > widest:
        yield f"{field}.width_m: {door.width_m:g} is wider than its wall allows, at most {widest:.3f} m"


def _not_between(floors: Mapping[str, Polygon], door: DoorSpec, thickness: float, field: str) -> Iterator[str]:
    """A point in front of the door is in the first room, a point behind it in the second."""
    step = thickness / 2.0 + 0.05
    ahead = step * np.array([math.cos(door.heading), math.sin(door.heading)])
    for name, point in zip(door.rooms, (door.centre - ahead, door.centre + ahead), strict=True):
        if name not in floors or not floors[name].contains(Point(point)):
            beside = f"{point.round(2).tolist()} beside it lies outside of {name!r}"
            yield f"{field}.centre: {door.centre} is not between its rooms, {beside}"


def _doors_that_touch(doors: Doors) -> Iterator[str]:
    """No two doorways overlap: there are jambs between two doors."""
    rings = shapely.polygons(np.array([door_ring(doors, i, 0.0) for i in range(len(doors))]).reshape(-1, 4, 2))
    one, other = _close_pairs(rings, MAX_TOUCHING, "doors")
    shared = shapely.area(shapely.intersection(rings[one], rings[other]))
    most = SHARED_SHARE * np.minimum(shapely.area(rings[one]), shapely.area(rings[other]))
    cuts = ~(doors.gap[one] | doors.gap[other])
    for pair in np.flatnonzero(cuts | (shared > most)).tolist():
        given = f"{doors.centre[one[pair]].round(3).tolist()}, {doors.width[one[pair]]:g} m wide"
        yield f"doors.{one[pair]}.centre: {given}, touches the doorway of doors.{other[pair]}"


def _wrong_gaps(outline: Outline) -> Iterator[str]:
    """A gap is open, and there is a wall at either end of its width."""
    gaps = np.flatnonzero(outline.doors.gap).tolist()
    rings = np.array([door_ring(outline.doors, i, 0.0) for i in gaps]).reshape(-1, 4, 2)
    ends = np.stack([rings[:, :2].mean(axis=1), rings[:, 2:].mean(axis=1)], axis=1)
    off = _from_faces(outline, ends.reshape(-1, 2)).reshape(-1, 2).max(axis=1)
    free = outline.free_area
    shapely.prepare(free)
    for i, gap, far in zip(gaps, shapely.polygons(rings), off.tolist(), strict=True):
        open_share = 1.0 if free.covers(gap) else free.intersection(gap).area / gap.area
        if open_share < OPEN_SHARE:
            yield f"doors.{i}: {open_share:.2f} of the gap is open, at least {OPEN_SHARE}"
        if far > GAP_POST_M:
            yield f"doors.{i}.width_m: an end is {far:.2f} m from a wall, at most {GAP_POST_M} m"


def _from_faces(outline: Outline, points: Array) -> Array:
    """Distance (n,) m of points (n,2) from the nearest face."""
    tree = shapely.STRtree(shapely.linestrings(outline.segments))
    _, far = tree.query_nearest(shapely.points(points), all_matches=False, return_distance=True)
    distances: Array = far
    return distances


def _wrong_starts(outline: Outline) -> Iterator[str]:
    points = outline.starts[:, :2]
    inside = shapely.contains_xy(outline.free_area, points)
    for i, clearance in enumerate(_from_faces(outline, points).tolist()):
        given = f"starts.{i}.point: {points[i].tolist()}"
        if not inside[i]:
            yield f"{given} lies inside a wall or cut off from starts.0"
        elif clearance < ROBOT_RADIUS_M:
            yield f"{given} is {clearance:.3f} m from a wall, at least {ROBOT_RADIUS_M}"


def _out_of_reach(outline: Outline) -> Iterator[str]:
    """Every room, every door and every start can be reached by the robot's centre from the first start."""
    reach = reachable(outline)
    shapely.prepare(reach)
    lost = ~shapely.intersects(reach, shapely.buffer(outline.rooms, -DOORSTEP_M))
    for i in np.flatnonzero(lost):
        yield f"rooms.{i}: {outline.room_names[i]!r} cannot be reached by a radius of {ROBOT_RADIUS_M} m"
    for i in np.flatnonzero(~shapely.intersects(reach, shapely.points(outline.doors.centre))):
        yield f"doors.{i}: too narrow or blocked for a radius of {ROBOT_RADIUS_M} m"
    for i in np.flatnonzero(~shapely.dwithin(reach, shapely.points(outline.starts[:, :2]), ON_LINE_M)):
        yield f"starts.{i}.point: {outline.starts[i, :2].tolist()} cannot be reached from starts.0"
