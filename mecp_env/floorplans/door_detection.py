"""Doors as short narrow passages: between two posts, wider on both sides, with walls that continue behind the posts.

Candidates are the shortest lines across the floor between two faces of its walls. A doorway is narrowest between two
faces that are the nearest walls of the middle of the line between them: a circle over that line is free of walls (a
critical point of the Voronoi diagram of the walls, Thrun 1998). At each the width of the floor is measured along lines
parallel to it, a little before and behind. The best of them is closed first: a passage that was wide only because of
that opening is then no door.

Door frames of a pixel or two that straight walls would lose are kept; doorways that thick lines narrow are widened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.floor import edges_of, largest_part, without_furniture
from mecp_env.floorplans.options import Crossing, PlanOptions
from mecp_env.floorplans.straighten import quarter

STEP_M, FINE_STEP_M = 0.02, 0.004  # between the lines along which the width is measured
AROUND_M = 0.4  # how far behind either face it must get wide
SAME_WIDTH_M = 0.08  # a passage may vary so much between its faces
POST_M = 0.5  # a wall continues at least so far behind a post
SAME_DOOR_M = 0.5  # two doorways so near to each other are one
SIGHT_M = 4.0  # how far is far enough
BESIDE_M = 1e-3  # no line meets a face that is further beside it
LEAST_DEPTH_M = 0.004  # of a doorway: of a wall as thin as a pixel less than a pixel may be left
FRAME_M, FRAME_WIDTH_M = 0.25, 1.45  # a thinner doorway of less width may be a frame,
FRAME_GAIN_M = 0.12  # beside which it is wider by so much;
GAIN = 0.3  # beside any other doorway it is wider by such a share of its width,
DEEP_GAIN = 1.1  # and by such a share beside one that may be the narrow part of a room:
THICK_M, SINGLE_M = 0.4, 1.1  # at least so deep and so wide
OFF_M = 0.08  # the ends of a doorway may lie so far from the walls
APART_M = 0.6  # a frame is no part of a doorway that is further away
INTO_WALL_M = 0.15  # how far a post reaches into its wall
STANDING_OUT_M = (0.08, 0.25)  # how far a post stands out
FRAME_POST_M, THICKEST_M = 0.1, 0.16  # thickness of a post
DRIVEN_M = 0.6  # a doorway that the robot can drive through with a margin of 0.08 m
STRAIGHT = math.radians(12.0)  # a passage nearer to a direction of the building is turned to it
FREE = 0.9  # share of the circle's radius that is free of walls
MAX_PAIRS = 3_000_000  # of faces that are near to each other
CHUNK = 500  # faces whose neighbours are sought at once, which bounds the memory
LEAST_M = 1e-6  # shorter faces and lines have no direction
ROOM_M = 0.35  # how far before and behind a doorway its rooms are looked up


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """A doorway in the floor of a plan."""

    centre: Array  # (2,) m
    along: Array  # (2,) unit vector from post to post
    width_m: float
    depth_m: float
    gain_m: float  # how much wider it is beside the doorway, on the narrower side
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

    def piece(self, low: float, high: float, half: float) -> Polygon:
        """The rectangle from `low` to `high`, m along it, and `half` as far in both directions through it."""
        corners = ((low, -half), (high, -half), (high, half), (low, half))
        return Polygon([self.centre + u * self.along + v * self.through for u, v in corners])


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
        faces, _ = edges_of(np.array([area], dtype=np.object_))  # the floor on their left
        return cls(area, faces, shapely.STRtree(shapely.linestrings(faces)), np.empty((0, 2, 2)))

    def near(self, points: Array, along: Array) -> Array:
        """Faces (n,2,2) within sight of `points` (k,2) against `along` or with it, and all closed doors."""
        margin = SIGHT_M * np.abs(along) + BESIDE_M
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        faces = self.faces[self.tree.query(shapely.box(*low, *high))]
        return np.concatenate([faces, self.closed])


def find_doors(area: Polygon, axes: tuple[float, ...], options: PlanOptions) -> list[Gap]:
    """The doorways of `area`, the surest first."""
    return doorways(Walls.around(without_furniture(area)), axes, options)


def doorways(walls: Walls, axes: tuple[float, ...], options: PlanOptions) -> list[Gap]:
    """The doorways between `walls`, the surest first."""
    candidates = _crossings(walls, axes, options.door_width_m)
    measured = [measure(crossing, walls, axes, options) for crossing in candidates]
    likely = [gap for gap in measured if gap and _is_door(gap, options)]
    found: list[Gap] = []
    for gap in sorted(likely, key=partial(_doubt, walls=walls)):
        again = _still(gap, walls, axes, options)
        if again:
            found.append(again)
            walls = replace(walls, closed=np.concatenate([walls.closed, again.closing[None]]))
    return found


def _doubt(gap: Gap, walls: Walls) -> tuple[float, float]:
    """The key by which the surest come first: the wall goes on far behind the weaker post, and then they are narrow."""
    return -round(min(post_lengths(gap.centre, gap.along, gap.width_m, walls)), 1), gap.width_m


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


def _crosses(gap: Gap, walls: Walls) -> bool:
    """Whether the doorway touches one that is closed already, or is the same drawn once more."""
    touching = shapely.distance(shapely.linestrings(walls.closed), LineString(gap.closing)) < 0.02
    same = np.linalg.norm(walls.closed.mean(axis=1) - gap.centre, axis=1) < SAME_DOOR_M
    return bool(np.any(touching | same))


def _crossings(walls: Walls, axes: tuple[float, ...], width_m: tuple[float, float]) -> list[Crossing]:
    """Lines across the floor between `walls` that are as long as a doorway is wide.

    Each is square to a face at one of its ends, or along one of `axes`, the directions (rad) of the building.
    Raises LayoutError for far too many faces.
    """
    faces = walls.faces[np.linalg.norm(walls.faces[:, 1] - walls.faces[:, 0], axis=1) > LEAST_M]
    tree = shapely.STRtree(shapely.linestrings(faces))
    i, j = _near(tree, faces, width_m[1])
    lines = shapely.shortest_line(tree.geometries[i], tree.geometries[j])
    a, b = _across(faces[i], faces[j], shapely.get_coordinates(lines).reshape(-1, 2, 2))
    middle, width = (a + b) / 2.0, np.linalg.norm(b - a, axis=1)
    fits = (width >= max(width_m[0], LEAST_M)) & (width <= width_m[1])
    i, j, a, b, middle, width = (column[fits] for column in (i, j, a, b, middle, width))
    along = (b - a) / width[:, None]
    fits = _is_square(along, faces[i], faces[j], axes) & shapely.contains_xy(walls.area, middle)
    clear = tree.query_nearest(shapely.points(middle[fits]), all_matches=False, return_distance=True)[1]
    fits[fits] = clear > FREE * 0.5 * width[fits]
    return [Crossing(*pair) for pair in zip(middle[fits], along[fits], strict=True)]


def _near(tree: shapely.STRtree, faces: Array, most_m: float) -> tuple[Ints, Ints]:
    """Pairs of faces at most so far apart, each in front of the other. Raises LayoutError for far too many."""
    near, count = [np.empty((2, 0), np.int64)], 0
    for first in range(0, len(faces), CHUNK):
        i, j = tree.query(tree.geometries[first : first + CHUNK], predicate="dwithin", distance=most_m)
        count += len(i)
        if count > MAX_PAIRS:
            raise LayoutError(f"the floor has more than {MAX_PAIRS} pairs of edges within {most_m:g} m")
        i, j = (i + first)[i + first < j], j[i + first < j]
        near.append(np.stack([i, j])[:, _is_in_front(faces[i], faces[j]) & _is_in_front(faces[j], faces[i])])
    i, j = np.concatenate(near, axis=1)
    return i, j


def _is_in_front(faces: Array, others: Array) -> Bools:
    """Whether (n,) an end of each of `others` (n,2,2) is on the floor's side of the line through its face."""
    x, y = np.moveaxis(faces[:, 1] - faces[:, 0], 1, 0)
    off = others - faces[:, :1]
    in_front: Bools = (x[:, None] * off[..., 1] - y[:, None] * off[..., 0]).max(axis=1) > LEAST_M
    return in_front


