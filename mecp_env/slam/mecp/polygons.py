"""Maximum Empty Convex Polygons: the polygon division of III-A.2.

The polygons of a scan: search among its corners, without edges that a wall crosses (III-A.2, derivations 1.5).
"""

from __future__ import annotations

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.cycles import best_cycles, largest_cycle, visible_edges
from mecp_env.slam.mecp.edge_labels import EdgeBeams, edge_between, edge_is_cut, write_intervals
from mecp_env.slam.messages import CornerKind, Corners, MergedScan, Polygon

LAZY_ATTEMPTS = 2
MATCHABLE = 4  # a triangle is no evidence of a place (derivations 1.4)


@compiled
def polygons_of_scan(
    corners: tuple[Array, Array, Bools, Ints, Ints, Ints],
    beams: tuple[Array, Array, Bools, float],
    config: Rows,
    by_area: bool,
) -> tuple[Ints, Array, Ints]:
    """Corners (s,) and intervals (t,4) of all polygons, one after the other, and where each one's end (p,2).

    `corners` are z, cov, sites, kind and beyond, and the jambs of the doorways; `beams` the fields of `EdgeBeams`. What
    is searched for, and where, is described in `find_polygons`, and in `find_largest` where it goes `by_area`.
    """
    (z, cov, sites, kind, beyond, jambs), limits = corners, config[0]
    scan, p_robot, variance = EdgeBeams(*beams), polar_to_points(z), np.diag(cov)
    sigmas = np.sqrt(0.5 * (variance[::2] + z[:, 0] * z[:, 0] * variance[1::2]))  # root mean square of the two axes
    sizes, rings = rings_among(p_robot, sigmas, sites, scan, limits, by_area)
    if sizes[0] < MATCHABLE:
        more = np.empty(sites.shape[0], np.bool_)
        for k in range(more.shape[0]):
            more[k] = sites[k] or (kind[k] == CornerKind.JAMB and beyond[k] < 0)
        more_sizes, more_rings = rings_among(p_robot, sigmas, more, scan, limits, by_area)
        if more_sizes[0] >= MATCHABLE or sizes[0] == 0:
            sizes, rings = more_sizes, more_rings
    doors = np.empty((jambs.shape[0], 2, 2))
    for gap in range(jambs.shape[0]):
        for side in range(2):
            doors[gap, side, 0], doors[gap, side, 1] = p_robot[jambs[gap, side], 0], p_robot[jambs[gap, side], 1]
    most = rings.shape[0] * rings.shape[1]
    found, rows = np.empty(most, np.int64), np.empty((rings.shape[0] * scan.ranges.shape[0] + 3 * most, 4))
    ends, polygons, corner, row = np.empty((rings.shape[0], 2), np.int64), 0, 0, 0
    for place in range(rings.shape[0]):
        size = sizes[place]
        if size == 0:
            continue
        ring, spread = np.empty((size, 2)), np.empty(size)
        for i in range(size):
            k = found[corner + i] = rings[place, i]
            ring[i, 0], ring[i, 1], spread[i] = p_robot[k, 0], p_robot[k, 1], sigmas[k]
        corner += size
        row = write_intervals(rows, row, ring, spread, doors, scan, limits)
        ends[polygons, 0], ends[polygons, 1] = corner, row
        polygons += 1
    return found[:corner], rows[:row].copy(), ends[:polygons]


@compiled
def rings_among(
    p_robot: Array, sigmas: Array, sites: Bools, beams: EdgeBeams, limits: Record, by_area: bool
) -> tuple[Ints, Ints]:
    """Sizes (keep,) and rings (keep,s) of the best polygons of the corners that are sites, each from the smallest."""
    ids, n = np.empty(sites.shape[0], np.int64), 0
    for k in range(sites.shape[0]):
        if sites[k]:
            ids[n] = k
            n += 1
    points, spread = np.empty((n, 2)), np.empty(n)
    for i in range(n):
        points[i, 0], points[i, 1], spread[i] = p_robot[ids[i], 0], p_robot[ids[i], 1], sigmas[ids[i]]
    sizes, rings = best_free_cycles(points, spread, beams, limits, by_area)
    for place in range(rings.shape[0]):
        for i in range(sizes[place]):
            rings[place, i] = ids[rings[place, i]]
    return sizes, rings


@compiled
def best_free_cycles(
    points: Array, sigmas: Array, beams: EdgeBeams, limits: Record, by_area: bool
) -> tuple[Ints, Ints]:
    """`best_cycles` or, `by_area`, `largest_cycle`, without edges that a wall crosses.

    The lazy check of derivations 1.5: solve, compare the edges of the result with the beams, forbid those that are cut,
    solve again. In a scan where that does not come to an end soon, all edges are tested. Points (n,2) are sorted as by
    `order_by_bearing`; the tolerance is `tolerance_sigmas` times the (upper) median of their sigmas (n,), m.
    """
    n, attempt, cut, median = points.shape[0], 0, True, 0.0
    for sigma in sigmas:  # `np.sort` would take a second to compile
        smaller, least = 0, 0
        for other in sigmas:
            smaller, least = smaller + (other < sigma), least + (other <= sigma)
        median = sigma if smaller <= n // 2 < least else median
    tolerance = limits.tolerance_sigmas * median
    allowed, tested, doubtful = visible_edges(points, tolerance), np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
    sizes, rings = np.empty(0, np.int64), np.empty((0, n), np.int64)
    while cut:
        if by_area:
            sizes, rings = largest_cycle(points, allowed, tolerance)
        else:
            sizes, rings = best_cycles(points, allowed, tolerance, limits.keep_ties)
        for place in range(sizes.shape[0]):
            for i in range(sizes[place]):
                doubtful[rings[place, i], rings[place, (i + 1) % sizes[place]]] = True
        cut = False
        for pair in range(n * n):
            a, b = pair // n, pair % n
            if not (allowed[a, b] and not tested[a, b] and (doubtful[a, b] or attempt == LAZY_ATTEMPTS)):
                continue
            edge = edge_between(points[a], points[b], max(sigmas[a], sigmas[b]), beams, limits)
            tested[a, b], allowed[a, b] = True, not edge_is_cut(edge, beams, limits)
            cut = cut or not allowed[a, b]
        attempt += 1
    return sizes, rings


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
