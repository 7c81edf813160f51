"""The single outline of the building: union of wall solids, doors cut out, obstacles added.

The walls of the simulation, the faces for the laser and the corners for the metrics all come from here. Only faces
around the free space of the start are kept; the outside of the building has none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon, box
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.core.se2 import wrap_angle
from mecp_env.world.schema import ROUND_FACES, BoxSpec, Layout, Obstacle, Pillar, Solid

ROBOT_RADIUS_M = 0.22  # the paper's robot
SNAP_M = 1e-6  # the free area is rounded to this grid, so that touching solids leave no slivers
SAME_M = 1e-4  # points closer than this are one
GAP_POST_M = 0.12  # between a corner of a gap and the convex corner that is its jamb
THIN_FOR_M = 0.2  # a wall that is thin over this length is a thin wall
SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
ANGLES = np.arange(ROUND_FACES) * (2.0 * math.pi / ROUND_FACES)
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])  # a polygon within 0.5 % of the radius


@dataclass(frozen=True, slots=True, eq=False)
class TrueCorners:
    """The corners of the building and of its obstacles; round obstacles have none."""

    p_world: Array  # (n,2) m
    convex: Bools  # (n,) the solid fills less than 180 degrees
    faces: Array  # (n,2) m, lengths of the faces before and after
    normals: Array  # (n,2) rad, of the faces before and after, towards free space

    def __len__(self) -> int:
        return len(self.p_world)


@dataclass(frozen=True, slots=True, eq=False)
class Doors:
    """The doorways."""

    centre: Array  # (d,2) m
    width: Array  # (d,) m
    normal: Array  # (d,) rad, heading from rooms[:, 0] to rooms[:, 1]
    rooms: Ints  # (d,2) room indices
    thickness: Array  # (d,) m, of the wall it is cut from, or the depth of the gap
    gap: Bools  # (d,) a gap of the solids, not cut

    def __len__(self) -> int:
        return len(self.centre)


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """The boundary of the free space of a layout, in the world frame."""

    name: str
    segments: Array  # (S,2,2) m, start and end of each face, free space on the left
    round: Bools  # (S,) face of a round obstacle
    corners: TrueCorners
    doors: Doors
    free_area: Polygon  # the free area: connected, doorways included
    rooms: tuple[Polygon, ...]  # floors, up to the middle of the walls
    room_names: tuple[str, ...]
    starts: Array  # (k,3) x, y, heading

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x, largest y of the free area, m."""
        x0, y0, x1, y1 = self.free_area.bounds
        return x0, y0, x1, y1

    def room_at(self, p_world: Array) -> Ints:
        """Index (n,) of the room that each point (n,2) lies in, or -1."""
        x, y = np.asarray(p_world, dtype=np.float64).reshape(-1, 2).T
        rooms = np.full(len(x), -1, dtype=np.int64)
        floors = shapely.force_2d(self.rooms)  # copies: a prepared shape is not for several threads
        shapely.prepare(floors)
        for index, room in reversed(list(enumerate(floors))):
            rooms[shapely.intersects_xy(room, x, y)] = index
        return rooms


def build_outline(layout: Layout) -> Outline:
    """The outline of `layout`.

    Raises LayoutError when the first start is not in free space, or the free space around it is not closed.
    """
    doors = _doors(layout)
    free_area = _free_area(layout, doors)
    segments, before = _faces(free_area)
    is_round = _round_faces(layout, segments)
    return Outline(
        name=layout.name,
        segments=segments,
        round=is_round,
        corners=_corners(segments, before, is_round),
        doors=doors,
        free_area=free_area,
        rooms=tuple(Polygon(room.polygon) for room in layout.rooms),
        room_names=tuple(room.name for room in layout.rooms),
        starts=np.array([[*s.point, wrap_angle(math.radians(s.heading_deg))] for s in layout.starts]),
    )


def wall_lines(layout: Layout) -> tuple[list[LineString], Array]:
    """Middle line of every straight stretch of wall, and the thickness (n,) of each."""
    stretches = [pair for wall in layout.walls for pair in pairwise(wall.points)]
    thickness = [wall.thickness_m for wall in layout.walls for _ in pairwise(wall.points)]
    return shapely.linestrings(np.array(stretches).reshape(-1, 2, 2)).tolist(), np.array(thickness)


