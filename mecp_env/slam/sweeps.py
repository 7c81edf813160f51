"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam a nominal bearing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import SensorModel
from mecp_env.slam.data import Beams, Scan
from mecp_env.slam.noise import Noise, noise_of

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
SPLIT_SIGMAS = 3.0  # two neighbouring ranges of one surface differ by less than this, and by
SPLIT_SLOPE = 4.0  # what a surface grazed at atan(4) = 76 degrees adds over the beams' bearings


class Group(NamedTuple):
    """The raw beams behind one averaged beam."""

    sweeps: int
    max_range: float  # m
    noise: Noise  # of one raw beam


def merge_sweeps(scan: Scan, sensor: SensorModel) -> Beams:
    """The B beams of `scan`, each averaged over the K raw beams around one nominal bearing.

    Where the K ranges belong to two surfaces, only the larger group counts (the nearer one of equal groups). Bearings
    are the means of the beams used. Differs from the paper: III-A.1 clusters the union of all sweeps; the average keeps
    the angular step of one sweep, which the adaptive threshold needs, and divides the noise by sqrt(K).
    """
    raw_ranges, raw_bearings, raw_hit = sort_beams(scan.ranges, scan.bearings, scan.hit)
    if len(scan.ranges) == 1:
        count = np.ones(len(raw_ranges), np.int64)
        return Beams(raw_ranges, raw_bearings, raw_hit, count, scan.max_range_m, raw_ranges, raw_bearings)
    group = Group(len(scan.ranges), scan.max_range_m, Noise(*noise_of(sensor)))
    averaged = average_beams(raw_ranges, raw_bearings, raw_hit, group)
    return Beams(*averaged, scan.max_range_m, raw_ranges, raw_bearings)


@kernel
def sort_beams(ranges: Array, bearings: Array, hit: Bools) -> tuple[Array, Array, Bools]:
    """All K*B raw beams in order of bearing: ranges, bearings, hit (insertion sort: interleaved is nearly sorted)."""
    sweeps, size = ranges.shape
    out_ranges, out_bearings = np.empty(sweeps * size), np.empty(sweeps * size)
    out_hit = np.empty(sweeps * size, np.bool_)
    at = 0
    for beam in range(size):
        for sweep in range(sweeps):
            out_ranges[at], out_bearings[at], out_hit[at] = ranges[sweep, beam], bearings[sweep, beam], hit[sweep, beam]
            at += 1
    for n in range(1, at):
        if out_bearings[n] < out_bearings[n - 1]:
            sink_beam(out_ranges, out_bearings, out_hit, n)
    return out_ranges, out_bearings, out_hit


@kernel
def sink_beam(ranges: Array, bearings: Array, hit: Bools, n: int) -> None:
    """Moves beam n down to its place among the sorted beams before it."""
    distance, bearing, did_hit = ranges[n], bearings[n], hit[n]
    while n > 0 and bearings[n - 1] > bearing:
        ranges[n], bearings[n], hit[n] = ranges[n - 1], bearings[n - 1], hit[n - 1]
        n -= 1
    ranges[n], bearings[n], hit[n] = distance, bearing, did_hit


@kernel
def average_beams(ranges: Array, bearings: Array, hit: Bools, group: Group) -> tuple[Array, Array, Bools, Ints]:
    """Ranges, bearings, hit and count (B,) of groups of raw beams (B*K,) that follow each other."""
    sweeps, size = group.sweeps, ranges.shape[0] // group.sweeps
    out_ranges, out_bearings = np.empty(size), np.empty(size)
    out_hit, count = np.empty(size, np.bool_), np.empty(size, np.int64)
    allowed = SPLIT_SIGMAS * group.noise.range_m
    slope = SPLIT_SLOPE * ((bearings[-1] - bearings[0]) / max(ranges.shape[0] - 1, 1) + group.noise.bearing)
    sorted_beams = np.empty((sweeps, 2))
    for beam in range(size):
        low, high, total, turn, hits = math.inf, 0.0, 0.0, 0.0, 0
        for raw in range(beam * sweeps, (beam + 1) * sweeps):
            low, high = min(low, ranges[raw]), max(high, ranges[raw])
            total, turn, hits = total + ranges[raw], turn + bearings[raw], hits + hit[raw]
        out_hit[beam], count[beam] = hits > 0, sweeps
        if hits not in (0, sweeps) or high - low > allowed + slope * low:
            sort_group(ranges, bearings, hit, beam * sweeps, sorted_beams)
            first, last = main_group(sorted_beams, allowed, slope)
            out_hit[beam], count[beam] = sorted_beams[first, 0] < math.inf, last - first + 1
            total, turn = 0.0, 0.0
            for k in range(first, last + 1):
                total, turn = total + sorted_beams[k, 0], turn + sorted_beams[k, 1]
        out_ranges[beam] = total / count[beam] if out_hit[beam] else group.max_range
        out_bearings[beam] = turn / count[beam]
    return out_ranges, out_bearings, out_hit, count


@kernel
def sort_group(ranges: Array, bearings: Array, hit: Bools, start: int, sorted_beams: Array) -> None:
    """Fills sorted_beams (K,2), nearest first: range (inf without a hit) and bearing of the beams from `start` on."""
    for k in range(sorted_beams.shape[0]):
        distance = ranges[start + k] if hit[start + k] else math.inf
        at = k
        while at > 0 and sorted_beams[at - 1, 0] > distance:
            sorted_beams[at, 0], sorted_beams[at, 1] = sorted_beams[at - 1, 0], sorted_beams[at - 1, 1]
            at -= 1
        sorted_beams[at, 0], sorted_beams[at, 1] = distance, bearings[start + k]


@kernel
def main_group(sorted_beams: Array, allowed: float, slope: float) -> tuple[int, int]:
    """First and last row of the largest group of rising ranges without a gap > allowed + slope * range."""
    first, last = 0, sorted_beams.shape[0] - 1
    while True:
        split, widest = -1, 0.0
        for k in range(first, last):
            if sorted_beams[k, 0] == math.inf:
                break
            excess = sorted_beams[k + 1, 0] - sorted_beams[k, 0] * (1.0 + slope) - allowed
            if excess > widest:
                split, widest = k, excess
        if split < 0:
            return first, last
        if split - first + 1 >= last - split:
            last = split
        else:
            first = split + 1