def _across(first: Array, second: Array, shortest: Array) -> tuple[Array, Array]:
    """Ends (n,2) of the `shortest` line (n,2,2) from each of the faces `first` (n,2,2) to one of `second`.

    Faces that are opposite each other and nearly parallel have many; it is the one in the middle.
    """
    a, b = shortest[:, 0].copy(), shortest[:, 1].copy()
    step, turn = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    share = np.einsum("nkc,nc->nk", second - first[:, :1], step) / np.sum(step**2, axis=1)[:, None]
    low, high = np.clip(np.sort(share, axis=1), 0.0, 1.0).T
    cosine = np.sum(step * turn, axis=1) / np.linalg.norm(step, axis=1) / np.linalg.norm(turn, axis=1)
    opposite = (np.abs(cosine) > math.cos(STRAIGHT)) & (high > low)
    where = (low + high) / 2.0
    on_second = (where - share[:, 0]) / np.where(opposite, share[:, 1] - share[:, 0], 1.0)
    a[opposite] = (first[:, 0] + where[:, None] * step)[opposite]
    b[opposite] = (second[:, 0] + on_second[:, None] * turn)[opposite]
    return a, b


def _is_square(along: Array, first: Array, second: Array, axes: tuple[float, ...]) -> Bools:
    """Whether (n,) the unit vectors `along` (n,2) are square to one of two faces each, or along one of `axes`."""
    faces = np.stack([first, second], axis=1)
    step = faces[:, :, 1] - faces[:, :, 0]
    sine = np.einsum("nc,nfc->nf", along, step / np.linalg.norm(step, axis=2)[..., None])
    off = quarter(np.arctan2(along[:, 1], along[:, 0])[:, None] - np.array(axes))
    square: Bools = (np.abs(sine) < math.sin(STRAIGHT)).any(axis=1) | (np.abs(off) < STRAIGHT).any(axis=1)
    return square


