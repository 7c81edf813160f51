"""Data clustering (III-A.1): consecutive hits that may lie on one line, by an adaptive threshold."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Bools, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.beams import BeamRuns, Beams, laser_noise, step_of
from mecp_env.slam.messages import ClusterKind


class Threshold(NamedTuple):
    """The largest distance of two consecutive hits of one cluster: fixed + per_metre * range + noise."""

    fixed: float  # m
    per_metre: float
    sigma: float  # m, of one raw beam, times the number of sigmas; at least
    sigma_share: float  # this share of the range


@compiled
def cluster_beams(beams: Beams, clustering: Rows, segments: Rows, sensor: Rows, sweeps: int = 1) -> BeamRuns:
    """BeamRuns of consecutive hits whose distances stay below the threshold D = d / cos(grazing), plus noise (III-A.1).

    Where the beams are the union of so many interleaved `sweeps`, d = 2 r sin(t/2) is that of one of them: its step t
    is the laser's resolution.

    A run with fewer beams or a smaller extent than a segment has is SMALL. Differs from the paper: without the noise
    term a flat wall at 1 m is cut at a fifth of its beam pairs.
    """
    rule, noise, step, size = clustering[0], laser_noise(sensor), step_of(beams.bearings), beams.ranges.shape[0]
    per_metre = 2.0 * math.sin(sweeps * step / 2.0) / math.cos(rule.grazing_rad) if rule.is_adaptive else 0.0
    sigmas = noise.gate if rule.allows_noise else 0.0
    threshold = Threshold(
        0.0 if rule.is_adaptive else rule.fixed_m, per_metre, sigmas * noise.range_m, sigmas * noise.share
    )
    joined, roll = join_beams(beams, step, threshold), -1
    for i in range(size):
        if not joined[i]:
            roll = (i + 1) % size  # the first beam after a gap
            break
    if roll < 0:  # the beams close a ring: the farthest is a corner
        roll = int(np.argmax(beams.ranges))
    columns = collect_runs(beams, joined, roll, segments[0])
    return BeamRuns(roll, columns[0], columns[1], columns[2])


@compiled
def join_beams(beams: Beams, step: float, threshold: Threshold) -> Bools:
    """(B,) True where the beam and the next one (the first one after the last) may lie on one line."""
    ranges, bearings, hit, count = beams.ranges, beams.bearings, beams.hit, beams.counts
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
def collect_runs(beams: Beams, joined: Bools, roll: int, limits: Record) -> Ints:
    """First and last positions and kinds (3,C) of the runs of joined hits, counted from beam `roll`."""
    ranges, bearings, hit, size = beams.ranges, beams.bearings, beams.hit, beams.ranges.shape[0]
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
    return np.ascontiguousarray(runs[:found].T)


@compiled
def beams_on_walls(runs: BeamRuns, beams: int) -> Bools:
    """(B,) which of the beams are on runs with lines, and may cross a polygon. Pillars and people are not walls."""
    mask = np.zeros(beams, np.bool_)
    for run in range(runs.first.shape[0]):
        if runs.kind[run] != ClusterKind.LINES:
            continue
        for position in range(runs.first[run], runs.last[run] + 1):
            beam = position + runs.roll
            mask[beam if beam < beams else beam - beams] = True
    return mask
