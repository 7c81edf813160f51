"""The floor of a plan: the part that a robot can reach, without specks and without rays through glass.

Islands in it are walls, or pieces of furniture: round pillars and boxes instead of outlines of pixels.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.options import PlanOptions
from mecp_env.world.outline import ROBOT_RADIUS_M

CLEARANCE_M = ROBOT_RADIUS_M + 0.02
BESIDE_M = 3.0 * CLEARANCE_M  # what is further away from a place does not bound it
NICHE_M = 0.4  # a niche too narrow for the robot stays when it is no deeper
SHALLOW = 0.9  # a part smaller than this share of a depth reaches no deeper, wherever its mouth is
FINE_M = 2e-3  # details smaller than this come from rounding
ON_EDGE_M = 1e-6  # the middle of an edge this close to a line is on it
SPECK_M2 = 0.02  # solids smaller than this are dirt
FURNITURE_M = (0.2, 2.0)  # an island at least so wide and at most so long is a piece of furniture, not a wall,
PILLAR_M = 0.45  # and so is a smaller one of any shape
FURNITURE_FILL = 0.55  # when it fills so much of the rectangle around it,
DOORWAY_M = (0.3, 2.0)  # unless it is so far from the end of a wall, at most so thick, whose faces are in line with
THICKEST_M, IN_LINE_M, IN_LINE = 0.8, 0.12, 0.25  # its own, within so much and such a share of its thickness
ROUND = 0.93  # 4 pi area / perimeter^2: 0.79 for a square, 0.95 for an octagon
HULL = 0.9  # of its convex hull a pillar fills
FULL = 0.9  # of the rectangle around it a box fills
SEEN_M = 5.0  # times the noise: a smaller pillar looks like a box
SAME = 0.8  # share of overlap of what is drawn with what was read


def without_hollows(area: BaseGeometry) -> Polygon:
    """`area` without what only slits too narrow for the robot lead to, as the hollows of double walls."""
    return largest_part(_closed(area, CLEARANCE_M, _inner(area, CLEARANCE_M), NICHE_M))


def reachable_floor(area: BaseGeometry) -> Polygon:
    """The part of `area` around the largest place that a robot can drive about in; no specks in it.

    Passages that are too narrow end where they begin. Raises LayoutError when nothing is wide enough.
    """
    floor = largest_part(_closed(area, CLEARANCE_M, largest_part(_inner(area, CLEARANCE_M)), NICHE_M))
    return Polygon(floor.exterior, [hole for hole in floor.interiors if Polygon(hole).area >= SPECK_M2])


def left_out(floor: Polygon, area: Polygon, options: PlanOptions) -> str:
    """Which places of a `floor`, as large as a room, are not part of the building's `area`, in words; or nothing."""
    near = _around_large_parts(floor.difference(area), options.smallest_room_m2)
    inner = floor.intersection(near).buffer(-CLEARANCE_M, quad_segs=4).difference(area)
    places = shapely.buffer(shapely.get_parts(inner), CLEARANCE_M)
    sizes = shapely.area(places)[shapely.area(places) >= options.smallest_room_m2]
    if not len(sizes):
        return ""
    return f"Places that no wide enough doorway leads to: {len(sizes)}, of {sizes.sum():.1f} m2 in all."


def _around_large_parts(rest: BaseGeometry, least_m2: float) -> BaseGeometry:
    """Boxes around those parts of `rest` that may be a place of at least so much: the others are edges of pixels.

    They are so wide that a place in a part is the same whether the floor ends at its box or not.
    """
    left, bottom, right, top = shapely.bounds(shapely.get_parts(rest)).T
    large = (right - left + 2.0 * CLEARANCE_M) * (top - bottom + 2.0 * CLEARANCE_M) >= least_m2
    corners = [left - BESIDE_M, bottom - BESIDE_M, right + BESIDE_M, top + BESIDE_M]
    return shapely.union_all(shapely.box(*(corner[large] for corner in corners)))


def _inner(area: BaseGeometry, radius: float) -> BaseGeometry:
    """Where in `area` the centre of a circle may be."""
    inner = area.buffer(-radius, quad_segs=4)
    if inner.is_empty:
        raise LayoutError(
            f"no floor is wide enough for a radius of {ROBOT_RADIUS_M} m; check the scale, and that floor is bright, "
            "on dark walls"
        )
    return inner


def largest_part(area: BaseGeometry) -> Polygon:
    """The connected part of `area` with most of it, counter-clockwise."""
    return orient(max(shapely.get_parts(area), key=lambda part: part.area), 1.0)


def _closed(area: BaseGeometry, radius: float, inner: BaseGeometry, depth: float) -> BaseGeometry:
    """`area` without the parts that circles with centres in `inner` do not cover, where those are deep."""
    wide = inner.buffer(radius + 0.5 * FINE_M, quad_segs=4)
    return area.difference(_deep_parts(area.difference(wide), wide, depth).buffer(1e-6)).simplify(FINE_M)


def _deep_parts(rest: BaseGeometry, wide: BaseGeometry, depth: float) -> BaseGeometry:
    """The parts of `rest` that reach further than `depth` from their mouths, each up to the line across its mouth."""
    parts = shapely.get_parts(rest)
    mouths = _mouths(parts, wide)
    left, bottom, right, top = shapely.bounds(parts).T
    deep = (np.hypot(right - left, top - bottom) > SHALLOW * depth) | shapely.is_empty(mouths)
    deep[deep] = ~shapely.covers(shapely.buffer(mouths[deep], depth), parts[deep])
    arcs = shapely.get_parts(shapely.line_merge(mouths[deep]))
    arcs = arcs[shapely.get_num_coordinates(arcs) > 3]
    fronts = [Polygon(arc.coords) for arc in arcs]
    return shapely.union_all([*parts[deep], *(shapely.make_valid(front).buffer(0.5 * FINE_M) for front in fronts)])