def measure(
    crossing: Crossing, walls: Walls, axes: tuple[float, ...], options: PlanOptions, step_m: float = STEP_M
) -> Gap | None:
    """The passage at `crossing` as a doorway, by lines `step_m` apart; None where there is no floor."""
    along = _straight(crossing.along, axes)
    through = np.array([-along[1], along[0]])
    reach = options.door_depth_m + AROUND_M
    ahead = np.arange(-reach, reach + step_m, step_m)
    left, right = extent(crossing.middle + ahead[:, None] * through, along, walls)
    first, last = _passage(left + right)
    if last < first:
        return None
    depth = ahead[last] - ahead[first] + step_m
    low, high = -left[first : last + 1].min(), right[first : last + 1].min()
    beside = round(AROUND_M / step_m)
    gain = min(_beside(left + right, first, last, beside)) - (high - low)
    centre = crossing.middle + (ahead[first] + ahead[last]) / 2.0 * through + (low + high) / 2.0 * along
    middle = (first + last) // 2
    return Gap(
        centre=centre,
        along=along,
        width_m=float(high - low),
        depth_m=float(depth),
        gain_m=float(gain),
        to_walls_m=(float(left[middle] + (low + high) / 2.0), float(right[middle] - (low + high) / 2.0)),
    )


def _straight(along: Array, axes: tuple[float, ...]) -> Array:
    """`along`, turned to a direction of the building when it is near one."""
    angle = math.atan2(along[1], along[0])
    off = min((float(quarter(axis - angle)) for axis in axes), key=abs, default=1.0)
    angle += off if abs(off) < STRAIGHT else 0.0
    return np.array([math.cos(angle), math.sin(angle)])


