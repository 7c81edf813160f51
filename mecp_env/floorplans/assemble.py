"""From the floor that an importer read to a layout: cleaned, straightened, parted into rooms, walled in."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.polygon import orient

from mecp_env.core.errors import LayoutError, PlanWarning
from mecp_env.floorplans.door_detection import (
    FINE_STEP_M,
    Gap,
    Walls,
    find_doors,
    is_between_walls,
    measure,
    with_frames,
    with_wider_doors,
)
from mecp_env.floorplans.floor import (
    are_walls,
    fitted,
    largest_part,
    left_out,
    reachable_floor,
    without_furniture,
    without_hollows,
)
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.straighten import FINE, along_directions, directions, straightened, thinned
from mecp_env.world.layout import check_geometry
from mecp_env.world.outline import ROBOT_RADIUS_M
from mecp_env.world.schema import Layout

CLOSED_M = 2e-3  # thickness of a closed door: the polygons of the rooms are so far apart
SLIT_M = 0.01  # width of the cut that makes one ring of a room with others inside of it
BEHIND_M = 0.08  # how far behind a doorway its room is looked up
MAX_VERTICES = 50_000  # of a floor as it was read, those in the middle of an edge aside; with more it is thinned
ON_EDGE_M = 1e-6  # a vertex so near to the line through its neighbours is in the middle of an edge
MANY_VERTICES = 20_000  # from so many on the floor is thinned before all else
MAX_THINNED = 8_000  # of a floor drawn as coarsely as its pixels are; one with more is drawn more coarsely
COARSER_M = (0.09, 0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)  # how coarsely a large floor may be drawn
RAGGED_NOISES_M = (0.09, 0.12, 0.15)  # how coarsely a ragged floor may be drawn
MANY_FACES, SHORT_EDGE_M = 300, 1.0  # a ragged floor has so many faces, shorter than that in the mean
CLEAN_SHARE = 0.7  # of the length of all edges of a plan that is not ragged goes along its directions
MAX_FACES = 2_500  # of a floor drawn as coarsely as that
MANY_CORNERS = 900  # of a room
WALL_M = 0.15  # thickness of the walls around the building
MOST_STARTS = 4
HALL_M2 = 2_000.0  # of floor per room: with more the scale is in doubt
START_CLEAR_M = 0.4  # between a start and every wall, where there is room
DOOR_DEPTH_M = 0.01  # of a doorway in a layout, at least
NEAR_M = 0.1  # a point this close to a floor is on it
MATCH = 0.3  # share of overlap from which a room has the name of a box


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
    return np.flatnonzero(shapely.distance(lines, rooms.floors[index]) < 2.0 * CLOSED_M).tolist()


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


def layout_of(plan: FreeSpace, options: PlanOptions) -> Layout:
    """The layout of a plan. Raises LayoutError for one that has no floor for a robot, or far too many corners."""
    given = int(shapely.get_num_coordinates(plan.area))
    floor = plan.area if given <= MAX_VERTICES else _without_steps(plan.area)
    thin, coarse_m = _fitting(floor, plan.noise_m, MAX_THINNED)
    fits = given <= MANY_VERTICES and coarse_m == plan.noise_m
    coarser = f"Large: walls are simplified to within {coarse_m:g} m." if coarse_m > plan.noise_m else ""
    plan = _told(replace(plan, noise_m=coarse_m), coarser)
    read, area = _floors(floor if fits else thin, plan, options)
    rooms = split(area, _doors(area, directions(area), plan, options), options)
    _require_rooms(plan.drawn, rooms.floors)
    plan = _told(plan, left_out(floor, area, options))
    plan = _told(plan, _doubtful_scale(area, len(rooms.floors)))
    try:
        return _layout(plan, area, rooms, [Polygon(hole) for hole in read.interiors])
    except LayoutError:  # a piece of furniture blocks a door by less than a pixel
        return _layout(plan, area, rooms, [])


def _fitting(floor: Polygon, noise_m: float, most: int) -> tuple[Polygon, float]:
    """`floor` drawn no more coarsely than it takes to have at most so many vertices, and how coarsely, m."""
    for noise in (noise_m, *(coarse for coarse in COARSER_M if coarse > noise_m)):
        thin = thinned(floor, noise)
        if shapely.get_num_coordinates(thin) <= most:
            return thin, noise
    raise LayoutError(
        f"the floor has {shapely.get_num_coordinates(thin)} vertices even where it is drawn to within {noise:g} m, "
        f"at most {most}: save the map with larger pixels, or clean it of scattered cells"
    )


def _doubtful_scale(area: Polygon, rooms: int) -> str:
    """What of the size of the rooms speaks against metres, in words; or nothing."""
    if area.area < HALL_M2 * rooms:
        return ""
    return f"Large: {area.area:.0f} m2 of floor and {rooms} room{'s' * (rooms > 1)}; check that its scale is in metres."


def _told(plan: FreeSpace, said: str) -> FreeSpace:
    """`plan` with a sentence in its description; warns of it. Nothing for an empty one."""
    if not said:
        return plan
    warnings.warn(f"{plan.name:.80}: {said}", PlanWarning, stacklevel=3)
    return replace(plan, description=f"{plan.description} {said}".strip())


def _floors(floor: Polygon, plan: FreeSpace, options: PlanOptions) -> tuple[Polygon, Polygon]:
    """The part of `floor` that a robot can reach, as it was read and with straight walls.

    In a clean plan whose doors have to be found, narrow doorways are widened and door frames kept.
    """
    solid = without_hollows(floor)
    if plan.crossings is not None or _is_ragged(thinned(solid, plan.noise_m)):
        read = reachable_floor(solid)
        return read, reachable_floor(_drawn(read, plan.noise_m, options))
    drawn = _drawn(solid, plan.noise_m, options)
    read = reachable_floor(with_wider_doors(solid, drawn, directions(drawn), options))
    area = reachable_floor(_drawn(read, plan.noise_m, options))
    fine = thinned(read, FINE * plan.noise_m)
    return read, reachable_floor(with_frames(area, fine, directions(area), options))


def _layout(plan: FreeSpace, area: Polygon, rooms: Rooms, read: list[Polygon]) -> Layout:
    """The checked layout of a floor and its rooms; islands are furniture where one as `read` looks like that."""
    names = _names(rooms.floors, plan.labels)
    holes = [Polygon(hole) for hole in area.interiors]
    pieces = _pieces(area, read, plan.noise_m)
    layout = Layout(
        name=plan.name[:80],
        description=plan.description,
        solids=_solids(area, [hole for hole, piece in zip(holes, pieces, strict=True) if piece is None]),
        walls=[],
        rooms=[{"name": n, "polygon": _outline(f)} for n, f in zip(names, rooms.floors, strict=True)],
        doors=[_door(door, (names[a], names[b])) for door, (a, b) in zip(rooms.doors, rooms.sides, strict=True)],
        obstacles=[piece for piece in pieces if piece is not None],
        starts=_starts(area, rooms.floors),
    )
    check_geometry(layout)
    return layout


def _pieces(area: Polygon, read: list[Polygon], noise_m: float) -> list[dict[str, Any] | None]:
    """The obstacle of each island in `area` that is furniture and looks like one in `read`; None for the others."""
    if not read:
        return [None] * len(area.interiors)
    pairs = zip(area.interiors, are_walls(area), strict=True)
    return [None if wall else fitted(Polygon(hole), read, noise_m) for hole, wall in pairs]


def _drawn(floor: Polygon, noise_m: float, options: PlanOptions) -> Polygon:
    """`floor` with straight edges; a ragged one is drawn more coarsely. Raises LayoutError when it stays ragged."""
    noises = [noise_m, *(noise for noise in RAGGED_NOISES_M if noise > noise_m)]
    noises.append(_fitting(floor, noises[-1], MAX_FACES)[1])
    chosen = next((noise for noise in noises if not _is_ragged(thinned(floor, noise))), noises[-1])
    return straightened(floor, chosen, options.straighten)


def _is_ragged(floor: Polygon) -> bool:
    """Whether its edges are many and short, and go anywhere: those of a large clean plan go along its directions."""
    faces = int(shapely.get_num_coordinates(floor))
    many = faces > MANY_FACES and floor.length / faces < SHORT_EDGE_M
    return many and along_directions(floor) < CLEAN_SHARE


def _without_steps(floor: Polygon) -> Polygon:
    """`floor` without the vertices at every pixel along a straight edge."""
    points, ring = shapely.get_coordinates(shapely.get_rings(floor), return_index=True)
    before, across = points[1:-1] - points[:-2], points[2:] - points[:-2]
    off = np.abs(before[:, 0] * across[:, 1] - before[:, 1] * across[:, 0])
    along = (ring[2:] == ring[:-2]) & (off <= ON_EDGE_M * np.hypot(*across.T))
    kept = np.concatenate([[True], ~along, [True]])
    rings = shapely.linearrings(points[kept], indices=ring[kept])
    return Polygon(rings[0], rings[1:])


def _require_rooms(drawn: tuple[tuple[str, Point], ...], floors: list[Polygon]) -> None:
    """Raises LayoutError for a room that the file has and that is on none of the floors."""
    points = np.array([point for _, point in drawn], dtype=np.object_)
    found = set(shapely.STRtree(floors).query(points, "dwithin", NEAR_M)[0].tolist())
    lost = [place for i, (place, _) in enumerate(drawn) if i not in found]
    if lost:
        raise LayoutError(f"image: the room at {lost[0]} is lost: no door leads to it that is wide enough")


def _doors(area: Polygon, axes: tuple[float, ...], plan: FreeSpace, options: PlanOptions) -> list[Gap]:
    """The doors that the plan names, or else those that are found; the robot can drive through each."""
    if plan.crossings is None:
        gaps = find_doors(area, axes, options)
    else:
        walls = Walls.around(without_furniture(area))
        gaps = [gap for crossing in plan.crossings if (gap := measure(crossing, walls, axes, options, FINE_STEP_M))]
    reach = area.buffer(-ROBOT_RADIUS_M, quad_segs=4)
    return [gap for gap in gaps if is_between_walls(gap, area) and reach.intersects(Point(gap.centre))]


def _names(floors: list[Polygon], labels: tuple[tuple[str, Polygon], ...]) -> list[str]:
    """A name for each floor: of the label that it overlaps best, numbered where there are more; else room 1, 2, ..."""
    names: list[str] = []
    for i, floor in enumerate(floors, 1):
        plain = _best_label(floor, labels) or f"room {i}"
        numbered = (plain if number == 1 else f"{plain} {number}" for number in count(1))
        names.append(next(name for name in numbered if name not in names))
    return names


def _best_label(floor: Polygon, labels: tuple[tuple[str, Polygon], ...]) -> str | None:
    shares = [floor.intersection(box).area / floor.union(box).area for _, box in labels]
    best = int(np.argmax(shares)) if shares else -1
    return labels[best][0] if shares and shares[best] >= MATCH else None


def _ring(ring: shapely.LinearRing) -> list[tuple[float, float]]:
    return [(x, y) for x, y in np.array(ring.coords)[:-1].tolist()]


def _outline(floor: Polygon) -> list[tuple[float, float]]:
    """The ring of a room, of a ragged one as coarsely as a layout needs."""
    step = 0.0
    while len(floor.exterior.coords) > MANY_CORNERS:
        step += 0.05
        floor = floor.simplify(step)
    return _ring(floor.exterior)


def _solids(area: Polygon, holes: list[Polygon]) -> list[dict[str, object]]:
    """A wall around the floor, and the islands in it."""
    around = largest_part(Polygon(area.exterior).buffer(WALL_M, join_style="mitre", mitre_limit=2.0))
    walls: dict[str, object] = {"outer": _ring(around.exterior), "holes": [_ring(area.exterior)]}
    islands: list[dict[str, object]] = [{"outer": _ring(hole.exterior)} for hole in holes]
    return [walls, *islands]


def _door(gap: Gap, rooms: tuple[str, str]) -> dict[str, object]:
    heading = math.degrees(math.atan2(gap.through[1], gap.through[0]))
    return {
        "centre": tuple(gap.centre.tolist()),
        "width_m": gap.width_m,
        "rooms": rooms,
        "direction_deg": heading,
        "opening": "gap",
        "depth_m": max(gap.depth_m, DOOR_DEPTH_M),
    }


def _starts(area: Polygon, floors: list[Polygon]) -> list[dict[str, object]]:
    """The middle of each of the largest rooms; the first is the widest place of all that can be reached."""
    largest = sorted(floors, key=lambda floor: -floor.area)[:MOST_STARTS]
    circles = [shapely.maximum_inscribed_circle(floor.intersection(area), tolerance=0.05) for floor in largest]
    wide = [circle for circle in circles if circle.length >= START_CLEAR_M] or circles[:1]
    return [{"point": circle.coords[0], "heading_deg": 0.0} for circle in wide]
