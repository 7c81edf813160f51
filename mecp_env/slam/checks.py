"""What a scan and an odometry reading must be, so that a damaged log is refused before it touches the map."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.errors import MecpError
from mecp_env.kernel import kernel
from mecp_env.slam.data import Array, Odometry, Scan

SOUND, NOT_FINITE, OUT_OF_RANGE, OUT_OF_ORDER = 0, 1, 2, 3


class SensorError(MecpError):
    """A scan or an odometry reading of the wrong shape, not finite, or out of its bounds."""


def check_scan(scan: Scan) -> None:
    """Raise `SensorError` unless the scan is K sweeps of B beams, finite, within range and in order of bearing."""
    shape = np.shape(scan.ranges)
    if len(shape) != 2 or 0 in shape:
        raise SensorError(f"scan.ranges: shape {shape} is not (K, B) with K, B >= 1")
    for name in ("bearings", "hit"):
        given = np.shape(getattr(scan, name))
        if given != shape:
            raise SensorError(f"scan.{name}: shape {given} is not that of the ranges, {shape}")
    fault = find_fault(np.asarray(scan.ranges, float), np.asarray(scan.bearings, float), float(scan.max_range_m))
    if fault == NOT_FINITE:
        raise SensorError("scan.ranges, scan.bearings: every value must be finite")
    if fault == OUT_OF_RANGE:
        low, high = float(np.min(scan.ranges)), float(np.max(scan.ranges))
        raise SensorError(f"scan.ranges: {low:g} to {high:g} m is not within 0 to max_range_m = {scan.max_range_m:g} m")
    if fault == OUT_OF_ORDER:
        raise SensorError("scan.bearings: not ascending in (-pi, pi] in every sweep")


@kernel
def find_fault(ranges: Array, bearings: Array, max_range: float) -> int:
    """What is wrong with ranges and bearings (K,B), or SOUND."""
    unsound = 0
    for k in range(ranges.shape[0]):
        unsound += count_unsound(ranges[k], bearings[k, :-1], bearings[k, 1:], max_range)
        unsound += not (bearings[k, 0] >= -math.pi and bearings[k, -1] <= math.pi)
    return SOUND if unsound == 0 and max_range < math.inf else name_fault(ranges, bearings, max_range)


@kernel
def count_unsound(ranges: Array, bearings: Array, next_bearings: Array, max_range: float) -> int:
    """How many ranges (B,) are out of range, and bearings (B-1,) not below the next; nan is.

    Without a branch, so that the compiler takes several at a time.
    """
    unsound = 0
    for b in range(ranges.shape[0]):
        unsound += not ((ranges[b] >= 0.0) & (ranges[b] <= max_range))
    for b in range(bearings.shape[0]):
        unsound += not bearings[b] < next_bearings[b]
    return unsound


@kernel
def name_fault(ranges: Array, bearings: Array, max_range: float) -> int:
    """The first fault in the order of the beams, or SOUND."""
    for k in range(ranges.shape[0]):
        last = -math.inf
        for b in range(ranges.shape[1]):
            r, bearing = ranges[k, b], bearings[k, b]
            if not (math.isfinite(r) and math.isfinite(bearing)):
                return NOT_FINITE
            if r < 0.0 or r > max_range:
                return OUT_OF_RANGE
            if bearing <= last or bearing > math.pi or bearing < -math.pi:
                return OUT_OF_ORDER
            last = bearing
    return SOUND


def check_odometry(odometry: Odometry) -> None:
    """Raise `SensorError` unless the reading is M increments with finite, non-negative variances."""
    shape = np.shape(odometry.increments)
    if len(shape) != 2 or shape[1] != 2:
        raise SensorError(f"odometry.increments: shape {shape} is not (M, 2)")
    if np.shape(odometry.cov) != (shape[0], 2, 2):
        raise SensorError(f"odometry.cov: shape {np.shape(odometry.cov)} is not {(shape[0], 2, 2)}")
    finite, least = look_over(np.asarray(odometry.increments, float), np.asarray(odometry.cov, float))
    if not finite:
        raise SensorError("odometry.increments, odometry.cov: every value must be finite")
    if least < 0.0:
        raise SensorError(f"odometry.cov: variance {least:g} is below 0")


@kernel
def look_over(increments: Array, cov: Array) -> tuple[bool, float]:
    """Whether increments (M,2) and covariances (M,2,2) are finite, and the least variance, at most 0."""
    finite, least = True, 0.0
    for m in range(cov.shape[0]):
        for i in range(2):
            finite &= math.isfinite(increments[m, i]) & math.isfinite(cov[m, i, 0]) & math.isfinite(cov[m, i, 1])
            least = min(least, cov[m, i, i])
    return finite, least
