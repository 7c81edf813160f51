"""The polygons of a scan: search among its corners, with beams as a guard against walls (III-A.2, derivations 1.5)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.mecp.cycles import best_cycles, visible_edges
from mecp_env.slam.mecp.edge_labels import Limits, View, edge_is_cut, edge_slack, write_intervals
from mecp_env.slam.messages import CornerKind

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LAZY_ATTEMPTS = 3
JAMB = int(CornerKind.JAMB)
MATCHABLE = 4  # a triangle is no evidence of a place (derivations 1.4)


@compiled
def polygons_of_scan(
    corners: tuple[Array, Array, Bools, Ints, Ints, Ints],
    beams: tuple[Array, Array, Bools],
    options: tuple[float, float, int, float, float, float, float],
    keep: int,
) -> tuple[Ints, Array, Ints]:
    """Corners (s,) and intervals (t,4) of all polygons, one after the other, and where each one's end (p,2).

    Given are z, cov, sites, kind and beyond of the corners and the jambs of their doorways, and the fields of `View`
    and of `Limits`. What is searched for, and where, is told in `find_polygons`.
    """
    z, cov, sites, kind, beyond, jambs = corners
    view, limits = View(*beams), Limits(*options)
    p_robot, sigmas = polar_to_points(z), position_sigmas(z, cov)
    sizes, rings = rings_among(p_robot, sigmas, sites, keep, (view, limits))
    if sizes[0] < MATCHABLE:
        more = np.empty(sites.shape[0], np.bool_)
        for k in range(more.shape[0]):
            more[k] = sites[k] or (kind[k] == JAMB and beyond[k] < 0)
        more_sizes, more_rings = rings_among(p_robot, sigmas, more, keep, (view, limits))
        if more_sizes[0] >= MATCHABLE or sizes[0] == 0:
            sizes, rings = more_sizes, more_rings
    doors = np.empty((jambs.shape[0], 2, 2))
    for gap in range(jambs.shape[0]):
        for side in range(2):
            doors[gap, side, 0], doors[gap, side, 1] = p_robot[jambs[gap, side], 0], p_robot[jambs[gap, side], 1]
    return with_intervals(sizes, rings, (p_robot, sigmas), doors, (view, limits))


@compiled
def rings_among(
    p_robot: Array, sigmas: Array, sites: Bools, keep: int, view_and_limits: tuple[View, Limits]
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
    sizes, rings = best_free_cycles(points, spread, keep, view_and_limits[0], view_and_limits[1])
    for place in range(keep):
        for i in range(sizes[place]):
            rings[place, i] = ids[rings[place, i]]
    return sizes, rings


@compiled
def with_intervals(
    sizes: Ints, rings: Ints, points_and_sigmas: tuple[Array, Array], doors: Array, view_and_limits: tuple[View, Limits]
) -> tuple[Ints, Array, Ints]:
    """The rings that are there one after the other, the intervals of their edges, and where each ring's end."""
    p_robot, sigmas = points_and_sigmas
    beams, most = view_and_limits[0].ranges.shape[0], rings.shape[0] * rings.shape[1]
    corners, rows = np.empty(most, np.int64), np.empty((rings.shape[0] * beams + 3 * most, 4))
    ends, polygons, corner, row = np.empty((rings.shape[0], 2), np.int64), 0, 0, 0
    for place in range(rings.shape[0]):
        size = sizes[place]
        if size == 0:
            continue
        ring, spread = np.empty((size, 2)), np.empty(size)
        for i in range(size):
            k = corners[corner + i] = rings[place, i]
            ring[i, 0], ring[i, 1], spread[i] = p_robot[k, 0], p_robot[k, 1], sigmas[k]
        corner += size
        row = write_intervals(rows, row, ring, spread, doors, view_and_limits)
        ends[polygons, 0], ends[polygons, 1] = corner, row
        polygons += 1
    return corners[:corner], rows[:row].copy(), ends[:polygons]


@compiled
def best_free_cycles(
    points: Array,
    sigmas: Array,
    keep: int,
    beams: tuple[Array, Array, Bools],
    options: tuple[float, float, int, float, float, float, float],
) -> tuple[Ints, Ints]:
    """`best_cycles` of the empty ones, none of whose edges is cut by a wall: the lazy guard of derivations 1.5.

    Solve, hold the edges of the result against the beams, forbid those that are cut, solve again. In a scan where that
    does not come to an end soon, all edges are tested. Points (n,2) are sorted as by `order_by_bearing`; the tolerance
    is `tolerance_sigmas` times the median of their sigmas (n,), m. `beams` and `options` are fields of View and Limits.
    """
    view, limits = View(*beams), Limits(*options)
    tolerance = limits.tolerance_sigmas * median(sigmas)
    allowed = visible_edges(points, tolerance)
    tested = np.zeros_like(allowed)
    attempt = 0
    while True:
        sizes, rings = best_cycles(points, allowed, tolerance, keep)
        doubtful = allowed if attempt == LAZY_ATTEMPTS else edges_of(sizes, rings)
        if not _forbid_cut_edges(points, sigmas, (allowed, tested, doubtful), view, limits):
            return sizes, rings
        attempt += 1


@compiled
def edges_of(sizes: Ints, rings: Ints) -> Bools:
    """The edges (n,n) of rings (keep,n)."""
    edges = np.zeros((rings.shape[1], rings.shape[1]), np.bool_)
    for place in range(sizes.shape[0]):
        for i in range(sizes[place]):
            edges[rings[place, i], rings[place, (i + 1) % sizes[place]]] = True
    return edges


@compiled
def _forbid_cut_edges(
    points: Array, sigmas: Array, edges: tuple[Bools, Bools, Bools], view: View, limits: Limits
) -> bool:
    """Forbids the doubtful edges that beams show to be cut, tests none twice, and says whether there was one."""
    allowed, tested, doubtful = edges
    found = False
    for a in range(points.shape[0]):
        for b in range(points.shape[0]):
            if doubtful[a, b] and not tested[a, b]:
                tested[a, b] = True
                slack = edge_slack(sigmas[a], sigmas[b], limits)
                allowed[a, b] = not edge_is_cut(points[a], points[b], slack, view, limits)
                found = found or not allowed[a, b]
    return found


@compiled
def position_sigmas(z: Array, cov: Array) -> Array:
    """Sigma (n,) of each corner's position, m: root mean square of its two axes."""
    sigmas = np.empty(z.shape[0])
    for i in range(z.shape[0]):
        sigmas[i] = math.sqrt(0.5 * (cov[2 * i, 2 * i] + z[i, 0] * z[i, 0] * cov[2 * i + 1, 2 * i + 1]))
    return sigmas


@compiled
def median(values: Array) -> float:
    """The (upper) median, 0 of nothing; plain insertion, as they are few."""
    rising = np.empty(values.shape[0])
    for i in range(values.shape[0]):
        j = i
        while j > 0 and rising[j - 1] > values[i]:
            rising[j] = rising[j - 1]
            j -= 1
        rising[j] = values[i]
    return 0.0 if values.shape[0] == 0 else float(rising[values.shape[0] // 2])
