"""The polygons of one scan: search among its corners, with beams as a guard against walls (III-A.2, maths 1.6)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.data import CornerKind
from mecp_env.slam.geometry import polar_to_points
from mecp_env.slam.polygon_edges import Limits, View, edge_is_cut
from mecp_env.slam.polygon_kernels import best_cycles, visible_edges

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

MATCHABLE = 4  # a triangle is no evidence of a place (maths 1.5)
LAZY_ATTEMPTS = 3
JAMB = int(CornerKind.JAMB)


class Features(NamedTuple):
    """What the search reads of `Corners`."""

    z: Array  # (n,2) m, rad, in order of bearing
    cov: Array  # (2n,2n)
    sites: Bools  # (n,)
    kind: Ints  # (n,)
    beyond: Ints  # (n,)


@kernel
def best_free_cycles(points: Array, tolerance: float, keep: int, view: View, limits: Limits) -> tuple[Ints, Ints]:
    """`best_cycles` of the empty ones, none of whose edges is cut by a wall: the lazy guard of maths 1.6.

    Solve, hold the edges of the result against the beams, forbid those that are cut, solve again. In a scan where that
    does not come to an end soon, all edges are tested.
    """
    allowed = visible_edges(points, tolerance)
    tested = np.zeros_like(allowed)
    for attempt in range(points.shape[0] * points.shape[0]):
        sizes, rings = best_cycles(points, allowed, tolerance, keep)
        doubtful = allowed if attempt == LAZY_ATTEMPTS else edges_of(sizes, rings)
        if not _forbid_cut_edges(points, allowed, tested, doubtful, (tolerance, view, limits)):
            break
    return sizes, rings


@kernel
def edges_of(sizes: Ints, rings: Ints) -> Bools:
    """The edges (n,n) of rings (keep,n)."""
    edges = np.zeros((rings.shape[1], rings.shape[1]), np.bool_)
    for place in range(sizes.shape[0]):
        for i in range(sizes[place]):
            edges[rings[place, i], rings[place, (i + 1) % sizes[place]]] = True
    return edges


@kernel
def _forbid_cut_edges(
    points: Array, allowed: Bools, tested: Bools, doubtful: Bools, sight: tuple[float, View, Limits]
) -> bool:
    """Forbids the doubtful edges that beams show to be cut, tests none twice, and says whether there was one."""
    tolerance, view, limits = sight
    found = False
    for a in range(points.shape[0]):
        for b in range(points.shape[0]):
            if doubtful[a, b] and not tested[a, b]:
                tested[a, b] = True
                allowed[a, b] = not edge_is_cut(points[a], points[b], tolerance, view, limits)
                found = found or not allowed[a, b]
    return found


@kernel
def median_sigma(z: Array, cov: Array, ids: Ints) -> float:
    """Median over `ids` of the sigma of a corner's position, m: root mean square of its two axes; 0 without corners."""
    sigma = np.empty(ids.shape[0])
    for i in range(ids.shape[0]):
        c = ids[i]
        value = math.sqrt(0.5 * (cov[2 * c, 2 * c] + z[c, 0] * z[c, 0] * cov[2 * c + 1, 2 * c + 1]))
        j = i
        while j > 0 and sigma[j - 1] > value:
            sigma[j] = sigma[j - 1]
            j -= 1
        sigma[j] = value
    return 0.0 if ids.shape[0] == 0 else sigma[ids.shape[0] // 2]


@kernel
def _rings_of(
    features: Features, p_robot: Array, sites: Bools, view: View, limits: Limits, keep: int
) -> tuple[Ints, Ints, float]:
    """Sizes and rings of corners with these sites, and the tolerance that went with them, m."""
    ids = np.flatnonzero(sites)
    tolerance = limits.tolerance_sigmas * median_sigma(features.z, features.cov, ids)
    points = np.empty((ids.shape[0], 2))
    for i in range(ids.shape[0]):
        points[i, 0], points[i, 1] = p_robot[ids[i], 0], p_robot[ids[i], 1]
    sizes, rings = best_free_cycles(points, tolerance, keep, view, limits)
    for place in range(keep):
        for i in range(sizes[place]):
            rings[place, i] = ids[rings[place, i]]
    return sizes, rings, tolerance


@kernel
def find_rings(features: Features, view: View, limits: Limits, keep: int) -> tuple[Ints, Ints, Array, float]:
    """Sizes (keep,) and rings (keep,n) of corners for `polygon.find_polygons`; points (n,2); the tolerance used, m."""
    p_robot = polar_to_points(features.z)
    sizes, rings, tolerance = _rings_of(features, p_robot, features.sites, view, limits, keep)
    if sizes[0] < MATCHABLE:
        more = features.sites | ((features.kind == JAMB) & (features.beyond < 0))
        again, other, wider = _rings_of(features, p_robot, more, view, limits, keep)
        if again[0] >= MATCHABLE or sizes[0] == 0:
            return again, other, p_robot, wider
    return sizes, rings, p_robot, tolerance
