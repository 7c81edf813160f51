"""Compiled functions for the maximum-likelihood line (alpha, rho) through averaged beams, with its covariance."""

from __future__ import annotations

import math

from mecp_env.core.array_types import Array
from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.beams import Noise, Record
from mecp_env.slam.frontend.split_and_merge import line_cost, scatter

ITERATIONS = 2


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
def without_end_face(
    points: Array, sums: Array, first: int, last: int, limits: Record, noise: Noise
) -> tuple[int, int]:
    """First and last position of the wall itself, where beams of its end face, at a right angle, are taken for it.

    Seen along the wall, the face at its near end is within the noise; its few beams turn the line.
    """
    alpha, _ = rough_line(sums, first, last)  # coordinates along the wall, from the foot of the perpendicular on:
    begins = -(points[1, first] * math.cos(alpha) - points[0, first] * math.sin(alpha))
    ends = points[1, last] * math.cos(alpha) - points[0, last] * math.sin(alpha)
    if begins >= 0.0 and ends >= 0.0:
        return first, last  # the robot is in front of the wall: its end faces are turned away
    best, best_cost = (first, last), line_cost(sums, first, last) - noise.face_gain
    most = min(limits.shift_beams, last - first + 1 - limits.min_beams)
    kept = (first + most, last) if begins < 0.0 else (first, last - most)
    if line_cost(sums, kept[0], kept[1]) >= best_cost:
        return first, last
    for dropped in range(1, most + 1):
        low, high = (first + dropped, last) if begins < 0.0 else (first, last - dropped)
        face = (first, low - 1) if begins < 0.0 else (high + 1, last)
        cost = line_cost(sums, low, high)
        if cost < best_cost:
            cost += face_spread(points, face, rough_line(sums, low, high)[0])
        if cost < best_cost:
            best, best_cost = (low, high), cost
    return best


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
    ranges: Array, points: Array, sums: Array, span: tuple[int, int], noise: Noise, terms: Array
) -> tuple[float, float, float, float, float, float]:
    """alpha, rho, their variances and covariance (aa, ar, rr) and the chi-square: Gauss-Newton from the rough line.

    The residual r cos(theta - alpha) - rho has the variance sigma_r^2 cos^2 + (r sin sigma_theta)^2. The coordinate
    along the wall is taken from the line, not from the noisy range: with the measured one short oblique faces
    come out centimetres too long. The same holds for a sigma_r that is a share of the range: by the measured one, beams
    that are too short count for more, and all walls come nearer by twice the square of the share. aa is inf when the
    beams do not carry a line. `terms` (3,B) is work space for the coordinate along the line, residual and weight of
    each beam; the weight is -1 where the ray does not meet the line.
    """
    first, last = span
    (alpha, rho), (haa, har, hrr, cost) = rough_line(sums, first, last), (1.0, 0.0, 1.0, 0.0)
    r, x, y = ranges[first : last + 1], points[0, first : last + 1], points[1, first : last + 1]
    along_ray, across_ray = points[2, first : last + 1], points[3, first : last + 1]
    along, residual, weight, outlier2 = terms[0], terms[1], terms[2], noise.outlier * noise.outlier
    share, least = noise.share, noise.range_m
    for _ in range(ITERATIONS):
        ca, sa = math.cos(alpha), math.sin(alpha)
        for i in range(r.shape[0]):  # each beam by itself: several at once
            ahead, r2 = x[i] * ca + y[i] * sa, r[i] * r[i]
            t = rho * (y[i] * ca - x[i] * sa) / ahead  # rho tan(theta - alpha)
            e = ahead - rho
            expected = max(share * rho * r[i], least * ahead) / max(share * r[i], least)  # of sigma_r, times ahead
            variance_r2 = along_ray[i] * expected * expected + across_ray[i] * t * t
            w = r2 / max(variance_r2, r2 * e * e / outlier2)
            along[i], residual[i], weight[i] = t, e, -1.0 if ahead < noise.least_cosine * r[i] else w
        haa, har, hrr, ga, gr, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(r.shape[0]):
            t, e, w = along[i], residual[i], weight[i]
            if w < 0.0:
                continue
            haa, har, hrr = haa + w * t * t, har - w * t, hrr + w
            cost += w * e * e
            ga, gr = ga + w * t * e, gr - w * e
        determinant = haa * hrr - har * har
        if not determinant > 1e-9 * haa * hrr:
            return alpha, rho, math.inf, 0.0, math.inf, cost
        alpha -= (hrr * ga - har * gr) / determinant
        rho -= (haa * gr - har * ga) / determinant
    determinant = haa * hrr - har * har
    return alpha, rho, hrr / determinant, -har / determinant, haa / determinant, cost
