"""Beams that a real laser loses on dark or glancing walls: nothing returns, and yet the floor behind is not free."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.slam.config import SensorModel
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
