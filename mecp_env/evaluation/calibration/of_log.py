"""Calibration of a recorded log, and of a stream of scans and odometry."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mecp_env.core.errors import SensorError
from mecp_env.core.messages import Scan
from mecp_env.evaluation.calibration.models import NOISE, Calibration, Estimate, calibrated, uncalibrated
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import OdometryModel
from mecp_env.slam.checks import check_scan
from mecp_env.slam.config import SensorModel, SlamConfig
from mecp_env.world.config import OdometryConfig

UNIFORM = math.sqrt(12.0)  # a beam looks anywhere within its step: the standard deviation is step / sqrt(12)
RANGE_SIGMA_M = 0.02  # of a SICK LMS-200 and its successors
CORRECTIONS = ("distance_scale", "turn_scale", "turn_bias_deg_per_m")
BOTH = frozenset({"preset", "turn_m"})  # fields that give the noise of distance and turn


def calibrate(
    scans: Sequence[Scan], odometry: Any, sensor: SensorModel | Mapping[str, Any] | None = None
) -> Calibration:
    """Sensor and odometry models of a robot, from its own scans and the poses by its odometry: no truth is needed.

    `scans`: n scans in order, the estimator's `Scan` (ranges and bearings (K,B) m, rad). `odometry`: (n,3) m, rad,
    x, y and heading of the robot at each scan, in any fixed frame. `sensor`: what is known of the laser, fields of
    `SensorModel` or a whole one; by default it sits at the robot's centre and looks ahead.

    The result has `.sensor` (a `SensorModel` with range noise, forward offset and heading of the laser), `.odometry`
    (an `OdometryModel`, whose `between(T_before, T_after)` gives the corrected `Odometry` of a step), `.estimates`
    of every field, and `.notes`, which name each default that is used because the scans do not tell the value, as in
    the dark, along a single wall, or with too few scans.

    Raises `SensorError` for an invalid scan, odometry of another shape or that is not finite, odometry that never moves
    or jumps by more than 5 m, and `ConfigError` for an unknown field of the sensor.

    The laser's motion is that of registered scans (point to line, Censi 2008), a hand-eye equation gives mounting,
    scale and bias, and robust variances the noise (docs/calibration.md).
    """
    poses = np.asarray(odometry, np.float64)
    if poses.shape != (len(scans), 3) or len(scans) < 2:
        raise SensorError(f"odometry: shape {poses.shape}, ({len(scans)}, 3) expected, one pose per scan, at least 2")
    if not np.isfinite(poses).all():
        row = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise SensorError(f"odometry[{row}]: not finite")
    for scan in scans:
        check_scan(scan)
    return calibrated(scans.__getitem__, poses, SlamConfig(sensor=_described(scans[0], sensor)))


def _described(scan: Scan, sensor: SensorModel | Mapping[str, Any] | None) -> SensorModel:
    """A laser by one of its scans, but for what is known of it."""
    if isinstance(sensor, SensorModel):
        return sensor
    bearings = scan.bearings[0]
    view = min(360.0, 2.0 * math.degrees(float(abs(bearings[[0, -1]]).max())) + 1e-9)
    step = float(bearings[-1] - bearings[0]) / max(len(bearings) - 1, 1)
    sigmas = {"range_sigma_m": RANGE_SIGMA_M, "bearing_sigma_deg": math.degrees(step) / UNIFORM}
    return SensorModel.parse({"field_of_view_deg": max(10.0, view), **sigmas, **(sensor or {})})


def calibrate_log(
    log: Log, config: SlamConfig, given: Mapping[str, float], noise: Mapping[str, Any], fault: str | None = None
) -> Calibration:
    """That of a log with odometry. Its reference path is not read.

    `config` describes the laser; `given` are values of `calibration.FIELDS` that are kept; `noise` are fields of
    `OdometryConfig` and corrections of `OdometryModel` that win over what is found. With a `fault` of the laser, as
    `laser_fault` says it, the defaults are used.
    """
    kept, poses = {**given, **given_noise(noise)}, log.T_odom_robot
    assert poses is not None
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    try:
        if fault is not None:
            raise SensorError(fault)
        found = calibrated(lambda row: log.scan(int(known[row])), poses[known], config, kept)
    except SensorError as error:
        found = uncalibrated(config.sensor, kept, str(error))
    return scaled(found, float(noise.get("scale", 1.0)), frozenset(kept))


def given_noise(noise: Mapping[str, Any]) -> dict[str, float]:
    """Fields of `OdometryModel` by fields of `OdometryConfig`, as far as these say; scales are left as they are."""
    fields = {name: float(noise[name]) for name in CORRECTIONS if name in noise}
    config = {name: value for name, value in noise.items() if name not in (*CORRECTIONS, "scale")}
    model = OdometryModel.of_noise(OdometryConfig(**config, scale=noise.get("scale", 1.0)))
    for names, one in ((NOISE[:2], "distance_sigma_m"), (NOISE[2:], "turn_sigma_deg")):
        if one in config or BOTH & config.keys():
            fields |= {name: getattr(model, name) for name in names}
    return fields


def scaled(calibration: Calibration, scale: float, kept: frozenset[str]) -> Calibration:
    """The calibration with another scale of those sigmas of the odometry that are not `kept`."""
    names = [name for name in NOISE if name not in kept] if scale != 1.0 else []
    sigmas = {name: scale * getattr(calibration.odometry, name) for name in names}
    estimates = {name: Estimate(value, None, "given") for name, value in sigmas.items()}
    odometry = OdometryModel(**calibration.odometry.model_dump() | sigmas)
    return replace(calibration, odometry=odometry, estimates={**calibration.estimates, **estimates})
