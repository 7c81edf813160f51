"""The polygons of one scan: search among its corners, with beams as a guard against walls (III-A.2, maths 1.6)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.polygon_edges import Limits, View, edge_is_cut, edge_slack
from mecp_env.slam.polygon_kernels import best_cycles, visible_edges

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LAZY_ATTEMPTS = 3


@kernel
def best_free_cycles(points: Array, sigmas: Array, keep: int, view: View, limits: Limits) -> tuple[Ints, Ints]:
    """`best_cycles` of the empty ones, none of whose edges is cut by a wall: the lazy guard of maths 1.6.

    Solve, hold the edges of the result against the beams, forbid those that are cut, solve again. In a scan where that
    does not come to an end soon, all edges are tested. Points (n,2) are sorted as by `order_by_bearing`; the tolerance
    is `tolerance_sigmas` times the median of their sigmas (n,), m.
    """
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


@kernel
def position_sigmas(z: Array, cov: Array) -> Array:
    """Sigma (n,) of each corner's position, m: root mean square of its two axes."""
    sigmas = np.empty(z.shape[0])
    for i in range(z.shape[0]):
        sigmas[i] = math.sqrt(0.5 * (cov[2 * i, 2 * i] + z[i, 0] * z[i, 0] * cov[2 * i + 1, 2 * i + 1]))
    return sigmas


@kernel
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
