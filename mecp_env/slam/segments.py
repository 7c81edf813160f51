"""Straight segments of wall (III-A.1): Ramer-Douglas-Peucker, chi-square merging, and a line with covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import SegmentConfig, SensorModel
from mecp_env.slam.data import Beams, ClusterKind, Clusters, Segments
from mecp_env.slam.geometry import wrap_angle
from mecp_env.slam.lines import STEEPEST, fit_line, rough_line, without_end_face
from mecp_env.slam.noise import Noise, noise_of, roll_beams
from mecp_env.slam.rounds import is_round
from mecp_env.slam.stretches import beam_points, break_cluster, straighten

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
LINES = int(ClusterKind.LINES)
MISFIT_SIGMAS = 3.0  # a chi-square this far above what is expected means no straight wall
LONG = 15  # degrees of freedom from which on a misfit only widens the covariance


class Rules(NamedTuple):
    """What makes a stretch of beams a segment."""

    split_sigmas: float
    merge_gain: float
    min_beams: int
    min_length: float  # m
    max_alpha_variance: float  # rad^2
    trim_beams: int


def extract_segments(beams: Beams, clusters: Clusters, config: SegmentConfig, sensor: SensorModel) -> Segments:
    """The straight segments of the LINES clusters, in order of bearing, each with its line and covariance.

    Differs from the paper: Ramer-Douglas-Peucker alone keeps breaks that are noise and puts the others a few beams off;
    breaks are moved to where two lines fit best and dropped when they do not pay, by chi-square.
    """
    rules = Rules(
        config.split_sigmas,
        config.merge_gain,
        config.min_beams,
        config.min_length_m,
        math.radians(config.max_alpha_sigma_deg) ** 2,
        config.trim_beams,
    )
    polar = roll_beams(beams.ranges, beams.bearings, beams.count, clusters.roll)
    options = (rules, noise_of(sensor))
    points, line, cov, span = find_segments(polar, clusters.first, clusters.last, clusters.kind, options)
    cluster, first, last = np.ascontiguousarray(span.T)
    return Segments(points, line, cov, cluster, first, last, clusters.roll)


@kernel
def find_segments(
    polar: Array, cluster_first: Ints, cluster_last: Ints, kind: Ints, rules_and_noise: tuple[Rules, Noise]
) -> tuple[Array, Array, Array, Ints]:
    """End points (L,2,2), lines (L,2), covariances (L,2,2) and cluster, first, last (L,3) of all segments."""
    rules, noise = rules_and_noise
    points, sums = beam_points(polar, noise)
    spans = np.empty((polar.shape[0], 3), np.int64)
    found = 0
    for c in range(cluster_first.shape[0]):
        if kind[c] == LINES:
            found = cut_cluster((points, sums), (c, cluster_first[c], cluster_last[c]), rules, spans, found)
    return fit_segments(polar, (points, sums), spans[:found], rules)


@kernel
def cut_cluster(
    points_and_sums: tuple[Array, Array], span: tuple[int, int, int], rules: Rules, spans: Ints, found: int
) -> int:
    """Appends cluster, first and last position of the cluster's straight stretches of `min_beams` beams or more."""
    points, sums = points_and_sums
    cluster, first, last = span
    ends = np.empty(last - first + 2, np.int64)
    size = break_cluster(points, first, last, rules.split_sigmas, ends)
    size = straighten(sums, first, ends, size, rules.merge_gain)
    if is_round(points, sums, first, ends, size):
        return found
    start = first
    for k in range(size):
        if ends[k] - start + 1 >= rules.min_beams:
            spans[found, 0], spans[found, 1], spans[found, 2] = cluster, start, ends[k]
            found += 1
        start = ends[k] + 1
    return found


@kernel
def fit_segments(
    polar: Array, points_and_sums: tuple[Array, Array], spans: Ints, rules: Rules
) -> tuple[Array, Array, Array, Ints]:
    """End points (L,2,2), lines (L,2), covariances (L,2,2) and spans (L,3) of the stretches that are segments."""
    size = spans.shape[0]
    ends, line, cov = np.empty((size, 2, 2)), np.empty((size, 2)), np.empty((size, 2, 2))
    kept, found = np.empty((size, 3), np.int64), 0
    points, sums = points_and_sums
    for k in range(size):
        first, last = without_end_face(points, sums, (spans[k, 1], spans[k, 2]), rules.min_beams)
        trim = min(rules.trim_beams, (last - first + 1 - rules.min_beams) // 2)
        inner = (first + trim, last - trim)
        alpha, rho, aa, ar, rr, cost = fit_line(polar, points, inner, rough_line(sums, inner[0], inner[1]))
        freedom = max(inner[1] - inner[0] - 1, 1)
        excess = cost / (freedom + MISFIT_SIGMAS * math.sqrt(2.0 * freedom))
        usable = aa <= rules.max_alpha_variance and rho > 0.0 and (excess <= 1.0 or freedom >= LONG)
        usable = usable and math.cos(polar[first, 1] - alpha) > STEEPEST and math.cos(polar[last, 1] - alpha) > STEEPEST
        if not usable:
            continue
        for end in range(2):
            bearing = polar[first if end == 0 else last, 1]
            r = rho / math.cos(bearing - alpha)
            ends[found, end, 0], ends[found, end, 1] = r * math.cos(bearing), r * math.sin(bearing)
        length2 = (ends[found, 1, 0] - ends[found, 0, 0]) ** 2 + (ends[found, 1, 1] - ends[found, 0, 1]) ** 2
        if length2 < rules.min_length * rules.min_length:
            continue
        line[found, 0], line[found, 1] = wrap_angle(alpha), rho
        inflate = max(excess, 1.0)
        cov[found, 0, 0], cov[found, 1, 1] = inflate * aa, inflate * rr
        cov[found, 0, 1] = cov[found, 1, 0] = inflate * ar
        kept[found, 0], kept[found, 1], kept[found, 2] = spans[k, 0], first, last
        found += 1
    return ends[:found].copy(), line[:found].copy(), cov[:found].copy(), kept[:found].copy()
