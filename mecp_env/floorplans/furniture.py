"""Islands in the floor as pieces of furniture: round pillars and boxes instead of outlines of pixels."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from mecp_env.core.carriers import Array

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
