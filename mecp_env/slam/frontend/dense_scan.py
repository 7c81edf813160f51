"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam per nominal bearing."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from mecp_env.core.array_types import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.messages import Scan
from mecp_env.slam.config import SensorModel
from mecp_env.slam.frontend.beams import laser_noise
from mecp_env.slam.messages import MergedScan


def merge_sweeps(scan: Scan, sensor: SensorModel, sweeps: Literal["mean", "union"] = "mean") -> MergedScan:
    """The B beams of `scan`, each averaged over the K raw beams around one nominal bearing, or the "union" of all K B.

    Where the K ranges belong to two surfaces, only the larger group counts (the nearer one of equal groups). Bearings
    are the means of the beams used. Differs from the paper: III-A.1 clusters the union of all sweeps; the average keeps
    the angular step of one sweep, which the adaptive threshold needs, and divides the noise by sqrt(K).
    """
    if sweeps == "union":
        return unite_sweeps(scan)
    ranges, bearings, hit, count, raw_ranges, raw_bearings = average_sweeps(
        scan.ranges, scan.bearings, scan.hit, scan.max_range_m, sensor.record
    )
    return MergedScan(ranges, bearings, hit, count, scan.max_range_m, raw_ranges, raw_bearings)


def unite_sweeps(scan: Scan) -> MergedScan:
    """All K B raw beams of `scan` in order of bearing (III-A.1: the dense scan)."""
    order = np.argsort(scan.bearings, axis=None, kind="stable")
    ranges, bearings = np.ravel(scan.ranges)[order].astype(float), np.ravel(scan.bearings)[order].astype(float)
    hit, count = np.ravel(scan.hit)[order].astype(bool), np.ones(len(order), np.int64)
    return MergedScan(ranges, bearings, hit, count, scan.max_range_m, ranges, bearings)


@compiled
def average_sweeps(
    ranges: Array, bearings: Array, hit: Bools, max_range: float, sensor: Rows
) -> tuple[Array, Array, Bools, Ints, Array, Array]:
    """The fields of `MergedScan` but for the largest range, from sweeps (K,B)."""
    sweeps, size = ranges.shape
    if sweeps == 1:
        alone, turns = ranges[0].copy(), bearings[0].copy()
        return alone, turns, hit[0].copy(), np.ones(size, np.int64), alone, turns
    raw_ranges, raw_bearings, falls = np.empty(sweeps * size), np.empty(sweeps * size), 0
    for beam in range(size):
        for sweep in range(sweeps):
            raw = beam * sweeps + sweep
            raw_ranges[raw], raw_bearings[raw] = ranges[sweep, beam], bearings[sweep, beam]
    for sweep in range(sweeps):  # the bearings, read beam by beam, rise through all sweeps where they are interleaved
        here, there = bearings[sweep], bearings[sweep + 1 if sweep + 1 < sweeps else 0]
        later = 0 if sweep + 1 < sweeps else 1
        for beam in range(size - later):
            falls += there[beam + later] < here[beam]
    if falls > 0:
        ranges, bearings, hit = sort_beams(raw_ranges, raw_bearings, hit)
    step = (raw_bearings[-1] - raw_bearings[0]) / max(raw_bearings.shape[0] - 1, 1)
    noise = laser_noise(sensor)
    slope = sensor[0].merge_slope * (step + noise.bearing) + noise.gate * noise.share
    split = noise.gate * noise.range_m, slope
    mean_ranges, mean_bearings, any_hit, count = average_beams(ranges, bearings, hit, max_range, split)
    return mean_ranges, mean_bearings, any_hit, count, raw_ranges, raw_bearings