def extent(points: Array, along: Array, walls: Walls) -> tuple[Array, Array]:
    """How far (n,) it is from each of `points` to the wall against `along` and with it; 0 both for points in a wall."""
    point, place = _hits(points, along, walls.near(points, along))
    left, right = np.full((2, len(points)), SIGHT_M)
    ahead = place > 0.0
    np.minimum.at(right, point[ahead], place[ahead])
    np.minimum.at(left, point[~ahead], -place[~ahead])
    floor = shapely.contains_xy(walls.area, points)
    return np.where(floor, left, 0.0), np.where(floor, right, 0.0)


def _hits(points: Array, along: Array, faces: Array) -> tuple[Ints, Array]:
    """Where (h,) the lines through `points` meet faces: the index of the point, and m ahead of it."""
    normal = np.array([-along[1], along[0]])
    height, across = faces @ normal, faces @ along
    rise = height[:, 1] - height[:, 0]
    level = points @ normal
    point, face = _between(level, height)
    share = (level[point] - height[face, 0]) / rise[face]
    place = across[face, 0] + share * (across[face, 1] - across[face, 0]) - (points @ along)[point]
    met = (share >= 0.0) & (share < 1.0)
    return point[met], place[met]


def _between(level: Array, height: Array) -> tuple[Ints, Ints]:
    """The pairs (h,) of a level (n,) and a face whose ends are at `height` (f,2), one of them on each side of it."""
    order = np.argsort(level)
    low, high = height.min(axis=1), height.max(axis=1)
    first = np.searchsorted(level, low, "left", order)
    count = np.where(high > low, np.searchsorted(level, high, "right", order) - first, 0)
    face = np.repeat(np.arange(len(height)), count)
    return order[np.arange(len(face)) - (count.cumsum() - count - first)[face]], face


def _passage(width: Array) -> tuple[int, int]:
    """First and last line of the narrow part around the middle one; the last before the first where there is none."""
    middle = len(width) // 2  # it may run along a face
    start = min(range(middle - 2, middle + 3), key=lambda i: (width[i] <= 0.0, width[i], abs(i - middle)))
    narrow = (width < width[start] + SAME_WIDTH_M) & (width > 0.0)
    before, after = np.flatnonzero(~narrow[: start + 1]), np.flatnonzero(~narrow[start:])
    first = int(before[-1]) + 1 if len(before) else 0
    return first, start + int(after[0]) - 1 if len(after) else len(width) - 1


def _beside(width: Array, first: int, last: int, count: int) -> tuple[float, float]:
    """Greatest width of so many lines before line `first` and behind line `last`; 0 without any."""
    before, behind = width[max(0, first - count) : first], width[last + 1 : last + 1 + count]
    return float(before.max(initial=0.0)), float(behind.max(initial=0.0))


def post_lengths(centre: Array, along: Array, width: float, walls: Walls) -> tuple[float, float]:
    """How far the wall continues behind the posts, against `along` and with it, at most `POST_M`."""
    behind = np.arange(0.04, POST_M + 1e-9, 0.02)
    lengths = []
    for direction in (-along, along):
        left, right = extent(centre + (width / 2.0 + behind)[:, None] * direction, along, walls)
        open_floor = np.flatnonzero(left + right > 0.0)
        lengths.append(float(behind[open_floor[0]]) if len(open_floor) else POST_M)
    return lengths[0], lengths[1]


def _is_door(gap: Gap, options: PlanOptions) -> bool:
    """Short, of a door's width, and clearly wider on both sides: the deeper and wider it is, the more."""
    fits = options.door_width_m[0] <= gap.width_m <= options.door_width_m[1]
    return fits and LEAST_DEPTH_M <= gap.depth_m <= options.door_depth_m and gap.gain_m >= _needed(gap)


