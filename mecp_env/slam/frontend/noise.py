"""The laser's noise as the kernels take it, and where an averaged beam stands after rolling to a gap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.config import SensorModel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
SMALLEST_RANGE_SIGMA_M = 1e-3  # an ideal laser still has rounding and corners that are not quite sharp


class Noise(NamedTuple):
    """Standard deviations of one raw beam."""

    range_m: float
    bearing: float  # rad


def noise_of(sensor: SensorModel) -> tuple[float, float]:
    """The fields of `Noise`, with a small floor so that a perfect laser has an invertible covariance.

    A plain pair, as is everything that Python hands to a kernel: numba takes twice as long to look into a named one.
    """
    return max(sensor.range_sigma_m, SMALLEST_RANGE_SIGMA_M), sensor.bearing_sigma_rad


@compiled
def roll_beams(ranges: Array, bearings: Array, count: Ints, roll: int) -> Array:
    """MergedScan from `roll` on as (3,B): range m, bearing rad rising through the wrap at pi, number of raw beams."""
    size = ranges.shape[0]
    polar = np.empty((3, size))
    for beam in range(roll, size):
        at = beam - roll
        polar[0, at], polar[1, at], polar[2, at] = ranges[beam], bearings[beam], count[beam]
    for beam in range(roll):
        at = beam + size - roll
        polar[0, at], polar[1, at], polar[2, at] = ranges[beam], bearings[beam] + 2.0 * np.pi, count[beam]
    return polar


@compiled
def roll_hits(hit: Bools, roll: int) -> Bools:
    """(B,) `hit` from beam `roll` on."""
    rolled = np.empty_like(hit)
    size = hit.shape[0]
    for beam in range(roll, size):
        rolled[beam - roll] = hit[beam]
    for beam in range(roll):
        rolled[beam + size - roll] = hit[beam]
    return rolled