def reachable(outline: Outline) -> BaseGeometry:
    """Where the centre of the paper's robot can go from the first start."""
    parts = shapely.get_parts(outline.free_area.buffer(-ROBOT_RADIUS_M, quad_segs=4))
    return parts[int(np.argmin(shapely.distance(parts, Point(outline.starts[0, :2]))))]


def random_free_pose(outline: Outline, rng: np.random.Generator, clearance_m: float) -> Array:
    """A pose (3,) drawn evenly from what is in reach and at least `clearance_m` from every wall; any heading.

    Raises LayoutError when there is none.
    """
    area = reachable(outline).intersection(outline.free_area.buffer(-clearance_m))
    if area.area == 0.0:
        raise LayoutError(f"clearance_m: no point of {outline.name!r} lies {clearance_m:g} m from every wall")
    shapely.prepare(area)
    x0, y0, x1, y1 = area.bounds
    while True:
        x, y = rng.uniform((x0, y0), (x1, y1))
        if area.contains(Point(x, y)):
            return np.array([x, y, rng.uniform(-math.pi, math.pi)])


def thin_walls_m(floor: Polygon, least_m: float) -> float:
    """Length, m, of the walls in `floor` that are thinner than this; walls under 0.2 m do not count."""
    closed = floor.buffer(least_m / 2.0, join_style="mitre").buffer(-least_m / 2.0, join_style="mitre")
    parts = shapely.get_parts(closed.difference(floor))
    around, area = shapely.length(parts), shapely.area(parts)
    walls = (around > 2.0 * THIN_FOR_M) & (area > 0.5 * SAME_M * around)  # the others are rounding along a face
    return float(around[walls].sum() / 2.0)


def obstacle_shape(obstacle: Obstacle) -> Polygon:
    """The solid of an obstacle."""
    if isinstance(obstacle, Pillar):
        return Polygon(np.array(obstacle.centre) + obstacle.radius_m * CIRCLE)
    if isinstance(obstacle, BoxSpec):
        ring = SQUARE * np.array(obstacle.size) / 2.0
        return Polygon(np.array(obstacle.centre) + ring @ _rotation(math.radians(obstacle.turn_deg)).T)
    return Polygon(obstacle.points)


def _rotation(angle: float) -> Array:
    return np.array([(math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))])


def _doors(layout: Layout) -> Doors:
    """The doors with the thickness of the wall that each is cut from."""
    centres = np.array([door.centre for door in layout.doors]).reshape(-1, 2)
    index = {room.name: i for i, room in reversed(list(enumerate(layout.rooms)))}
    rooms = [(index.get(door.rooms[0], -1), index.get(door.rooms[1], -1)) for door in layout.doors]
    return Doors(
        centre=centres,
        width=np.array([door.width_m for door in layout.doors]),
        normal=np.array([wrap_angle(door.heading) for door in layout.doors]),
        rooms=np.array(rooms, dtype=np.int64).reshape(-1, 2),
        thickness=_door_thickness(layout, centres),
        gap=np.array([door.opening == "gap" for door in layout.doors], dtype=np.bool_),
    )


def _door_thickness(layout: Layout, centres: Array) -> Array:
    """Thickness (d,) of the wall nearest to each door; of a gap its depth."""
    lines, thickness = wall_lines(layout)
    depth = np.array([door.depth_m or 0.0 for door in layout.doors])
    if not lines:
        return depth
    _, nearest = shapely.STRtree(lines).query_nearest(shapely.points(centres), all_matches=False)
    return np.where(depth > 0.0, depth, thickness[nearest])


def solid_shape(solid: Solid) -> Polygon:
    """The wall material of a solid."""
    return Polygon(solid.outer, solid.holes)


