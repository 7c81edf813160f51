"""Straight segments of wall (III-A.1): Ramer-Douglas-Peucker, chi-square merging, and a line with covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import SegmentConfig, SensorModel
from mecp_env.slam.frontend.circles import is_round
from mecp_env.slam.frontend.line_fit import STEEPEST, fit_line, rough_line, without_end_face
from mecp_env.slam.frontend.noise import Noise, noise_of, roll_beams
from mecp_env.slam.frontend.split_and_merge import beam_points, break_cluster, straighten
from mecp_env.slam.messages import ClusterKind, Clusters, MergedScan, Segments

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


def extract_segments(beams: MergedScan, clusters: Clusters, config: SegmentConfig, sensor: SensorModel) -> Segments:
    """The straight segments of the LINES clusters, in order of bearing, each with its line and covariance.

    Differs from the paper: Ramer-Douglas-Peucker alone keeps breaks that are noise and puts the others a few beams off;
    breaks are moved to where two lines fit best and dropped when they do not pay, by chi-square.
    """
    rules = (
        config.split_sigmas,
        config.merge_gain,
        config.min_beams,
        config.min_length_m,
        math.radians(config.max_alpha_sigma_deg) ** 2,
        config.trim_beams,
    )
    points, line, cov, (cluster, first, last) = find_segments(
        (beams.ranges, beams.bearings, beams.count),
        (clusters.first, clusters.last, clusters.kind),
        clusters.roll,
        rules,
        noise_of(sensor),
    )
    return Segments(points, line, cov, cluster, first, last, clusters.roll)


@compiled
def find_segments(
    beams: tuple[Array, Array, Ints],
    clusters: tuple[Ints, Ints, Ints],
    roll: int,
    options: tuple[float, float, int, float, float, int],
    sigmas: tuple[float, float],
) -> tuple[Array, Array, Array, Ints]:
    """End points (L,2,2), lines (L,2), covariances (L,2,2) and cluster, first, last (3,L) of all segments.

    Given are range, bearing and count of the beams, first, last and kind of the clusters, and the fields of `Rules` and
    of `Noise`.
    """
    rules = Rules(options[0], options[1], options[2], options[3], options[4], options[5])
    first, last, kind = clusters
    polar = roll_beams(beams[0], beams[1], beams[2], roll)
    points, sums = beam_points(polar, Noise(sigmas[0], sigmas[1]))
    spans = np.empty((polar.shape[1], 3), np.int64)
    found = 0
    for c in range(first.shape[0]):
        if kind[c] == LINES:
            found = cut_cluster((points, sums), (c, first[c], last[c]), rules, spans, found)
    return fit_segments(polar, (points, sums), spans[:found], rules)


@compiled
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


@compiled
def fit_segments(
    polar: Array, points_and_sums: tuple[Array, Array], spans: Ints, rules: Rules
) -> tuple[Array, Array, Array, Ints]:
    """End points (L,2,2), lines (L,2), covariances (L,2,2) and spans (3,L) of the stretches that are segments."""
    size = spans.shape[0]
    ends, line, cov = np.empty((size, 2, 2)), np.empty((size, 2)), np.empty((size, 2, 2))
    found, terms = 0, np.empty((3, polar.shape[1]))
    for k in range(size):
        first, last = without_end_face(*points_and_sums, (spans[k, 1], spans[k, 2]), rules.min_beams)
        if fit_segment(polar, points_and_sums, (first, last), rules, (ends[found], line[found], cov[found], terms)):
            spans[found, 0], spans[found, 1], spans[found, 2] = spans[k, 0], first, last
            found += 1
    kept = np.empty((3, found), np.int64)
    for k in range(found):
        kept[0, k], kept[1, k], kept[2, k] = spans[k, 0], spans[k, 1], spans[k, 2]
    return ends[:found], line[:found], cov[:found], kept


@compiled
def fit_segment(
    polar: Array,
    points_and_sums: tuple[Array, Array],
    span: tuple[int, int],
    rules: Rules,
    rows: tuple[Array, Array, Array, Array],
) -> bool:
    """True when the stretch is a segment: its ends (2,2), line (2,) and covariance (2,2) then stand in `rows`."""
    (points, sums), (first, last), (ends, line, cov, terms) = points_and_sums, span, rows
    trim = min(rules.trim_beams, (last - first + 1 - rules.min_beams) // 2)
    inner = (first + trim, last - trim)
    alpha, rho, aa, ar, rr, cost = fit_line(polar[0], points, inner, rough_line(sums, inner[0], inner[1]), terms)
    freedom = max(inner[1] - inner[0] - 1, 1)
    excess = cost / (freedom + MISFIT_SIGMAS * math.sqrt(2.0 * freedom))
    usable = aa <= rules.max_alpha_variance and rho > 0.0 and (excess <= 1.0 or freedom >= LONG)
    usable = usable and math.cos(polar[1, first] - alpha) > STEEPEST and math.cos(polar[1, last] - alpha) > STEEPEST
    if not usable:
        return False
    for end in range(2):
        bearing = polar[1, first if end == 0 else last]
        r = rho / math.cos(bearing - alpha)
        ends[end, 0], ends[end, 1] = r * math.cos(bearing), r * math.sin(bearing)
    line[0], line[1] = wrap_angle(alpha), rho
    inflate = max(excess, 1.0)
    cov[0, 0], cov[1, 1] = inflate * aa, inflate * rr
    cov[0, 1] = cov[1, 0] = inflate * ar
    length2 = (ends[1, 0] - ends[0, 0]) ** 2 + (ends[1, 1] - ends[0, 1]) ** 2
    return not length2 < rules.min_length * rules.min_length
