"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam a nominal bearing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.messages import Scan
from mecp_env.slam.config import SensorModel
from mecp_env.slam.frontend.noise import Noise, noise_of
from mecp_env.slam.messages import MergedScan

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
SPLIT_SIGMAS = 3.0  # two neighbouring ranges of one surface differ by less than this, and by
SPLIT_SLOPE = 4.0  # what a surface grazed at atan(4) = 76 degrees adds over the beams' bearings


class Split(NamedTuple):
    """Ranges of one surface that follow each other by size differ by no more than allowed + slope * range."""

    allowed: float  # m
    slope: float


def merge_sweeps(scan: Scan, sensor: SensorModel) -> MergedScan:
    """The B beams of `scan`, each averaged over the K raw beams around one nominal bearing.

    Where the K ranges belong to two surfaces, only the larger group counts (the nearer one of equal groups). Bearings
    are the means of the beams used. Differs from the paper: III-A.1 clusters the union of all sweeps; the average keeps
    the angular step of one sweep, which the adaptive threshold needs, and divides the noise by sqrt(K).
    """
    if len(scan.ranges) == 1:
        ranges, bearings = np.array(scan.ranges[0], float), np.array(scan.bearings[0], float)
        count = np.empty(len(ranges), np.int64)
        count.fill(1)
        return MergedScan(ranges, bearings, np.array(scan.hit[0], bool), count, scan.max_range_m, ranges, bearings)
    ranges, bearings, hit, count, raw_ranges, raw_bearings = average_sweeps(
        scan.ranges, scan.bearings, scan.hit, scan.max_range_m, noise_of(sensor)
    )
    return MergedScan(ranges, bearings, hit, count, scan.max_range_m, raw_ranges, raw_bearings)


@compiled
def average_sweeps(
    ranges: Array, bearings: Array, hit: Bools, max_range: float, sigmas: tuple[float, float]
) -> tuple[Array, Array, Bools, Ints, Array, Array]:
    """The fields of `MergedScan` but for the largest range, from sweeps (K,B) and the fields of `Noise`."""
    sweeps, size = ranges.shape
    raw_ranges, raw_bearings = np.empty(sweeps * size), np.empty(sweeps * size)
    for beam in range(size):
        for sweep in range(sweeps):
            raw = beam * sweeps + sweep
            raw_ranges[raw], raw_bearings[raw] = ranges[sweep, beam], bearings[sweep, beam]
    if is_interleaved(bearings):
        averages = average_beams(ranges, bearings, hit, max_range, split_of(raw_bearings, sigmas))
    else:
        sweeps_in_order = sort_beams(raw_ranges, raw_bearings, hit)
        averages = average_beams(*sweeps_in_order, max_range, split_of(raw_bearings, sigmas))
    return averages[0], averages[1], averages[2], averages[3], raw_ranges, raw_bearings


@compiled
def split_of(raw_bearings: Array, sigmas: tuple[float, float]) -> Split:
    """How far apart the ranges of one surface may lie, by the beams' bearings in order and the fields of `Noise`."""
    noise = Noise(sigmas[0], sigmas[1])
    step = (raw_bearings[-1] - raw_bearings[0]) / max(raw_bearings.shape[0] - 1, 1)
    return Split(SPLIT_SIGMAS * noise.range_m, SPLIT_SLOPE * (step + noise.bearing))


@compiled
def is_interleaved(bearings: Array) -> bool:
    """True when the bearings (K,B), read beam by beam, rise through all sweeps."""
    sweeps, size = bearings.shape
    falls = 0
    for sweep in range(sweeps):
        here, there = bearings[sweep], bearings[sweep + 1 if sweep + 1 < sweeps else 0]
        later = 0 if sweep + 1 < sweeps else 1
        for beam in range(size - later):
            falls += there[beam + later] < here[beam]
    return falls == 0


