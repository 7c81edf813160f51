"""Straight segments of wall (III-A.1): Ramer-Douglas-Peucker, chi-square merging, and a line with covariance."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import SegmentConfig, SensorModel
from mecp_env.slam.frontend.beams import Noise, Record, laser_noise, roll_beams
from mecp_env.slam.frontend.circles import is_circle
from mecp_env.slam.frontend.line_fit import fit_line, without_end_face
from mecp_env.slam.frontend.split_and_merge import (
    FEWEST,
    absorb_slivers,
    beam_points,
    line_cost,
    merge_lines,
    refine_breaks,
    split_cluster,
)
from mecp_env.slam.messages import ClusterKind, Clusters, MergedScan, Segments


def extract_segments(beams: MergedScan, clusters: Clusters, config: SegmentConfig, sensor: SensorModel) -> Segments:
    """The straight segments of the LINES clusters, in order of bearing, each with its line and covariance.

    Differs from the paper: Ramer-Douglas-Peucker alone keeps breaks that are noise and puts the others a few beams off;
    breaks are moved to where two lines fit best and dropped when they do not pay, by chi-square. With `merge_gain` and
    `shift_beams` 0, breaks stay as they are.
    """
    points, line, cov, (cluster, first, last) = find_segments(
        (beams.ranges, beams.bearings, beams.count),
        (clusters.first, clusters.last, clusters.kind),
        clusters.roll,
        config.record,
        sensor.record,
    )
    return Segments(points, line, cov, cluster, first, last, clusters.roll)


@compiled
def find_segments(
    beams: tuple[Array, Array, Ints],
    clusters: tuple[Ints, Ints, Ints],
    roll: int,
    config: Rows,
    sensor: Rows,
) -> tuple[Array, Array, Array, Ints]:
    """End points (L,2,2), lines (L,2), covariances (L,2,2) and cluster, first, last (3,L) of all segments.

    `beams` are ranges, bearings and count; `clusters` first, last and kind.
    """
    limits, noise, polar = config[0], laser_noise(sensor), roll_beams(beams[0], beams[1], beams[2], roll)
    points, sums = beam_points(polar, noise)
    spans = cut_clusters(points, sums, clusters, limits, noise)
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
    return ends[:found], line[:found], cov[:found], spans[:found].T.copy()


@compiled
def cut_clusters(points: Array, sums: Array, clusters: tuple[Ints, Ints, Ints], limits: Record, noise: Noise) -> Ints:
    """Cluster, first and last position (S,3) of the lines of `min_beams` beams or more in all LINES clusters."""
    first, last, kind = clusters
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
    usable = aa <= limits.max_alpha_sigma_rad**2 and rho > 0.0 and (fits or freedom >= limits.long_beams)
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
