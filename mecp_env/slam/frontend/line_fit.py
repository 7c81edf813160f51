"""Kernels for the maximum-likelihood line (alpha, rho) through averaged beams, with its covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.split_and_merge import scatter, stretch_cost

Array = NDArray[np.float64]
ITERATIONS = 2
FACE_BEAMS, FACE_SAVES = 8, 6.0  # beams of an end face at most; chi-square that leaving them out must save
OUTLIER2 = 16.0  # squared sigmas beyond which a beam loses weight
STEEPEST = 0.035  # cosine of the largest incidence (88 degrees) for which a ray still meets its line


@compiled
def rough_line(sums: Array, first: int, last: int) -> tuple[float, float]:
    """alpha and rho (>= 0) of the total-least-squares line through positions first to last."""
    n = last - first + 1
    sxx, sxy, syy = scatter(sums, first, last)
    alpha = 0.5 * math.atan2(2.0 * sxy, sxx - syy) + 0.5 * math.pi
    x, y = (sums[last + 1, 0] - sums[first, 0]) / n, (sums[last + 1, 1] - sums[first, 1]) / n
    rho = x * math.cos(alpha) + y * math.sin(alpha)
    return (alpha, rho) if rho >= 0.0 else (alpha + math.pi, -rho)


@compiled
def without_end_face(points: Array, sums: Array, span: tuple[int, int], min_beams: int) -> tuple[int, int]:
    """First and last position of the wall itself, where beams of its end face, at a right angle, are taken for it.

    Seen along the wall, the face at its near end lies within the noise; its few beams turn the line.
    """
    first, last = span
    alpha, _ = rough_line(sums, first, last)
    begins, ends = -along_wall(points, first, alpha), along_wall(points, last, alpha)
    if begins >= 0.0 and ends >= 0.0:
        return first, last  # the robot stands before the wall: its end faces are turned away
    best, best_cost = span, stretch_cost(sums, first, last) - FACE_SAVES
    most = min(FACE_BEAMS, last - first + 1 - min_beams)
    kept = (first + most, last) if begins < 0.0 else (first, last - most)
    if stretch_cost(sums, kept[0], kept[1]) >= best_cost:
        return first, last
    for dropped in range(1, most + 1):
        low, high = (first + dropped, last) if begins < 0.0 else (first, last - dropped)
        face = (first, low - 1) if begins < 0.0 else (high + 1, last)
        cost = stretch_cost(sums, low, high)
        if cost < best_cost:
            cost += face_spread(points, face, rough_line(sums, low, high)[0])
        if cost < best_cost:
            best, best_cost = (low, high), cost
    return best


@compiled
def along_wall(points: Array, i: int, alpha: float) -> float:
    """Coordinate (m) of point i along a wall with normal alpha, from the foot of the perpendicular on."""
    return float(points[1, i] * math.cos(alpha) - points[0, i] * math.sin(alpha))


@compiled
def face_spread(points: Array, span: tuple[int, int], alpha: float) -> float:
    """Chi-square of the points about one face at a right angle to a wall with normal alpha."""
    ca, sa = math.cos(alpha), math.sin(alpha)
    weight, first, second = 0.0, 0.0, 0.0
    for i in range(span[0], span[1] + 1):
        along = points[1, i] * ca - points[0, i] * sa
        steep = along * along / (points[0, i] ** 2 + points[1, i] ** 2)
        w = 1.0 / (points[2, i] * steep + points[3, i] * (1.0 - steep))
        weight, first, second = weight + w, first + w * along, second + w * along * along
    return max(second - first * first / weight, 0.0)


@compiled
def fit_line(
    ranges: Array, points: Array, stretch: tuple[int, int], start: tuple[float, float], terms: Array
) -> tuple[float, float, float, float, float, float]:
    """alpha, rho, their variances and covariance (aa, ar, rr) and the chi-square: Gauss-Newton from `start`.

    The residual r cos(theta - alpha) - rho has the variance sigma_r^2 cos^2 + (r sin sigma_theta)^2. The coordinate
    along the wall is taken from the line, not from the noisy range: with the measured one short oblique faces
    come out centimetres too long. aa is inf when the beams do not carry a line. `terms` (3,B) is room to work in.
    """
    alpha, rho = start
    haa, har, hrr, cost = 1.0, 0.0, 1.0, 0.0
    for _ in range(ITERATIONS):
        weigh_beams(ranges, points, stretch, (alpha, rho), terms)
        haa, har, hrr, ga, gr, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(stretch[1] + 1 - stretch[0]):
            along, residual, weight = terms[0, i], terms[1, i], terms[2, i]
            if weight < 0.0:
                continue
            haa, har, hrr = haa + weight * along * along, har - weight * along, hrr + weight
            cost += weight * residual * residual
            ga, gr = ga + weight * along * residual, gr - weight * residual
        determinant = haa * hrr - har * har
        if not determinant > 1e-9 * haa * hrr:
            return alpha, rho, math.inf, 0.0, math.inf, cost
        alpha -= (hrr * ga - har * gr) / determinant
        rho -= (haa * gr - har * ga) / determinant
    determinant = haa * hrr - har * har
    return alpha, rho, hrr / determinant, -har / determinant, haa / determinant, cost


@compiled
def weigh_beams(
    ranges: Array, points: Array, stretch: tuple[int, int], line: tuple[float, float], terms: Array
) -> None:
    """Fills `terms` (3,n): coordinate along the line, residual, and weight; -1 for a beam too steep to meet the line.

    Each beam by itself, so that the compiler can take several at once.
    """
    (first, last), (alpha, rho) = stretch, line
    ca, sa = math.cos(alpha), math.sin(alpha)
    r, x, y = ranges[first : last + 1], points[0, first : last + 1], points[1, first : last + 1]
    along_ray, across_ray = points[2, first : last + 1], points[3, first : last + 1]
    along, residual, weight = terms[0], terms[1], terms[2]
    for i in range(r.shape[0]):
        ahead, r2 = x[i] * ca + y[i] * sa, r[i] * r[i]
        t = rho * (y[i] * ca - x[i] * sa) / ahead  # rho tan(theta - alpha)
        e = ahead - rho
        variance_r2 = along_ray[i] * ahead * ahead + across_ray[i] * t * t
        w = r2 / max(variance_r2, r2 * e * e / OUTLIER2)
        along[i], residual[i], weight[i] = t, e, -1.0 if ahead < STEEPEST * r[i] else w
