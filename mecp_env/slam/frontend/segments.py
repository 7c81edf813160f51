"""Straight segments of wall (III-A.1): Ramer-Douglas-Peucker, chi-square merging, and a line with covariance.

Compiled functions for circle (pillar) detection: an arc would be cut into short segments with wandering corners.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import solve3
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.beams import BeamRuns, Beams, Noise, Pieces, laser_noise, roll_beams
from mecp_env.slam.frontend.lines import (
    FEWEST,
    absorb_slivers,
    beam_points,
    fit_line,
    line_cost,
    merge_lines,
    refine_breaks,
    split_cluster,
    without_end_face,
)
from mecp_env.slam.messages import ClusterKind

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


@compiled
def extract_segments(beams: Beams, runs: BeamRuns, segments: Rows, sensor: Rows) -> Pieces:
    """The straight segments of the LINES clusters, in order of bearing, each with its line and covariance.

    Differs from the paper: Ramer-Douglas-Peucker alone keeps breaks that are noise and puts the others a few beams off;
    breaks are moved to where two lines fit best and dropped when they do not pay, by chi-square. With `merge_gain` and
    `shift_beams` 0, breaks stay as they are.
    """
    limits, noise, polar = segments[0], laser_noise(sensor), roll_beams(beams, runs.roll)
    points, sums = beam_points(polar, noise)
    spans = cut_clusters(points, sums, runs, limits, noise)
    size, found, terms = spans.shape[0], 0, np.empty((3, polar.shape[1]))
    ends, line, cov = np.empty((size, 2, 2)), np.empty((size, 2)), np.empty((size, 2, 2))
    for k in range(size):
        span = without_end_face(points, sums, spans[k, 1], spans[k, 2], limits, noise)
        trim = min(noise.edge, (span[1] - span[0] + 1 - FEWEST) // 2)
        fit = fit_line(polar[0], points, sums, (span[0] + trim, span[1] - trim), noise, terms)
        cost, rows = line_cost(sums, span[0], span[1]), (ends[found], line[found], cov[found])
        if write_segment(rows, polar[1], span, trim, cost, fit, limits, noise):
            spans[found, 0], spans[found, 1], spans[found, 2] = spans[k, 0], span[0], span[1]
            found += 1
    columns = np.ascontiguousarray(spans[:found].T)
    return Pieces(ends[:found], line[:found], cov[:found], columns[0], columns[1], columns[2], runs.roll)


@compiled
def cut_clusters(points: Array, sums: Array, runs: BeamRuns, limits: Record, noise: Noise) -> Ints:
    """Cluster, first and last position (S,3) of the lines of `min_beams` beams or more in all LINES clusters."""
    first, last, kind = runs.first, runs.last, runs.kind
    spans, breaks, found = np.empty((points.shape[1], 3), np.int64), np.empty(points.shape[1] + 2, np.int64), 0
    for c in range(first.shape[0]):
        if kind[c] != ClusterKind.LINES:
            continue
        size = split_cluster(points, first[c], last[c], noise.gate, breaks)
        size = merge_lines(sums, breaks, size, limits.merge_gain)
        refine_breaks(sums, breaks, size, limits.shift_beams)
        size = absorb_slivers(sums, breaks, size, limits.merge_gain, limits.shift_beams)
        size = merge_lines(sums, breaks, size, limits.merge_gain)
        refine_breaks(sums, breaks, size, min(FEWEST, limits.shift_beams))
        if is_circle(points, sums, breaks, size, limits, noise):
            continue
        for k in range(size):
            if breaks[k + 1] - breaks[k] >= limits.min_beams:
                spans[found, 0], spans[found, 1], spans[found, 2] = c, breaks[k] + 1, breaks[k + 1]
                found += 1
    return spans[:found]


@compiled
def write_segment(
    rows: tuple[Array, Array, Array],
    bearings: Array,
    span: tuple[int, int],
    trim: int,
    whole_cost: float,
    fit: tuple[float, float, float, float, float, float],
    limits: Record,
    noise: Noise,
) -> bool:
    """True when a line is a segment: its ends (2,2), line (2,) and covariance (2,2) are in `rows` then.

    `fit` is what `fit_line` returns without `trim` beams at each end, `whole_cost` the chi-square with them: a short
    segment must fit with them as well, for they may be of two faces that its few beams do not tell apart.
    """
    (ends, line, cov), (alpha, rho, aa, ar, rr, cost) = rows, fit
    freedom, whole = max(span[1] - span[0] - 2 * trim - 1, 1), span[1] - span[0] - 1
    excess = cost / (freedom + noise.gate * math.sqrt(2.0 * freedom))
    fits = max(excess, whole_cost / (whole + noise.outlier * math.sqrt(2.0 * whole))) <= 1.0
    usable = aa <= limits.max_alpha_sigma_rad**2 and (fits or freedom >= limits.long_beams)
    for end in range(2):
        bearing = bearings[span[end]]
        cosine = math.cos(bearing - alpha)
        if not (usable and cosine > noise.least_cosine):
            return False
        r = rho / cosine
        ends[end, 0], ends[end, 1] = r * math.cos(bearing), r * math.sin(bearing)
    line[0], line[1] = wrap_angle(alpha), rho
    inflate = max(excess, 1.0)
    cov[0, 0], cov[1, 1] = inflate * aa, inflate * rr
    cov[0, 1] = cov[1, 0] = inflate * ar
    length2 = (ends[1, 0] - ends[0, 0]) ** 2 + (ends[1, 1] - ends[0, 1]) ** 2
    return not length2 < limits.min_length_m * limits.min_length_m