@compiled
def sort_beams(raw_ranges: Array, raw_bearings: Array, hit: Bools) -> tuple[Array, Array, Bools]:
    """Sorts the raw beams (K*B,) by bearing; all as sweeps (K,B) again (insertion sort: they are nearly in order)."""
    sweeps, size = hit.shape
    ranges, bearings, did_hit = np.empty((sweeps, size)), np.empty((sweeps, size)), np.empty((sweeps, size), np.bool_)
    raw_hit = np.empty(sweeps * size, np.bool_)
    for raw in range(sweeps * size):
        raw_hit[raw] = hit[raw % sweeps, raw // sweeps]
    for raw in range(1, sweeps * size):
        n, one_range, bearing, one_hit = raw, raw_ranges[raw], raw_bearings[raw], raw_hit[raw]
        while n > 0 and raw_bearings[n - 1] > bearing:
            raw_ranges[n], raw_bearings[n], raw_hit[n] = raw_ranges[n - 1], raw_bearings[n - 1], raw_hit[n - 1]
            n -= 1
        raw_ranges[n], raw_bearings[n], raw_hit[n] = one_range, bearing, one_hit
    for raw in range(sweeps * size):
        k, beam = raw % sweeps, raw // sweeps
        ranges[k, beam], bearings[k, beam], did_hit[k, beam] = raw_ranges[raw], raw_bearings[raw], raw_hit[raw]
    return ranges, bearings, did_hit


@compiled
def average_beams(
    ranges: Array, bearings: Array, hit: Bools, max_range: float, split: tuple[float, float]
) -> tuple[Array, Array, Bools, Ints]:
    """Ranges, bearings, hit and count (B,): means of the columns of (K,B), or of their main groups."""
    (sweeps, size), (allowed, slope) = ranges.shape, split
    out_ranges, out_bearings = np.zeros(size), np.zeros(size)
    out_hit, count = np.empty(size, np.bool_), np.empty(size, np.int64)
    low, high, hits, mixed = np.empty(size), np.zeros(size), np.zeros(size, np.int64), np.empty(size, np.bool_)
    for beam in range(size):
        low[beam] = math.inf
    for k in range(sweeps):
        of_sweep, turns, did_hit = ranges[k], bearings[k], hit[k]
        for beam in range(size):
            r = of_sweep[beam]
            out_ranges[beam] += r
            out_bearings[beam] += turns[beam]
            hits[beam] += did_hit[beam]
            low[beam], high[beam] = min(low[beam], r), max(high[beam], r)
    for beam in range(size):  # several beams at once; the few that belong to two surfaces come afterwards
        wide = high[beam] - low[beam] > allowed + slope * low[beam]
        mixed[beam] = wide or (hits[beam] != 0 and hits[beam] != sweeps)
        out_hit[beam], count[beam] = hits[beam] > 0, sweeps
        out_ranges[beam] = out_ranges[beam] / sweeps if hits[beam] > 0 else max_range
        out_bearings[beam] /= sweeps
    by_range = np.empty((sweeps, 2))
    for beam in range(size):
        if mixed[beam]:
            first, last = main_group(ranges[:, beam], bearings[:, beam], hit[:, beam], split, by_range)
            out_hit[beam], count[beam] = by_range[first, 0] < math.inf, last - first + 1
            total, turn = 0.0, 0.0
            for k in range(first, last + 1):
                total, turn = total + by_range[k, 0], turn + by_range[k, 1]
            out_ranges[beam] = total / count[beam] if out_hit[beam] else max_range
            out_bearings[beam] = turn / count[beam]
    return out_ranges, out_bearings, out_hit, count


@compiled
def main_group(
    ranges: Array, bearings: Array, hit: Bools, split: tuple[float, float], by_range: Array
) -> tuple[int, int]:
    """First and last row of the largest group of beams (K,) without a gap > split[0] + split[1] * range.

    Fills `by_range` (K,2), nearest first: range (inf without a hit) and bearing.
    """
    for k in range(by_range.shape[0]):
        distance, at = ranges[k] if hit[k] else math.inf, k
        while at > 0 and by_range[at - 1, 0] > distance:
            by_range[at, 0], by_range[at, 1] = by_range[at - 1, 0], by_range[at - 1, 1]
            at -= 1
        by_range[at, 0], by_range[at, 1] = distance, bearings[k]
    first, last = 0, by_range.shape[0] - 1
    while True:
        cut, widest = -1, 0.0
        for k in range(first, last):
            if by_range[k, 0] == math.inf:
                break
            excess = by_range[k + 1, 0] - by_range[k, 0] * (1.0 + split[1]) - split[0]
            if excess > widest:
                cut, widest = k, excess
        if cut < 0:
            return first, last
        if cut - first + 1 >= last - cut:
            last = cut
        else:
            first = cut + 1
