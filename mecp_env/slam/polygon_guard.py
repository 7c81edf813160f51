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
def best_free_cycles(
    points: Array, slack: Array, tolerance: float, keep: int, view: View, limits: Limits
) -> tuple[Ints, Ints]:
    """`best_cycles` of the empty ones, none of whose edges is cut by a wall: the lazy guard of maths 1.6.

    Solve, hold the edges of the result against the beams, forbid those that are cut, solve again. In a scan where that
    does not come to an end soon, all edges are tested. `slack` (n,) is how far off each point may be, m.
    """
    allowed = visible_edges(points, tolerance)
    tested = np.zeros_like(allowed)
    attempt = 0
    while True:
        sizes, rings = best_cycles(points, allowed, tolerance, keep)
        doubtful = allowed if attempt == LAZY_ATTEMPTS else edges_of(sizes, rings)
        if not _forbid_cut_edges(points, slack, (allowed, tested, doubtful), view, limits):
            return sizes, rings
        attempt += 1


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
    points: Array, slack: Array, edges: tuple[Bools, Bools, Bools], view: View, limits: Limits
) -> bool:
    """Forbids the doubtful edges that beams show to be cut, tests none twice, and says whether there was one."""
    allowed, tested, doubtful = edges
    found = False
    for a in range(points.shape[0]):
        for b in range(points.shape[0]):
            if doubtful[a, b] and not tested[a, b]:
                tested[a, b] = True
                allowed[a, b] = not edge_is_cut(points[a], points[b], max(slack[a], slack[b]), view, limits)
                found = found or not allowed[a, b]
    return found


@kernel
def position_sigmas(z: Array, cov: Array) -> Array:
    """Sigma (n,) of each corner's position, m: root mean square of its two axes."""
    sigmas = np.empty(z.shape[0])
    for i in range(z.shape[0]):
        sigmas[i] = math.sqrt(0.5 * (cov[2 * i, 2 * i] + z[i, 0] * z[i, 0] * cov[2 * i + 1, 2 * i + 1]))
    return sigmas


@kernel
def median(values: Array) -> float:
    """The (upper) median, 0 of nothing."""
    return 0.0 if values.shape[0] == 0 else float(np.sort(values)[values.shape[0] // 2])


@kernel
def _rings_of(
    p_robot: Array, sigmas: Array, sites: Bools, keep: int, view: View, limits: Limits
) -> tuple[Ints, Ints, Array]:
    """Sizes and rings of corners with these sites, and how far off each corner may be, m.

    That is `tolerance_sigmas` of its own sigma or of the sites' median, whichever is more, but no more than what counts
    as open. The median alone is the tolerance of the search.
    """
    ids = np.flatnonzero(sites)
    tolerance = limits.tolerance_sigmas * median(sigmas[ids])
    slack = np.empty_like(sigmas)
    for i in range(sigmas.shape[0]):
        slack[i] = min(max(limits.tolerance_sigmas * sigmas[i], tolerance), limits.open_depth_m)
    sizes, rings = best_free_cycles(p_robot[ids], slack[ids], tolerance, keep, view, limits)
    for place in range(keep):
        for i in range(sizes[place]):
            rings[place, i] = ids[rings[place, i]]
    return sizes, rings, slack


@kernel
def find_rings(features: Features, keep: int, view: View, limits: Limits) -> tuple[Ints, Ints, Array, Array]:
    """Sizes (keep,) and rings (keep,n) of corners for `polygon.find_polygons`; points (n,2) and their slack (n,), m."""
    p_robot, sigmas = polar_to_points(features.z), position_sigmas(features.z, features.cov)
    sizes, rings, slack = _rings_of(p_robot, sigmas, features.sites, keep, view, limits)
    if sizes[0] < MATCHABLE:
        more = features.sites | ((features.kind == JAMB) & (features.beyond < 0))
        again, other, wider = _rings_of(p_robot, sigmas, more, keep, view, limits)
        if again[0] >= MATCHABLE or sizes[0] == 0:
            return again, other, p_robot, wider
    return sizes, rings, p_robot, slack
