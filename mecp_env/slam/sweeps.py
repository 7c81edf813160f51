"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam a nominal bearing."""

from __future__ import annotations

import math

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


def merge_sweeps(scan: Scan, sensor: SensorModel) -> Beams:
    """The B beams of `scan`, each averaged over the K raw beams around one nominal bearing.

    Where the K ranges belong to two surfaces, only the larger group counts (the nearer one of equal groups). Bearings
    are the means of the beams used. Differs from the paper: III-A.1 clusters the union of all sweeps; the average keeps
    the angular step of one sweep, which the adaptive threshold needs, and divides the noise by sqrt(K).
    """
    noise = noise_of(sensor)
    raw_ranges, raw_bearings, raw_hit = sort_beams(scan.ranges, scan.bearings, scan.hit)
    if len(scan.ranges) == 1:
        ranges, bearings, hit, count = raw_ranges, raw_bearings, raw_hit, np.ones(len(raw_ranges), np.int64)
    else:
        ranges, bearings, hit, count = average_beams(raw_ranges, raw_bearings, raw_hit, len(scan.ranges), noise)
        ranges[~hit] = scan.max_range_m
    return Beams(ranges, bearings, hit, count, scan.max_range_m, raw_ranges, raw_bearings)


@kernel
def sort_beams(ranges: Array, bearings: Array, hit: Bools) -> tuple[Array, Array, Bools]:
    """All K*B raw beams in order of bearing: ranges, bearings, hit (insertion sort: interleaved is nearly sorted)."""
    sweeps, size = ranges.shape
    total = sweeps * size
    out_ranges, out_bearings, out_hit = np.empty(total), np.empty(total), np.empty(total, np.bool_)
    for n in range(total):
        sweep, beam = n % sweeps, n // sweeps
        bearing = bearings[sweep, beam]
        at = n
        while at > 0 and out_bearings[at - 1] > bearing:
            out_ranges[at], out_bearings[at], out_hit[at] = out_ranges[at - 1], out_bearings[at - 1], out_hit[at - 1]
            at -= 1
        out_ranges[at], out_bearings[at], out_hit[at] = ranges[sweep, beam], bearing, hit[sweep, beam]
    return out_ranges, out_bearings, out_hit


@kernel
def average_beams(
    ranges: Array, bearings: Array, hit: Bools, sweeps: int, noise: Noise
) -> tuple[Array, Array, Bools, Ints]:
    """Ranges, bearings, hit and count (B,) of groups of `sweeps` raw beams (B*sweeps,) that follow each other."""
    size = ranges.shape[0] // sweeps
    out_ranges, out_bearings = np.empty(size), np.empty(size)
    out_hit, count = np.empty(size, np.bool_), np.empty(size, np.int64)
    step = (bearings[-1] - bearings[0]) / max(ranges.shape[0] - 1, 1)
    slope = SPLIT_SLOPE * (step + noise.bearing)
    sorted_ranges, sorted_bearings = np.empty(sweeps), np.empty(sweeps)
    for beam in range(size):
        for k in range(sweeps):
            raw = beam * sweeps + k
            distance = ranges[raw] if hit[raw] else math.inf
            at = k
            while at > 0 and sorted_ranges[at - 1] > distance:
                sorted_ranges[at], sorted_bearings[at] = sorted_ranges[at - 1], sorted_bearings[at - 1]
                at -= 1
            sorted_ranges[at], sorted_bearings[at] = distance, bearings[raw]
        first, last = main_group(sorted_ranges, SPLIT_SIGMAS * noise.range_m, slope)
        out_hit[beam] = sorted_ranges[first] < math.inf
        count[beam] = last - first + 1
        out_ranges[beam] = mean(sorted_ranges, first, last)
        out_bearings[beam] = mean(sorted_bearings, first, last)
    return out_ranges, out_bearings, out_hit, count


@kernel
def main_group(sorted_ranges: Array, allowed: float, slope: float) -> tuple[int, int]:
    """First and last index of the largest group of rising ranges without a gap > allowed + slope * range."""
    first, last = 0, sorted_ranges.shape[0] - 1
    while True:
        split, widest = -1, 0.0
        for k in range(first, last):
            if sorted_ranges[k] == math.inf:
                break
            excess = sorted_ranges[k + 1] - sorted_ranges[k] * (1.0 + slope) - allowed
            if excess > widest:
                split, widest = k, excess
        if split < 0:
            return first, last
        if split - first + 1 >= last - split:
            last = split
        else:
            first = split + 1


@kernel
def mean(values: Array, first: int, last: int) -> float:
    """Mean of values[first] to values[last], included."""
    total = 0.0
    for k in range(first, last + 1):
        total += values[k]
    return total / (last - first + 1)
