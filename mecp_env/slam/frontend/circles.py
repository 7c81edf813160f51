"""Kernels that tell a round pillar from walls: its arc would be cut into short segments with corners that wander."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.split_and_merge import start_of, stretch_cost

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
WIDEST_M, LARGEST_RADIUS_M = 1.6, 0.8  # of a cluster that may be a pillar
PER_FREEDOM, SAVED = 4.0, 12.0  # chi-square that a parameter must save; that a circle must save over one line
ITERATIONS = 5
COST_CAP = 16.0


@compiled
def is_round(points: Array, sums: Array, first: int, ends: Ints, size: int) -> bool:
    """True when a circle in front of the robot explains the cluster better than its `size` straight stretches."""
    last = ends[size - 1]
    if last - first < 4 or is_wider(points, first, last, WIDEST_M):
        return False
    straight = 0.0
    for k in range(size):
        straight += stretch_cost(sums, start_of(first, ends, k), ends[k])
    bound = straight - SAVED if size == 1 else straight + PER_FREEDOM * (3 * size - 4)
    return bound > 0.0 and circle_cost(points, first, last) < bound


@compiled
def is_wider(points: Array, first: int, last: int, limit: float) -> bool:
    """True when the box around positions first to last has a diagonal longer than `limit` (m)."""
    x0, x1, y0, y1 = points[0, first], points[0, first], points[1, first], points[1, first]
    for i in range(first + 1, last + 1):
        x0, x1 = min(x0, points[0, i]), max(x1, points[0, i])
        y0, y1 = min(y0, points[1, i]), max(y1, points[1, i])
        if x1 - x0 > limit or y1 - y0 > limit:
            return True
    return math.hypot(x1 - x0, y1 - y0) > limit


@compiled
def circle_cost(points: Array, first: int, last: int) -> float:
    """Chi-square of the best circle whose near side is seen; inf when there is none of a pillar's size.

    Gauss-Newton on centre and radius; every beam counts by its variance along the radius.
    """
    mx, my = 0.5 * (points[0, first] + points[0, last]), 0.5 * (points[1, first] + points[1, last])
    radius = 0.5 * math.hypot(points[0, last] - points[0, first], points[1, last] - points[1, first])
    x, y, cost = mx, my, math.inf
    A, g = np.empty((3, 3)), np.empty(3)
    for _ in range(ITERATIONS):
        cost = normal_equations(points, (first, last), (x, y, radius), A, g)
        solve3(A, g)
        x, y, radius = x + g[0], y + g[1], radius + g[2]
        if not 0.0 < radius < LARGEST_RADIUS_M:
            return math.inf
    return cost if math.hypot(x, y) > math.hypot(mx, my) - 0.5 * radius else math.inf


@compiled
def normal_equations(
    points: Array, span: tuple[int, int], circle: tuple[float, float, float], A: Array, g: Array
) -> float:
    """Fills A and g of the step A d = g of (x, y, radius); returns the chi-square before it."""
    cost, row = 0.0, np.empty(3)
    for a in range(3):
        g[a] = A[a, 0] = A[a, 1] = A[a, 2] = 0.0
    for i in range(span[0], span[1] + 1):
        dx, dy = points[0, i] - circle[0], points[1, i] - circle[1]
        distance = math.hypot(dx, dy) + 1e-12
        steep = (dx * points[0, i] + dy * points[1, i]) ** 2 / (distance**2 * (points[0, i] ** 2 + points[1, i] ** 2))
        variance = points[2, i] * steep + points[3, i] * (1.0 - steep)
        residual = distance - circle[2]
        row[0], row[1], row[2] = dx / distance, dy / distance, 1.0
        cost += min(residual * residual / variance, COST_CAP)  # rays that graze the rim are far off at times
        for a in range(3):
            g[a] += row[a] * residual / variance
            for b in range(a + 1):
                A[a, b] += row[a] * row[b] / variance
    A[0, 1], A[0, 2], A[1, 2] = A[1, 0], A[2, 0], A[2, 1]
    return cost


@compiled
def solve3(A: Array, g: Array) -> None:
    """Replaces g (3,) by d of (A + a little) d = g for a symmetric positive A (3,3), which is spoilt: elimination."""
    for k in range(3):
        A[k, k] *= 1.0 + 1e-6
    for k in range(3):
        for i in range(k + 1, 3):
            share = A[i, k] / A[k, k]
            g[i] -= share * g[k]
            for j in range(k, 3):
                A[i, j] -= share * A[k, j]
    for k in range(2, -1, -1):
        for j in range(k + 1, 3):
            g[k] -= A[k, j] * g[j]
        g[k] /= A[k, k]
