"""Islands in the floor as pieces of furniture: round pillars and boxes instead of outlines of pixels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon

from mecp_env.floorplans.door_detection import is_furniture

ROUND = 0.93  # 4 pi area / perimeter^2: 0.79 for a square, 0.95 for an octagon
HULL = 0.9  # of its convex hull a pillar fills
FULL = 0.9  # of the rectangle around it a box fills
SEEN_M = 5.0  # times the noise: a smaller pillar looks like a box
SAME = 0.8  # share of overlap of what is drawn with what was read


def fitted(hole: Polygon, read: list[Polygon], noise_m: float) -> dict[str, Any] | None:
    """The obstacle of an island in the floor as drawn, by its outline as `read`; None where it is neither."""
    if not is_furniture(hole):
        return None
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
