"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam per nominal bearing.

Beams that a real laser loses on dark or glancing walls: nothing returns, and yet the floor behind is not free.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.sensors import Scan
from mecp_env.slam.config import SensorModel
from mecp_env.slam.frontend.beams import laser_noise
from mecp_env.slam.messages import MergedScan, Segments


def restore_lost_beams(beams: MergedScan, sensor: SensorModel) -> MergedScan:
    """`beams` with those that a dark wall has swallowed, at the range of a straight wall between their neighbours.

    A run of them is short, and its neighbours are on one surface (`merge_slope`); a longer run may be an opening. For
    a laser that loses no beams nothing changes.
    """
    longest = longest_run(sensor)
    if longest == 0 or beams.hit.all() or not beams.hit.any():
        return beams
    hits, bearings, ranges = _ring_of_hits(beams)
    missing, near = np.diff(hits) - 1, np.minimum(ranges[:-1], ranges[1:])
    sigma_m = np.maximum(sensor.range_sigma_m, sensor.range_sigma_share * near)
    allowed = sensor.merge_slope * np.diff(bearings) * near + math.sqrt(2.0) * sensor.noise_sigmas * sigma_m
    alike = (missing > 0) & (missing <= longest) & (np.abs(np.diff(ranges)) <= allowed)
    lost = [beam for k in np.flatnonzero(alike) for beam in range(hits[k] + 1, hits[k + 1])]
    return _restored(beams, np.array(lost, np.int64), bearings, ranges)


def longest_run(sensor: SensorModel) -> int:
    """As many beams in a row are lost on a dark wall by chance; more are not (`noise_sigmas`)."""
    if sensor.dark_dropout == 0.0:
        return 0
    return math.ceil(math.log(math.erfc(sensor.noise_sigmas / math.sqrt(2.0))) / math.log(sensor.dark_dropout))


def _ring_of_hits(beams: MergedScan) -> tuple[Ints, Array, Array]:
    """Beam, bearing (rad, rising) and range (m) of all hits; without a blind side the first one again at the end."""
    size, hits = len(beams.ranges), np.flatnonzero(beams.hit)
    if not beams.blind:
        hits = np.append(hits, hits[0] + size)
    return hits, _bearings(beams, hits), beams.ranges[hits % size]


def _bearings(beams: MergedScan, ring: Ints) -> Array:
    size = len(beams.ranges)
    bearings: Array = beams.bearings[ring % size] + 2.0 * math.pi * (ring // size)
    return bearings


def _restored(beams: MergedScan, lost: Ints, bearings: Array, ranges: Array) -> MergedScan:
    """`beams` with a range for those that were lost; along a straight wall 1 / range is nearly linear."""
    closeness = np.interp(_bearings(beams, lost), bearings, 1.0 / np.maximum(ranges, np.finfo(np.float32).eps))
    filled, hit, at = beams.ranges.copy(), beams.hit.copy(), lost % len(beams.ranges)
    filled[at], hit[at] = 1.0 / closeness, True
    raw = filled if len(beams.raw_ranges) == len(filled) else beams.raw_ranges  # of one sweep they are the same beams
    return replace(beams, ranges=filled, hit=hit, raw_ranges=raw)


def stop_at_walls(beams: MergedScan, segments: Segments, sensor: SensorModel) -> MergedScan:
    """`beams` of which those without return end on the line of a wall that they would meet too slantingly to return.

    The wall may go on there unseen, so that the floor behind is not known to be free. Without an incidence beyond which
    beams are lost nothing changes.
    """
    if sensor.grazing_deg >= 90.0 or not len(segments.line):
        return beams
    silent = np.flatnonzero(~beams.hit)
    if not len(silent):
        return beams
    (alpha, rho), doubt = segments.line.T[:, :, None], np.sqrt(segments.cov[:, 0, 0])[:, None]
    cosine = np.cos(beams.bearings[silent] - alpha)  # of the incidence on each line
    steepest = math.radians(sensor.grazing_deg) - sensor.noise_sigmas * doubt - sensor.edge_beams * beams.step
    with np.errstate(divide="ignore"):
        reach = np.where((cosine > 0.0) & (cosine < np.cos(steepest)), rho / cosine, math.inf).min(axis=0)
    ranges = beams.ranges.copy()
    ranges[silent] = np.minimum(ranges[silent], reach)
    return replace(beams, ranges=ranges)


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
