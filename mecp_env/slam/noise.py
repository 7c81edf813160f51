"""The laser's noise as the kernels take it, and where an averaged beam stands after rolling to a gap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import SensorModel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
SMALLEST_RANGE_SIGMA_M = 1e-3  # an ideal laser still has rounding and corners that are not quite sharp


class Noise(NamedTuple):
    """Standard deviations of one raw beam."""

    range_m: float
    bearing: float  # rad


def noise_of(sensor: SensorModel) -> Noise:
    """The noise of `sensor`, with a small floor so that a perfect laser has an invertible covariance."""
    return Noise(max(sensor.range_sigma_m, SMALLEST_RANGE_SIGMA_M), sensor.bearing_sigma_rad)


@kernel
def roll_beams(ranges: Array, bearings: Array, count: Ints, roll: int) -> Array:
    """Beams from `roll` on as (B,3): range m, bearing rad rising through the wrap at pi, number of raw beams."""
    size = ranges.shape[0]
    polar = np.empty((size, 3))
    for position in range(size):
        beam = position + roll
        turn = 0.0
        if beam >= size:
            beam -= size
            turn = 2.0 * np.pi
        polar[position, 0] = ranges[beam]
        polar[position, 1] = bearings[beam] + turn
        polar[position, 2] = count[beam]
    return polar


@kernel
def roll_hits(hit: Bools, roll: int) -> Bools:
    """(B,) `hit` from beam `roll` on."""
    rolled = np.empty_like(hit)
    size = hit.shape[0]
    rolled[: size - roll] = hit[roll:]
    rolled[size - roll :] = hit[:roll]
    return rolled
