"""Doors as short narrow passages: between two posts, wider on both sides, with walls that continue behind the posts.

Candidates run from a convex corner of the walls to another one, or square to a face. At each the width of the floor is
measured along lines parallel to it, a little before and behind. The best of them is closed first: a passage that was
wide only because of that opening is then no door.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely.geometry import LineString, Polygon, box

from mecp_env.core.array_types import Array, Bools
from mecp_env.floorplans.options import Crossing, PlanOptions

STEP_M, FINE_STEP_M = 0.02, 0.004  # between the lines along which the width is measured
AROUND_M = 0.4  # how far behind either face it must get wide
SQUARE_COS = math.cos(math.radians(72.0))  # a passage is narrowest where it is square to the walls beside it
STRAIGHT = math.radians(12.0)  # a passage nearer to a direction of the building is turned to it
SAME_WIDTH_M = 0.08  # a passage may vary so much between its faces
POST_M = 0.5  # a wall continues at least so far behind a post
FLUSH_COS = math.cos(math.radians(14.0))  # the face of the wall continues behind a post in the direction of the passage
FURNITURE_M = (0.2, 2.0)  # an island at least so wide and at most so long is a piece of furniture, not a wall,
PILLAR_M = 0.45  # and so is a smaller one of any shape
FURNITURE_FILL = 0.55  # when it fills so much of the rectangle around it
SAME_DOOR_M = 0.5  # two doorways so near to each other are one
SIGHT_M = 4.0  # how far is far enough
LEAST_DEPTH_M = 0.004  # of a doorway: of a wall as thin as a pixel less than a pixel may be left
OFF_M = 0.08  # the ends of a doorway may lie so far from the walls


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """A doorway in the floor of a plan."""

    centre: Array  # (2,) m
    along: Array  # (2,) unit vector from post to post
    width_m: float
    depth_m: float
    gain_m: float  # how much wider it is beside the doorway, on the narrower side
    post_m: float  # how far the wall continues behind the weaker post, at most `POST_M`
    to_walls_m: tuple[float, float]  # from the centre to the walls, against `along` and with it

    @property
    def through(self) -> Array:
        """Unit vector (2,) of a walk through it."""
        return np.array([-self.along[1], self.along[0]])

    @property
    def closing(self) -> Array:
        """Ends (2,2) of the line that closes it, a little inside of the walls."""
        against, ahead = self.to_walls_m
        return np.stack([self.centre - (against + 0.03) * self.along, self.centre + (ahead + 0.03) * self.along])


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """What ends a line across the floor."""

    area: Polygon  # m, the floor, prepared for questions
    faces: Array  # (f,2,2) m, of its edges
    tree: shapely.STRtree  # of them
    closed: Array  # (c,2,2) m, doors that are taken for walls

    @classmethod
    def around(cls, area: Polygon) -> Walls:
        shapely.prepare(area)
        faces = wall_faces(area)
        return cls(area, faces, shapely.STRtree(shapely.linestrings(faces)), np.empty((0, 2, 2)))

    def near(self, points: Array) -> Array:
        """Faces and closed doors (n,2,2) within sight of `points` (k,2)."""
        low, high = points.min(axis=0) - SIGHT_M, points.max(axis=0) + SIGHT_M
        faces = self.faces[self.tree.query(box(*low, *high))]
        return np.concatenate([faces, self.closed_near((low + high) / 2.0, math.dist(low, high))])

    def closed_near(self, point: Array, reach_m: float) -> Array:
        """Closed doors (n,2,2) that may lie within reach of a point (2,)."""
        far = np.abs(self.closed[:, 0] - point).max(axis=1, initial=0.0)
        near: Array = self.closed[far < reach_m + SIGHT_M]
        return near


def find_doors(area: Polygon, axes: tuple[float, ...], options: PlanOptions) -> list[Gap]:
    """The doorways of `area`, the surest first."""
    walls = Walls.around(without_furniture(area))
    measured = [measure(crossing, walls, axes, options) for crossing in _candidates(walls, options.door_width_m)]
    likely = [gap for gap in measured if gap and _is_door(gap, options)]
    found: list[Gap] = []
    for gap in sorted(likely, key=lambda gap: (-round(gap.post_m, 1), gap.width_m)):
        again = _still(gap, walls, axes, options)
        if again:
            found.append(again)
            walls = replace(walls, closed=np.concatenate([walls.closed, again.closing[None]]))
    return found


def _still(gap: Gap, walls: Walls, axes: tuple[float, ...], options: PlanOptions) -> Gap | None:
    """The doorway, measured finely, as it is now that others are closed; None when it is no longer a door."""
    if _crosses(gap, walls):
        return None
    again = measure(Crossing(gap.centre, gap.along), walls, axes, options, FINE_STEP_M)
    same = again and _is_door(again, options) and abs(again.width_m - gap.width_m) < SAME_WIDTH_M
    return again if again and same and not _crosses(again, walls) else None


def is_between_walls(gap: Gap, area: Polygon) -> bool:
    """The doorway is floor, and both its ends are walls."""
    middle = LineString([gap.centre - 0.49 * gap.width_m * gap.along, gap.centre + 0.49 * gap.width_m * gap.along])
    ends = shapely.points([gap.centre - 0.5 * gap.width_m * gap.along, gap.centre + 0.5 * gap.width_m * gap.along])
    off = shapely.distance(area.boundary, ends)
    return bool(area.contains(middle) and off.max() <= OFF_M)


def without_furniture(area: Polygon) -> Polygon:
    """`area` without free-standing furniture."""
    return Polygon(area.exterior, [hole for hole in area.interiors if not is_furniture(Polygon(hole))])


def is_furniture(island: Polygon) -> bool:
    """True when an island in the floor is furniture, not a wall."""
    around = np.array(shapely.minimum_rotated_rectangle(island).exterior.coords)
    sides = np.hypot(*np.diff(around, axis=0).T)
    full = island.area >= FURNITURE_FILL * sides[0] * sides[1] and sides.min() >= FURNITURE_M[0]
    return bool(sides.max() <= PILLAR_M or (full and sides.max() <= FURNITURE_M[1]))


def wall_faces(area: Polygon) -> Array:
    """Faces (n,2,2) of all rings of `area`, the floor on their left."""
    rings = [np.array(ring.coords) for ring in (area.exterior, *area.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])


def _crosses(gap: Gap, walls: Walls) -> bool:
    """Whether the doorway touches one that is closed already, or is the same drawn once more."""
    closed = walls.closed_near(gap.centre, gap.width_m)
    touching = shapely.distance(shapely.linestrings(closed), LineString(gap.closing)) < 0.02
    same = np.linalg.norm(closed.mean(axis=1) - gap.centre, axis=1) < SAME_DOOR_M
    return bool(np.any(touching | same))


def _candidates(walls: Walls, width_m: tuple[float, float]) -> list[Crossing]:
    """Lines from convex corners of the walls to others and to faces, square enough to both and across free floor."""
    corners, before, after = _convex_corners(walls.area)
    if not len(corners):
        return []
    pairs = [_corner_pairs(corners, before, after, width_m), _corner_faces(corners, before, after, walls, width_m)]
    starts, ends = (np.concatenate(column) for column in zip(*pairs, strict=True))
    inset = 0.01 * (ends - starts)
    free = shapely.covers(walls.area, shapely.linestrings(np.stack([starts + inset, ends - inset], axis=1)))
    return [Crossing((a + b) / 2.0, (b - a) / math.dist(a, b)) for a, b in zip(starts[free], ends[free], strict=True)]


def _convex_corners(area: Polygon) -> tuple[Array, Array, Array]:
    """Corners (n,2) of the walls where the solid is convex; unit vectors (n,2) to the corner before and after."""
    columns = []
    for ring in (area.exterior, *area.interiors):
        points = np.array(ring.coords)[:-1]
        back, ahead = np.roll(points, 1, axis=0) - points, np.roll(points, -1, axis=0) - points
        back, ahead = (v / np.linalg.norm(v, axis=1)[:, None] for v in (back, ahead))
        convex = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0] > 0.05
        columns.append((points[convex], back[convex], ahead[convex]))
    corners, before, after = (np.concatenate(column) for column in zip(*columns, strict=True))
    return corners, before, after


def _corner_pairs(corners: Array, before: Array, after: Array, width_m: tuple[float, float]) -> tuple[Array, Array]:
    i, j = cKDTree(corners).query_pairs(width_m[1], output_type="ndarray").reshape(-1, 2).T
    width = np.linalg.norm(corners[j] - corners[i], axis=1)
    i, j, width = (column[width >= width_m[0]] for column in (i, j, width))
    direction = (corners[j] - corners[i]) / width[:, None]
    square = _is_square(direction, before[i], after[i]) & _is_square(-direction, before[j], after[j])
    return corners[i[square]], corners[j[square]]


def _is_square(direction: Array, before: Array, after: Array) -> Bools:
    """Whether (n,) the unit vectors `direction` lead away from a corner, straight on from one of its faces."""
    to_before, to_after = np.sum(direction * before, axis=1), np.sum(direction * after, axis=1)
    square: Bools = np.maximum(to_before, to_after) < SQUARE_COS
    flush: Bools = square & (np.minimum(to_before, to_after) < -FLUSH_COS)
    return flush


def _corner_faces(
    corners: Array, before: Array, after: Array, walls: Walls, width_m: tuple[float, float]
) -> tuple[Array, Array]:
    """From each corner the perpendicular to every face near it."""
    i, j = walls.tree.query(shapely.buffer(shapely.points(corners), width_m[1]), predicate="intersects")
    first, step = walls.faces[j, 0], walls.faces[j, 1] - walls.faces[j, 0]
    share = np.sum((corners[i] - first) * step, axis=1) / np.sum(step**2, axis=1)
    feet = first + share[:, None] * step
    width = np.linalg.norm(feet - corners[i], axis=1)
    fits = (share > 0.0) & (share < 1.0) & (width >= width_m[0]) & (width <= width_m[1])
    i, feet = i[fits], feet[fits]
    square = _is_square((feet - corners[i]) / width[fits, None], before[i], after[i])
    return corners[i[square]], feet[square]


def measure(
    crossing: Crossing, walls: Walls, axes: tuple[float, ...], options: PlanOptions, step_m: float = STEP_M
) -> Gap | None:
    """The passage at `crossing` as a doorway, by lines `step_m` apart; None where there is no floor."""
    along = _straight(crossing.along, axes)
    through = np.array([-along[1], along[0]])
    reach = options.door_depth_m + AROUND_M
    ahead = np.arange(-reach, reach + step_m, step_m)
    left, right = _extent(crossing.middle + ahead[:, None] * through, along, walls)
    first, last = _passage(left + right)
    if last < first:
        return None
    depth = ahead[last] - ahead[first] + step_m
    low, high = -left[first : last + 1].min(), right[first : last + 1].min()
    beside = round(AROUND_M / step_m)
    gain = min(_widest(left + right, first, -beside), _widest(left + right, last, beside)) - (high - low)
    centre = crossing.middle + (ahead[first] + ahead[last]) / 2.0 * through + (low + high) / 2.0 * along
    middle = (first + last) // 2
    return Gap(
        centre=centre,
        along=along,
        width_m=float(high - low),
        depth_m=float(depth),
        gain_m=float(gain),
        post_m=_posts(centre, along, high - low, walls),
        to_walls_m=(float(left[middle] + (low + high) / 2.0), float(right[middle] - (low + high) / 2.0)),
    )


def _straight(along: Array, axes: tuple[float, ...]) -> Array:
    """`along`, turned to a direction of the building when it is near one."""
    angle = math.atan2(along[1], along[0])
    off = min(((axis - angle + math.pi / 4.0) % (math.pi / 2.0) - math.pi / 4.0 for axis in axes), key=abs, default=1.0)
    angle += off if abs(off) < STRAIGHT else 0.0
    return np.array([math.cos(angle), math.sin(angle)])


def _extent(points: Array, along: Array, walls: Walls) -> tuple[Array, Array]:
    """How far (n,) it is from each of `points` to the wall against `along` and with it; 0 both for points in a wall."""
    place = _hits(points, along, walls.near(points))
    right = np.where(place > 0.0, place, np.inf).min(axis=1, initial=SIGHT_M)
    left = np.where(place <= 0.0, -place, np.inf).min(axis=1, initial=SIGHT_M)
    floor = shapely.contains_xy(walls.area, points)
    return np.where(floor, left, 0.0), np.where(floor, right, 0.0)


def _hits(points: Array, along: Array, faces: Array) -> Array:
    """Where (n,f) the line through each point meets each face, m ahead of it or nan."""
    normal = np.array([-along[1], along[0]])
    height, across = faces @ normal, faces @ along
    rise = height[:, 1] - height[:, 0]
    share = ((points @ normal)[:, None] - height[:, 0]) / np.where(rise == 0.0, np.nan, rise)
    place = across[:, 0] + share * (across[:, 1] - across[:, 0]) - (points @ along)[:, None]
    return np.where((share >= 0.0) & (share < 1.0), place, np.nan)


def _passage(width: Array) -> tuple[int, int]:
    """First and last line of the narrow part around the middle one; the last before the first where there is none."""
    middle = len(width) // 2  # it may run along a face
    start = min(range(middle - 2, middle + 3), key=lambda i: (width[i] <= 0.0, width[i], abs(i - middle)))
    narrow = (width < width[start] + SAME_WIDTH_M) & (width > 0.0)
    before, after = np.flatnonzero(~narrow[: start + 1]), np.flatnonzero(~narrow[start:])
    first = int(before[-1]) + 1 if len(before) else 0
    return first, start + int(after[0]) - 1 if len(after) else len(width) - 1


def _widest(width: Array, edge: int, count: int) -> float:
    """Greatest width of so many lines behind line `edge`, before it where `count` is negative; 0 without any."""
    beside = width[edge + 1 : edge + 1 + count] if count > 0 else width[max(0, edge + count) : edge]
    return float(beside.max(initial=0.0))


def _posts(centre: Array, along: Array, width: float, walls: Walls) -> float:
    """How far the wall continues behind the weaker of both posts, at most `POST_M`."""
    behind = np.arange(0.04, POST_M + 1e-9, 0.02)
    lengths = []
    for direction in (-along, along):
        left, right = _extent(centre + (width / 2.0 + behind)[:, None] * direction, along, walls)
        open_floor = np.flatnonzero(left + right > 0.0)
        lengths.append(behind[open_floor[0]] if len(open_floor) else POST_M)
    return float(min(lengths))


def _is_door(gap: Gap, options: PlanOptions) -> bool:
    """Short, of a door's width, and clearly wider on both sides: the deeper and wider it is, the more."""
    needed = 0.15 if gap.depth_m < 0.4 and gap.width_m < 1.3 else 0.3 * gap.width_m
    fits = options.door_width_m[0] <= gap.width_m <= options.door_width_m[1]
    return fits and LEAST_DEPTH_M <= gap.depth_m <= options.door_depth_m and gap.gain_m >= needed
