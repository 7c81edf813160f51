"""Compiled functions for circle (pillar) detection: an arc would be cut into short segments with wandering corners."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import solve3
from mecp_env.slam.frontend.beams import Noise, Record
from mecp_env.slam.frontend.split_and_merge import line_cost

ITERATIONS = 5


@compiled
def is_circle(points: Array, sums: Array, breaks: Ints, size: int, limits: Record, noise: Noise) -> bool:
    """True when a circle in front of the robot explains the cluster better than its `size` lines."""
    first, last, widest = breaks[0] + 1, breaks[size], 2.0 * limits.pillar_radius_m
    if last - first < 4:
        return False
    x0, x1, y0, y1 = points[0, first], points[0, first], points[1, first], points[1, first]
    for i in range(first + 1, last + 1):
        x0, x1 = min(x0, points[0, i]), max(x1, points[0, i])
        y0, y1 = min(y0, points[1, i]), max(y1, points[1, i])
        if x1 - x0 > widest or y1 - y0 > widest:
            return False
    if math.hypot(x1 - x0, y1 - y0) > widest:
        return False
    straight = 0.0
    for k in range(size):
        straight += line_cost(sums, breaks[k] + 1, breaks[k + 1])
    gain = limits.parameter_gain  # a line has two parameters and an end, a circle three: it must beat a single line
    bound = straight - gain if size == 1 else straight + gain * (3 * size - 4)
    return bool(bound > 0.0 and circle_cost(points, first, last, limits.pillar_radius_m, noise.outlier) < bound)


@compiled
def circle_cost(points: Array, first: int, last: int, largest: float, outlier: float) -> float:
    """Chi-square of the best circle whose near side is seen; inf when its radius is `largest` or more.

    Gauss-Newton on centre and radius; every beam counts by its variance along the radius, with at most `outlier`
    standard deviations: rays that graze the rim are sometimes far off.
    """
    mx, my = 0.5 * (points[0, first] + points[0, last]), 0.5 * (points[1, first] + points[1, last])
    radius = 0.5 * math.hypot(points[0, last] - points[0, first], points[1, last] - points[1, first])
    x, y, cost = mx, my, math.inf
    A, g = np.empty((3, 3)), np.empty(3)
    for _ in range(ITERATIONS):
        cost = 0.0
        for a in range(3):
            g[a] = A[a, 0] = A[a, 1] = A[a, 2] = 0.0
        for i in range(first, last + 1):
            dx, dy = points[0, i] - x, points[1, i] - y
            distance, r2 = math.sqrt(dx * dx + dy * dy) + 1e-12, points[0, i] ** 2 + points[1, i] ** 2
            steep = (dx * points[0, i] + dy * points[1, i]) ** 2 / (distance * distance * r2)
            weight = 1.0 / (points[2, i] * steep + points[3, i] * (1.0 - steep))
            residual = distance - radius
            cost += min(residual * residual * weight, outlier * outlier)
            u, v = dx / distance, dy / distance
            g[0], g[1], g[2] = g[0] + weight * u * residual, g[1] + weight * v * residual, g[2] + weight * residual
            A[0, 0], A[1, 0], A[2, 0] = A[0, 0] + weight * u * u, A[1, 0] + weight * u * v, A[2, 0] + weight * u
            A[1, 1], A[2, 1], A[2, 2] = A[1, 1] + weight * v * v, A[2, 1] + weight * v, A[2, 2] + weight
        A[0, 1], A[0, 2], A[1, 2] = A[1, 0], A[2, 0], A[2, 1]
        solve3(A, g)
        x, y, radius = x + g[0], y + g[1], radius + g[2]
        if not 0.0 < radius < largest:
            return math.inf
    return cost if math.hypot(x, y) > math.hypot(mx, my) - 0.5 * radius else math.inf