@compiled
def sort_beams(ranges: Array, bearings: Array, hit: Bools) -> tuple[Array, Array, Bools]:
    """Sorts the raw beams (K*B,) by bearing; all as sweeps (K,B) again (insertion sort: they are nearly in order)."""
    sweeps, size = hit.shape
    raw_hit = np.empty(sweeps * size, np.bool_)
    for raw in range(sweeps * size):
        raw_hit[raw] = hit[raw % sweeps, raw // sweeps]
    for raw in range(1, sweeps * size):
        if bearings[raw] < bearings[raw - 1]:
            sink_beam(ranges, bearings, raw_hit, raw)
    out_ranges, out_bearings = np.empty((sweeps, size)), np.empty((sweeps, size))
    out_hit = np.empty((sweeps, size), np.bool_)
    for raw in range(sweeps * size):
        k, beam = raw % sweeps, raw // sweeps
        out_ranges[k, beam], out_bearings[k, beam], out_hit[k, beam] = ranges[raw], bearings[raw], raw_hit[raw]
    return out_ranges, out_bearings, out_hit


@compiled
def sink_beam(ranges: Array, bearings: Array, hit: Bools, n: int) -> None:
    """Moves beam n down to its place among the sorted beams before it."""
    distance, bearing, did_hit = ranges[n], bearings[n], hit[n]
    while n > 0 and bearings[n - 1] > bearing:
        ranges[n], bearings[n], hit[n] = ranges[n - 1], bearings[n - 1], hit[n - 1]
        n -= 1
    ranges[n], bearings[n], hit[n] = distance, bearing, did_hit


@compiled
def average_beams(
    ranges: Array, bearings: Array, hit: Bools, max_range: float, split: Split
) -> tuple[Array, Array, Bools, Ints]:
    """Ranges, bearings, hit and count (B,): means of the columns of (K,B), or of their main groups."""
    sweeps, size = ranges.shape
    out_ranges, out_bearings = np.zeros(size), np.zeros(size)
    out_hit, count = np.empty(size, np.bool_), np.empty(size, np.int64)
    low, high, hits, mixed = np.empty(size), np.zeros(size), np.zeros(size, np.int64), np.empty(size, np.bool_)
    for beam in range(size):
        low[beam] = math.inf
    for k in range(sweeps):
        add_sweep(ranges[k], bearings[k], hit[k], (out_ranges, out_bearings, low, high), hits)
    for beam in range(size):  # several beams at once; the few that belong to two surfaces come afterwards
        wide = high[beam] - low[beam] > split.allowed + split.slope * low[beam]
        mixed[beam] = wide or (hits[beam] != 0 and hits[beam] != sweeps)
        out_hit[beam], count[beam] = hits[beam] > 0, sweeps
        out_ranges[beam] = out_ranges[beam] / sweeps if hits[beam] > 0 else max_range
        out_bearings[beam] /= sweeps
    by_range = np.empty((sweeps, 2))
    for beam in range(size):
        if mixed[beam]:
            sort_group(ranges, bearings, hit, beam, by_range)
            first, last = main_group(by_range, split)
            out_hit[beam], count[beam] = by_range[first, 0] < math.inf, last - first + 1
            total, turn = 0.0, 0.0
            for k in range(first, last + 1):
                total, turn = total + by_range[k, 0], turn + by_range[k, 1]
            out_ranges[beam] = total / count[beam] if out_hit[beam] else max_range
            out_bearings[beam] = turn / count[beam]
    return out_ranges, out_bearings, out_hit, count


@compiled
def add_sweep(ranges: Array, bearings: Array, hit: Bools, sums: tuple[Array, Array, Array, Array], hits: Ints) -> None:
    """Adds a sweep (B,) to the sums of ranges and bearings, the least and the largest range, and the number of hits."""
    total, turn, low, high = sums
    for beam in range(ranges.shape[0]):
        r = ranges[beam]
        total[beam], turn[beam], hits[beam] = total[beam] + r, turn[beam] + bearings[beam], hits[beam] + hit[beam]
        low[beam], high[beam] = min(low[beam], r), max(high[beam], r)


@compiled
def sort_group(ranges: Array, bearings: Array, hit: Bools, beam: int, by_range: Array) -> None:
    """Fills by_range (K,2), nearest first: range (inf without a hit) and bearing of one beam of all sweeps (K,B)."""
    for k in range(by_range.shape[0]):
        distance = ranges[k, beam] if hit[k, beam] else math.inf
        at = k
        while at > 0 and by_range[at - 1, 0] > distance:
            by_range[at, 0], by_range[at, 1] = by_range[at - 1, 0], by_range[at - 1, 1]
            at -= 1
        by_range[at, 0], by_range[at, 1] = distance, bearings[k, beam]


@compiled
def main_group(by_range: Array, split: Split) -> tuple[int, int]:
    """First and last row of the largest group of rising ranges without a gap > allowed + slope * range."""
    first, last = 0, by_range.shape[0] - 1
    while True:
        cut, widest = -1, 0.0
        for k in range(first, last):
            if by_range[k, 0] == math.inf:
                break
            excess = by_range[k + 1, 0] - by_range[k, 0] * (1.0 + split.slope) - split.allowed
            if excess > widest:
                cut, widest = k, excess
        if cut < 0:
            return first, last
        if cut - first + 1 >= last - cut:
            last = cut
        else:
            first = cut + 1
