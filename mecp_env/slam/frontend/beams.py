"""What the stages of the front end pass on, as compiled functions take it, and the laser's noise.

`Beams`, `BeamRuns` and `Pieces` have the fields of `MergedScan`, `Clusters` and `Segments` in their order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import MergedScan

Records = Any  # a structured array


class Beams(NamedTuple):
    """One beam per nominal bearing, as in `MergedScan`."""

    ranges: Array  # (B,) m
    bearings: Array  # (B,) rad
    hit: Bools  # (B,)
    counts: Ints  # (B,) numbers of raw beams
    max_range: float  # m
    raw_ranges: Array  # (K*B,) m
    raw_bearings: Array  # (K*B,) rad

    @classmethod
    def of(cls, scan: MergedScan) -> Beams:
        """The beams of a scan."""
        raw = scan.max_range_m, scan.raw_ranges, scan.raw_bearings
        return cls(scan.ranges, scan.bearings, scan.hit, scan.count, *raw)


class BeamRuns(NamedTuple):
    """Runs of beams that may be on one structure, as in `Clusters`."""

    roll: int
    first: Ints  # (C,)
    last: Ints  # (C,)
    kind: Ints  # (C,)


class Pieces(NamedTuple):
    """Straight pieces of wall, as in `Segments`."""

    points: Array  # (L,2,2) m
    line: Array  # (L,2)
    cov: Array  # (L,2,2)
    cluster: Ints  # (L,)
    first: Ints  # (L,)
    last: Ints  # (L,)
    roll: int


@compiled
def step_of(bearings: Array) -> float:
    """The spacing of bearings (B,), rad."""
    return float((bearings[-1] - bearings[0]) / max(bearings.shape[0] - 1, 1))


class Noise(NamedTuple):
    """The noise of one raw beam, and what counts as noise."""

    range_m: float  # standard deviation, or
    share: float  # this share of the range, whichever is larger
    bearing: float  # rad, standard deviation
    gate: float  # `noise_sigmas`
    outlier: float  # `outlier_sigmas`
    least_cosine: float
    edge: int  # `edge_beams`
    face_gain: float
    grazing: float  # rad, incidence beyond which no beam returns; pi: each does


@compiled
def laser_noise(sensor: Rows) -> Noise:
    """The noise of `SensorModel.record`; a perfect laser gets a small range sigma."""
    model = sensor[0]
    range_m = max(model.range_sigma_m, model.least_range_sigma_m)
    gates, edge = (model.noise_sigmas, model.outlier_sigmas), (model.least_cosine, model.edge_beams, model.face_gain)
    grazing = model.grazing_rad if model.grazing_deg < 90.0 else np.pi
    return Noise(range_m, model.range_sigma_share, model.bearing_sigma_rad, *gates, *edge, grazing)


@compiled
def roll_beams(beams: Beams, roll: int) -> Array:
    """(3,B) from beam `roll` on: range m, bearing rad rising through the wrap at pi, number of raw beams."""
    ranges, bearings, count = beams.ranges, beams.bearings, beams.counts
    size = ranges.shape[0]
    polar = np.empty((3, size))
    for beam in range(roll, size):
        at = beam - roll
        polar[0, at], polar[1, at], polar[2, at] = ranges[beam], bearings[beam], count[beam]
    for beam in range(roll):
        at = beam + size - roll
        polar[0, at], polar[1, at], polar[2, at] = ranges[beam], bearings[beam] + 2.0 * np.pi, count[beam]
    return polar


class RolledScan(NamedTuple):
    """The beams of a scan from a gap on, and the raw beams behind them."""

    polar: Array  # (3,B) m, rad, number of raw beams
    hit: Bools  # (B,)
    raw_ranges: Array  # (K*B,) m
    raw_bearings: Array  # (K*B,) rad
    roll: int
    step: float  # rad, between two beams
    max_range: float  # m


class Lines(NamedTuple):
    """The segments, as in `Segments`, and how long they are."""

    line: Array  # (L,2)
    cov: Array  # (L,2,2)
    cluster: Ints  # (L,)
    first: Ints  # (L,)
    last: Ints  # (L,)
    length: Array  # (L,) m
