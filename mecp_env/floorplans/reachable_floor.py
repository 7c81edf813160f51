"""The part of a plan's floor that a robot can reach, without specks and without rays through glass."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from mecp_env.core.errors import LayoutError
from mecp_env.world.outline import ROBOT_RADIUS_M

CLEARANCE_M = ROBOT_RADIUS_M + 0.02
NICHE_M = 0.4  # a niche too narrow for the robot stays when it is no deeper
SPECK_M2 = 0.02  # solids smaller than this are dirt


def reachable_floor(area: BaseGeometry) -> Polygon:
    """The part of `area` around the largest place that a robot can drive about in; no specks in it.

    Passages that are too narrow end where they begin. Raises LayoutError when nothing is wide enough.
    """
    inner = area.buffer(-CLEARANCE_M, quad_segs=2)
    if inner.is_empty:
        raise LayoutError(f"no floor is wide enough for a radius of {ROBOT_RADIUS_M} m")
    wide = largest_part(inner).buffer(CLEARANCE_M + 1e-3, quad_segs=2)
    floor = largest_part(area.difference(_deep_parts(area.difference(wide), wide).buffer(1e-6)))
    return Polygon(floor.exterior, [hole for hole in floor.interiors if Polygon(hole).area >= SPECK_M2])


def largest_part(area: BaseGeometry) -> Polygon:
    """The connected part of `area` with most of it, counter-clockwise."""
    return orient(max(shapely.get_parts(area), key=lambda part: part.area), 1.0)


def _deep_parts(rest: BaseGeometry, wide: BaseGeometry) -> BaseGeometry:
    """The parts of `rest` that reach further away from `wide` than a niche."""
    parts: NDArray[np.object_] = shapely.get_parts(rest)
    near = wide.buffer(NICHE_M, quad_segs=2)
    shapely.prepare(near)
    return shapely.union_all(parts[~shapely.covers(near, parts)])
