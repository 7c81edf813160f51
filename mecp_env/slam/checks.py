"""What a scan and an odometry reading must be, so that a damaged log is refused before it touches the map."""

from __future__ import annotations

import numpy as np

from mecp_env.errors import MecpError
from mecp_env.slam.data import Array, Odometry, Scan


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
    _check_finite("scan.ranges", scan.ranges)
    _check_finite("scan.bearings", scan.bearings)
    if not (scan.ranges.min() >= 0.0 and scan.ranges.max() <= scan.max_range_m < np.inf):
        low, high = float(scan.ranges.min()), float(scan.ranges.max())
        raise SensorError(f"scan.ranges: {low:g} to {high:g} m is not within 0 to max_range_m = {scan.max_range_m:g} m")
    if not (np.diff(scan.bearings, axis=1) > 0.0).all() or abs(scan.bearings).max() > np.pi:
        raise SensorError("scan.bearings: not ascending in (-pi, pi] in every sweep")


def check_odometry(odometry: Odometry) -> None:
    """Raise `SensorError` unless the reading is M increments with finite, non-negative variances."""
    shape = np.shape(odometry.increments)
    if len(shape) != 2 or shape[1] != 2:
        raise SensorError(f"odometry.increments: shape {shape} is not (M, 2)")
    if np.shape(odometry.cov) != (shape[0], 2, 2):
        raise SensorError(f"odometry.cov: shape {np.shape(odometry.cov)} is not {(shape[0], 2, 2)}")
    _check_finite("odometry.increments", odometry.increments)
    _check_finite("odometry.cov", odometry.cov)
    variances = odometry.cov[:, (0, 1), (0, 1)]
    if variances.size and variances.min() < 0.0:
        raise SensorError(f"odometry.cov: variance {float(variances.min()):g} is below 0")


def _check_finite(name: str, values: Array) -> None:
    if not np.isfinite(values).all():
        raise SensorError(f"{name}: every value must be finite")