def _free_area(layout: Layout, doors: Doors) -> Polygon:
    """The free space around the first start."""
    cuts = [Polygon(door_ring(doors, i, 0.02)) for i in np.flatnonzero(~doors.gap).tolist()]
    blocks = [*map(obstacle_shape, layout.obstacles), *map(solid_shape, layout.solids)]
    solids = shapely.difference(shapely.union_all(wall_solids(layout)), shapely.union_all(cuts))
    solids = shapely.union(solids, shapely.union_all(blocks))
    x0, y0, x1, y1 = solids.bounds
    around = box(x0 - 1.0, y0 - 1.0, x1 + 1.0, y1 + 1.0)
    free = shapely.set_precision(around.difference(solids), SNAP_M)
    return _part_with_start(shapely.set_precision(free, 0.0), around, layout)  # 0: what follows is not rounded


def wall_solids(layout: Layout) -> NDArray[np.object_]:
    """The solid of each wall, with square ends and mitred corners."""
    points = np.array([point for wall in layout.walls for point in wall.points]).reshape(-1, 2)
    wall_of = np.repeat(np.arange(len(layout.walls)), [len(wall.points) for wall in layout.walls])
    lines = shapely.linestrings(points, indices=wall_of)
    half = np.array([wall.thickness_m / 2.0 for wall in layout.walls])
    solids: NDArray[np.object_] = shapely.buffer(lines, half, cap_style="square", join_style="mitre")
    return solids


def door_ring(doors: Doors, index: int, overhang_m: float) -> Array:
    """Corners (4,2) of the doorway; `overhang_m` beyond either face of the wall."""
    half = np.array([doors.thickness[index] / 2.0 + overhang_m, doors.width[index] / 2.0])
    ring = SQUARE * half
    turned: Array = doors.centre[index] + ring @ _rotation(float(doors.normal[index])).T
    return turned


def _part_with_start(free: BaseGeometry, around: Polygon, layout: Layout) -> Polygon:
    """The connected part of `free` that holds the first start; it must not reach the outside."""
    start = layout.starts[0].point
    part = next((part for part in shapely.get_parts(free) if part.intersects(Point(start))), None)
    if part is None:
        raise LayoutError(f"starts.0.point: {start} lies inside a wall or an obstacle, or outside of all walls")
    if part.intersects(around.exterior):
        raise LayoutError(f"starts.0.point: {start} lies outside, or the walls around it are not closed")
    return orient(part, 1.0)


def _faces(area: Polygon) -> tuple[Array, Ints]:
    """Faces (S,2,2) of all rings of `area`, which lies on their left; and the index (S,) of the face before each."""
    faces, before, count = [np.empty((0, 2, 2))], [np.empty(0, np.int64)], 0
    for ring in (area.exterior, *area.interiors):
        points = _without_collinear(np.array(ring.coords)[:-1])
        faces.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
        before.append(np.roll(np.arange(count, count + len(points)), 1))
        count += len(points)
    return np.concatenate(faces), np.concatenate(before)


def _without_collinear(points: Array) -> Array:
    """A ring (n,2) without the vertices that lie on the line through their neighbours."""
    u, v = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    kept: Array = points[np.abs(cross) > SAME_M * np.linalg.norm(u + v, axis=1)]
    return kept


def _round_faces(layout: Layout, segments: Array) -> Bools:
    """Which faces (S,) belong to a round obstacle."""
    is_round = np.zeros(len(segments), dtype=np.bool_)
    for pillar in (o for o in layout.obstacles if isinstance(o, Pillar)):
        off = np.abs(np.linalg.norm(segments - np.array(pillar.centre), axis=2) - pillar.radius_m)
        is_round |= np.all(off < SAME_M, axis=1)
    return is_round


def _corners(segments: Array, before: Ints, is_round: Bools) -> TrueCorners:
    """A corner at the start of every face that follows a straight face."""
    chosen = np.flatnonzero(~(is_round | is_round[before]))
    first, second = segments[before[chosen]], segments[chosen]
    u, v = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    return TrueCorners(
        p_world=np.ascontiguousarray(second[:, 0]),
        convex=u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0,
        faces=np.column_stack([np.hypot(*u.T), np.hypot(*v.T)]),
        normals=np.column_stack([np.arctan2(u[:, 0], -u[:, 1]), np.arctan2(v[:, 0], -v[:, 1])]),
    )
