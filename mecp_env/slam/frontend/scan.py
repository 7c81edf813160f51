"""Dense scan (III-A.1): the interleaved sweeps of one burst become one beam per nominal bearing.

Beams that a real laser loses on dark or glancing walls: nothing returns, and yet the floor behind is not free.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.beams import Beams, Pieces, laser_noise, step_of

TINY_M = float(np.finfo(np.float32).eps)


@compiled
def merge_sweeps(ranges: Array, bearings: Array, hit: Bools, max_range: float, clustering: Rows, sensor: Rows) -> Beams:
    """The B beams of sweeps (K,B), each averaged over the K raw beams around one nominal bearing; or all K B beams.

    Where the K ranges belong to two surfaces, only the larger group counts (the nearer one of equal groups). Bearings
    are the means of the beams used. Differs from the paper: III-A.1 clusters the union of all sweeps (`is_union`); the
    average keeps the angular step of one sweep, which the adaptive threshold needs, and divides the noise by sqrt(K).
    """
    sweeps, size = ranges.shape
    if sweeps == 1:
        alone, turns = ranges[0].copy(), bearings[0].copy()
        return Beams(alone, turns, hit[0].copy(), np.ones(size, np.int64), max_range, alone, turns)
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
    if clustering[0].is_union:
        each, raw_hit = np.ones(sweeps * size, np.int64), np.ascontiguousarray(hit.T).reshape(-1)
        return Beams(raw_ranges, raw_bearings, raw_hit, each, max_range, raw_ranges, raw_bearings)
    noise = laser_noise(sensor)
    slope = sensor[0].merge_slope * (step_of(raw_bearings) + noise.bearing) + noise.gate * noise.share
    split = noise.gate * noise.range_m, slope
    mean_ranges, mean_bearings, any_hit, count = average_beams(ranges, bearings, hit, max_range, split)
    return Beams(mean_ranges, mean_bearings, any_hit, count, max_range, raw_ranges, raw_bearings)


@compiled
def restore_lost_beams(beams: Beams, sensor: Rows) -> Beams:
    """`beams` with those that a dark wall has swallowed, at the range of a straight wall between their neighbours.

    A run of them is short, and its neighbours are on one surface (`merge_slope`); a longer run may be an opening. For
    a laser that loses no beams nothing changes.
    """
    model, hits, size = sensor[0], np.flatnonzero(beams.hit), beams.ranges.shape[0]
    longest = longest_run(sensor)
    if longest == 0 or hits.shape[0] == 0 or hits.shape[0] == size:
        return beams
    ranges, hit = beams.ranges.copy(), beams.hit.copy()
    around = beams.bearings[0] + 2.0 * math.pi - beams.bearings[-1] <= 2.0 * step_of(beams.bearings)
    for k in range(hits.shape[0] if around else hits.shape[0] - 1):  # without a blind side the beams close a ring
        a, b = hits[k], hits[k + 1] if k + 1 < hits.shape[0] else hits[0] + size
        missing, near = b - a - 1, min(beams.ranges[a], beams.ranges[b % size])
        if not 0 < missing <= longest:
            continue
        start, turn = beams.bearings[a], beams.bearings[b % size] + 2.0 * math.pi * (b // size) - beams.bearings[a]
        sigma_m = max(model.range_sigma_m, model.range_sigma_share * near)
        allowed = model.merge_slope * turn * near + math.sqrt(2.0) * model.noise_sigmas * sigma_m
        if abs(beams.ranges[b % size] - beams.ranges[a]) > allowed:
            continue
        closeness = 1.0 / max(beams.ranges[a], TINY_M)  # along a straight wall 1 / range is nearly linear
        slope = (1.0 / max(beams.ranges[b % size], TINY_M) - closeness) / turn
        for beam in range(a + 1, b):
            bearing = beams.bearings[beam % size] + 2.0 * math.pi * (beam // size)
            ranges[beam % size], hit[beam % size] = 1.0 / (slope * (bearing - start) + closeness), True
    raw = ranges if beams.raw_ranges.shape[0] == size else beams.raw_ranges  # of one sweep they are the same beams
    return Beams(ranges, beams.bearings, hit, beams.counts, beams.max_range, raw, beams.raw_bearings)


@compiled
def longest_run(sensor: Rows) -> int:
    """As many beams in a row are lost on a dark wall by chance; more are not (`noise_sigmas`)."""
    if sensor[0].dark_dropout == 0.0:
        return 0
    return math.ceil(math.log(math.erfc(sensor[0].noise_sigmas / math.sqrt(2.0))) / math.log(sensor[0].dark_dropout))


@compiled
def stop_at_walls(beams: Beams, pieces: Pieces, sensor: Rows) -> Beams:
    """`beams` of which those without return end on the line of a wall that they would meet too slantingly to return.

    The wall may go on there unseen, so that the floor behind is not known to be free. Without an incidence beyond which
    beams are lost nothing changes.
    """
    model, line = sensor[0], pieces.line
    if model.grazing_deg >= 90.0 or beams.hit.all():
        return beams
    ranges, edge = beams.ranges.copy(), model.edge_beams * step_of(beams.bearings)
    for k in range(line.shape[0]):
        doubt = model.noise_sigmas * math.sqrt(pieces.cov[k, 0, 0])
        least = math.cos(model.grazing_rad - doubt - edge)
        for beam in range(ranges.shape[0]):
            cosine = math.cos(beams.bearings[beam] - line[k, 0])  # of the incidence on the line
            if not beams.hit[beam] and 0.0 < cosine < least:
                ranges[beam] = min(ranges[beam], line[k, 1] / cosine)
    return Beams(ranges, beams.bearings, beams.hit, beams.counts, beams.max_range, beams.raw_ranges, beams.raw_bearings)


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