def _needed(gap: Gap) -> float:
    """How much wider, m, it must be on both sides."""
    if gap.depth_m < FRAME_M and gap.width_m < FRAME_WIDTH_M:
        return FRAME_GAIN_M
    deep = gap.depth_m >= THICK_M and gap.width_m >= SINGLE_M
    return (DEEP_GAIN if deep else GAIN) * gap.width_m


def with_frames(area: Polygon, drawn: Polygon, axes: tuple[float, ...], options: PlanOptions) -> Polygon:
    """`area`, which has straight walls, with the door frames that `drawn` has and where it has no doorway."""
    narrow = options.model_copy(update={"door_width_m": (options.door_width_m[0], FRAME_WIDTH_M)})
    known = np.array([gap.centre for gap in find_doors(area, axes, options)]).reshape(-1, 2)
    found = doorways(Walls.around(without_furniture(drawn)), axes, narrow)
    frames = [gap for gap in found if _is_frame(gap) and _is_apart(gap, known)]
    walls = Walls.around(area)
    return largest_part(area.difference(shapely.union_all([post for gap in frames for post in _posts(gap, walls)])))


def _is_frame(gap: Gap) -> bool:
    """Thin posts that stand out a little."""
    return gap.depth_m <= THICKEST_M and gap.gain_m <= 2.0 * STANDING_OUT_M[1]


def _is_apart(gap: Gap, known: Array) -> bool:
    return bool(np.all(np.linalg.norm(known - gap.centre, axis=1) > APART_M))


def _posts(gap: Gap, walls: Walls) -> list[Polygon]:
    """The posts on both sides of a frame, from the `walls` inwards."""
    against, ahead = (float(side[0]) for side in extent(gap.centre[None], gap.along, walls))
    posts, half = [], 0.5 * max(gap.depth_m, FRAME_POST_M)
    for wall, sign in ((against, -1.0), (ahead, 1.0)):
        inner, outer = sign * min(0.5 * gap.width_m, wall - STANDING_OUT_M[0]), sign * (wall + INTO_WALL_M)
        posts.append(gap.piece(inner, outer, half))
    return posts


def with_wider_doors(floor: Polygon, drawn: Polygon, axes: tuple[float, ...], options: PlanOptions) -> Polygon:
    """`floor`, which is `drawn` with straight edges, with doorways of at least `DRIVEN_M` between its rooms."""
    if options.door_width_m[0] >= DRIVEN_M:
        return floor
    places = shapely.get_parts(drawn.buffer(-DRIVEN_M / 2.0))
    rooms = shapely.buffer(places, DRIVEN_M / 2.0)
    large = rooms[shapely.area(rooms) >= options.smallest_room_m2]
    narrow = options.model_copy(update={"door_width_m": (options.door_width_m[0], DRIVEN_M)})
    tree, walls = shapely.STRtree(large), Walls.around(drawn)
    gaps = [gap for gap in doorways(walls, axes, narrow) if _joins_two(gap, tree)]
    return largest_part(shapely.union_all([floor, *(_wider(gap, walls) for gap in gaps)]))


def _joins_two(gap: Gap, rooms: shapely.STRtree) -> bool:
    sides = [Point(gap.centre + side * (0.5 * gap.depth_m + ROOM_M) * gap.through) for side in (-1, 1)]
    before, behind = (set(rooms.query(point, predicate="within").tolist()) for point in sides)
    return bool(before and behind and not before & behind)


def _wider(gap: Gap, walls: Walls) -> Polygon:
    """The doorway with a width of `DRIVEN_M`, wider where the wall beside it goes on for longer."""
    against, ahead = post_lengths(gap.centre, gap.along, gap.width_m, walls)
    more = DRIVEN_M - gap.width_m + 0.01
    shares = (0.5, 0.5) if min(against, ahead) >= more else (float(against > ahead), float(ahead >= against))
    low, high = -0.5 * gap.width_m - shares[0] * more, 0.5 * gap.width_m + shares[1] * more
    return gap.piece(low, high, 0.5 * gap.depth_m + 0.02)
