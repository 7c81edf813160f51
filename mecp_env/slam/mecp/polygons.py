"""Maximum Empty Convex Polygons: the polygon division of III-A.2."""

from __future__ import annotations

import numpy as np

from mecp_env.core.array_types import Bools
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.wall_crossing import polygons_of_scan
from mecp_env.slam.messages import CornerKind, Corners, MergedScan, Polygon


def find_polygons(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The Maximum Empty Convex Polygons of a scan: the one with most vertices, of equals the largest (III-A.2).

    Sites are `corners.sites`. If they give no polygon of four, the jambs of this side of the doors count too (a
    corridor between doors has little else), unless `config.sites` is "corners"; if even that gives none of four, a
    triangle of the first attempt comes back, or else of the second: good for free space, not for matching. Polygons
    with equally many vertices are rare and both of use: the `keep_ties` largest come back, the larger area first.

    The tolerance is `tolerance_sigmas` times the median sigma of the sites; where beams are compared with an edge,
    times the larger sigma of its two corners. Polygons that walls cross are ruled out (`check_walls`) by the beams: all
    of them, or those that end on a wall according to `wall` (B,) (`beams_on_walls`). The beams also cut each edge into
    intervals WALL, GAP and OPEN.

    Differs from the paper: strict turns with tolerance, area decides between equals, jambs only where the other corners
    are too few, the wall-crossing check (derivations 1).
    """
    return _polygons(corners, beams, config, wall, by_area=False)


def find_largest(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The empty convex polygon around the robot that covers most floor, however many vertices it has; one, or none.

    All else is as in `find_polygons`: sites, tolerance, jambs, the wall-crossing check, intervals. No two polygons of a
    scan have equal areas, so `keep_ties` means nothing here. Not in the paper, which leaves other structures to future
    work (VI).
    """
    return _polygons(corners, beams, config, wall, by_area=True)


def _polygons(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None, by_area: bool
) -> tuple[Polygon, ...]:
    kind = corners.kind if config.sites == "posts_too" else np.full_like(corners.kind, CornerKind.CROSSING)
    if wall is None or not config.check_walls:
        wall = np.full(len(beams.ranges), config.check_walls)
    ids, intervals, ends = polygons_of_scan(
        (corners.z, corners.cov, corners.sites, kind, corners.beyond, corners.doorways.jambs),
        (beams.ranges, beams.bearings, wall, beams.step),
        config.record,
        by_area,
    )
    found, at, row = [], 0, 0
    for end, last_row in ends.tolist():
        found.append(Polygon(ids[at:end], intervals[row:last_row]))
        at, row = end, last_row
    return tuple(found)