def _mouths(parts: NDArray[np.object_], wide: BaseGeometry) -> NDArray[np.object_]:
    """Where each of `parts` ends at `wide`: lines, empty for a part that does not touch it."""
    edges, part = edges_of(parts)
    tree = shapely.STRtree(shapely.linestrings(edges_of(shapely.get_parts(wide))[0]))
    touching = np.unique(tree.query(shapely.points(edges.mean(axis=1)), "dwithin", ON_EDGE_M)[0])
    mouths = np.full(len(parts), shapely.MultiLineString(), dtype=np.object_)
    shapely.multilinestrings(shapely.linestrings(edges[touching]), indices=part[touching], out=mouths)
    return mouths


def edges_of(parts: NDArray[np.object_]) -> tuple[Array, Ints]:
    """The edges (n,2,2) of polygons, and the index (n,) of the polygon that each belongs to."""
    rings, part = shapely.get_rings(parts, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    within = ring[1:] == ring[:-1]
    return np.stack([points[:-1], points[1:]], axis=1)[within], part[ring[1:][within]]


def without_furniture(area: Polygon) -> Polygon:
    """`area` without free-standing furniture."""
    return Polygon(area.exterior, [hole for hole, wall in zip(area.interiors, are_walls(area), strict=True) if wall])


def are_walls(area: Polygon) -> list[bool]:
    """Which islands in `area` are walls: those that are no furniture, and those in line with the end of a wall."""
    islands = np.array([Polygon(hole) for hole in area.interiors], dtype=np.object_)
    walls = np.array([not is_furniture(island) for island in islands], dtype=np.bool_)
    while True:
        ends = _ends_of_walls(Polygon(area.exterior, [island.exterior for island in islands[walls]]))
        more = [i for i in np.flatnonzero(~walls) if _is_in_line(islands[i], ends)]
        if not more:
            return [bool(wall) for wall in walls]
        walls[more] = True


def _ends_of_walls(area: Polygon) -> Array:
    """Faces (n,2,2) of `area`, the floor on their left, with a convex corner of the walls at either end."""
    ends = []
    for ring in (area.exterior, *area.interiors):
        points = np.array(ring.coords)
        (x, y), (next_x, next_y) = (np.diff(points, axis=0).T, np.roll(np.diff(points, axis=0), -1, axis=0).T)
        convex = x * next_y < y * next_x
        ends.append(np.stack([points[:-1], points[1:]], axis=1)[convex & np.roll(convex, 1)])
    return np.concatenate(ends)


def _is_in_line(island: Polygon, ends: Array) -> bool:
    """Whether a face of `island` is opposite one of `ends` (n,2,2) of the same width, a doorway away."""
    for start, end in pairwise(np.array(orient(island, -1.0).exterior.coords)):
        width = math.dist(start, end)
        along = (end - start) / max(width, 1e-9)
        across, beside = (ends - start) @ (-along[1], along[0]), (ends - start) @ along
        away = np.abs(across - sum(DOORWAY_M) / 2.0).max(axis=1) < (DOORWAY_M[1] - DOORWAY_M[0]) / 2.0
        same = np.abs(np.sort(beside, axis=1) - (0.0, width)).max(axis=1) < min(IN_LINE_M, IN_LINE * width)
        square = np.ptp(across, axis=1) < IN_LINE_M
        if FURNITURE_M[0] <= width <= THICKEST_M and bool(np.any(away & same & square)):
            return True
    return False


def is_furniture(island: Polygon) -> bool:
    """True when an island in the floor is furniture, not a wall."""
    around = np.array(shapely.minimum_rotated_rectangle(island).exterior.coords)
    sides = np.hypot(*np.diff(around, axis=0).T)
    full = island.area >= FURNITURE_FILL * sides[0] * sides[1] and sides.min() >= FURNITURE_M[0]
    return bool(sides.max() <= PILLAR_M or (full and sides.max() <= FURNITURE_M[1]))


def fitted(hole: Polygon, read: list[Polygon], noise_m: float) -> dict[str, Any] | None:
    """The obstacle of a piece of furniture as drawn, by its outline as `read`; None where it is neither."""
    first = max(read, key=lambda island: island.intersection(hole).area, default=hole)
    piece, shape = _pillar(first, noise_m) or _box(first) or (None, hole)
    overlap = shape.intersection(hole).area / shape.union(hole).area
    return piece if overlap >= SAME else None


def _pillar(island: Polygon, noise_m: float) -> tuple[dict[str, Any], Polygon] | None:
    hull = island.convex_hull
    roundness = 4.0 * math.pi * hull.area / hull.length**2
    radius = math.sqrt(island.area / math.pi)
    if roundness < ROUND or island.area < HULL * hull.area or 2.0 * radius < SEEN_M * noise_m:
        return None
    centre = island.centroid
    return {"kind": "round", "centre": (centre.x, centre.y), "radius_m": radius}, centre.buffer(radius)


def _box(island: Polygon) -> tuple[dict[str, Any], Polygon] | None:
    around = shapely.minimum_rotated_rectangle(island)
    if island.area < FULL * around.area:
        return None
    a, b, c = np.array(around.exterior.coords)[:3]
    turn = math.degrees(math.atan2(b[1] - a[1], b[0] - a[0]))
    share = math.sqrt(island.area / around.area)  # pixels stick out at the corners of a turned box
    size = (share * math.dist(a, b), share * math.dist(b, c))
    centre = (float((a[0] + c[0]) / 2.0), float((a[1] + c[1]) / 2.0))
    return {"kind": "box", "centre": centre, "size": size, "turn_deg": turn}, around
