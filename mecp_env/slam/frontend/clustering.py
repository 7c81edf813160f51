"""Data clustering (III-A.1): consecutive hits that may lie on one line, by an adaptive threshold."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.config import ClusteringConfig, SegmentConfig, SensorModel
from mecp_env.slam.frontend.beams import laser_noise
from mecp_env.slam.messages import ClusterKind, Clusters, MergedScan


class Threshold(NamedTuple):
    """The largest distance of two consecutive hits of one cluster: fixed + per_metre * range + noise."""

    fixed: float  # m
    per_metre: float
    sigma: float  # m, of one raw beam, times the number of sigmas; at least
    sigma_share: float  # this share of the range


def cluster_beams(
    beams: MergedScan, config: ClusteringConfig, segments: SegmentConfig, sensor: SensorModel, sweeps: int = 1
) -> Clusters:
    """Runs of consecutive hits whose distances stay below the threshold D = d / cos(grazing), plus noise (III-A.1).

    Where the beams are the union of interleaved `sweeps`, d is that of one of them: its step is the laser's resolution.

    A run with fewer beams or a smaller extent than a segment has is SMALL. Differs from the paper: without the noise
    term a flat wall at 1 m is cut at a fifth of its beam pairs.
    """
    denser = math.sin(0.5 * beams.step) / math.sin(0.5 * sweeps * beams.step) if sweeps > 1 else 1.0
    fixed = config.threshold == "fixed"
    rule = (
        config.fixed_m if fixed else 0.0,
        0.0 if fixed else denser * math.cos(math.radians(config.grazing_deg)),
        sensor.noise_sigmas if config.threshold == "adaptive_noise" else 0.0,
    )
    scan = beams.ranges, beams.bearings, beams.hit, beams.count
    roll, (first, last, kind) = find_clusters(scan, rule, segments.record, sensor.record)
    return Clusters(roll, first, last, kind)


def beams_on_walls(clusters: Clusters, beams: MergedScan) -> Bools:
    """(B,) which beams are on clusters with lines, and may cross a polygon. Pillars and people are not walls."""
    return wall_beams(clusters.roll, clusters.first, clusters.last, clusters.kind, len(beams.ranges))


@compiled
def find_clusters(
    beams: tuple[Array, Array, Bools, Ints],
    rule: tuple[float, float, float],
    segments: Rows,
    sensor: Rows,
) -> tuple[int, Ints]:
    """The beam at position 0, and first position, last position and kind (3,C) of the clusters.

    `beams` are ranges, bearings, hit and count; `rule` is the fixed part of the threshold (m), the cosine of the
    grazing angle (0: no part grows with the range), and the number of standard deviations of noise.
    """
    ranges, bearings, hit, _ = beams
    size, (fixed, cosine, sigmas) = ranges.shape[0], rule
    step = (bearings[size - 1] - bearings[0]) / max(size - 1, 1)
    per_metre = 2.0 * math.sin(step / 2.0) / cosine if cosine > 0.0 else 0.0  # d / cos 85, d = 2 r sin(t/2)
    noise = laser_noise(sensor)
    joined = join_beams(beams, step, Threshold(fixed, per_metre, sigmas * noise.range_m, sigmas * noise.share))
    roll = -1
    for i in range(size):
        if not joined[i]:
            roll = (i + 1) % size  # the first beam after a gap
            break
    if roll < 0:  # the beams close a ring: the farthest is a corner
        roll = int(np.argmax(ranges))
    return roll, collect_runs(ranges, bearings, hit, joined, roll, segments[0])


@compiled
def join_beams(beams: tuple[Array, Array, Bools, Ints], step: float, threshold: Threshold) -> Bools:
    """(B,) True where the beam and the next one (the first one after the last) may lie on one line."""
    ranges, bearings, hit, count = beams
    size, widest = ranges.shape[0], 2.0 * step  # farther apart, a beam between them is missing
    joined = np.empty(size, np.bool_)
    for i in range(size - 1):  # without branches: several beams at once
        turn = bearings[i + 1] - bearings[i]
        near = may_join((ranges[i], ranges[i + 1]), turn, (count[i], count[i + 1]), threshold)
        joined[i] = near & hit[i] & hit[i + 1] & (turn <= widest)
    i, turn = size - 1, bearings[0] - bearings[size - 1] + 2.0 * math.pi
    near = may_join((ranges[i], ranges[0]), turn, (count[i], count[0]), threshold)
    joined[i] = size > 1 and near and hit[i] and hit[0] and turn <= widest
    return joined


@compiled
def may_join(ranges: tuple[float, float], turn: float, count: tuple[int, int], threshold: Threshold) -> bool:
    """True when two hits, `turn` rad apart, with `count` raw beams behind them, are no farther from each other."""
    (a, b), nearer = ranges, min(ranges[0], ranges[1])
    jump, across = abs(a - b), a * b * turn * turn
    allowed = threshold.fixed + threshold.per_metre * nearer
    allowed += max(threshold.sigma, threshold.sigma_share * nearer) * math.sqrt(1.0 / count[0] + 1.0 / count[1])
    return jump * jump + across <= allowed * allowed


@compiled
def collect_runs(ranges: Array, bearings: Array, hit: Bools, joined: Bools, roll: int, limits: Record) -> Ints:
    """First and last positions and kinds (3,C) of the runs of joined hits, counted from beam `roll`."""
    size = ranges.shape[0]
    runs, found, start, first = np.empty((size, 3), np.int64), 0, 0, roll
    nearest, farthest = math.inf, 0.0
    for position in range(size):
        beam = position + roll if position + roll < size else position + roll - size
        nearest, farthest = min(nearest, ranges[beam]), max(farthest, ranges[beam])
        if joined[beam] and position < size - 1:
            continue
        if hit[beam]:
            turn = bearings[beam] - bearings[first]
            across = nearest * (turn if turn >= 0.0 else turn + 2.0 * math.pi)
            wide = across * across + (farthest - nearest) ** 2 >= limits.min_length_m * limits.min_length_m
            wall = wide and position - start + 1 >= limits.min_beams
            runs[found, 0], runs[found, 1] = start, position
            runs[found, 2] = ClusterKind.LINES if wall else ClusterKind.SMALL
            found += 1
        start, first = position + 1, beam + 1 if beam + 1 < size else 0
        nearest, farthest = math.inf, 0.0
    return runs[:found].T.copy()


@compiled
def wall_beams(roll: int, first: Ints, last: Ints, kind: Ints, beams: int) -> Bools:
    """(B,) which beams belong to a run (first and last position from `roll`) of lines."""
    mask = np.zeros(beams, np.bool_)
    for run in range(first.shape[0]):
        if kind[run] != ClusterKind.LINES:
            continue
        for position in range(first[run], last[run] + 1):
            beam = position + roll
            mask[beam if beam < beams else beam - beams] = True
    return mask
