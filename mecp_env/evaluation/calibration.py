"""Calibration of a robot by its own scans and odometry: the models that the estimator takes, and their sources.

Calibration of a recorded log, and of a stream of scans and odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import ConfigError, SensorError
from mecp_env.core.se2 import between
from mecp_env.core.sensors import Scan
from mecp_env.evaluation.scan_motions import (
    ALONG,
    NAMES,
    NOTHING,
    SPREAD,
    TURN,
    Motions,
    Residuals,
    Systematic,
    fitted,
    noise_of,
    range_noise,
    registered_motions,
    residuals,
    slip_as_turn,
    told,
    with_tails,
)
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import OdometryModel
from mecp_env.slam.checks import check_scan
from mecp_env.slam.config import SensorModel, SlamConfig
from mecp_env.world.config import OdometryConfig

LEAST_MOTIONS = 30  # that are registered and tell the motion; with fewer, defaults are used
UNKNOWN_SHARE = 0.5  # of the spread that is expected: a value with a larger sigma keeps its default
JUMP_M = 5.0  # no robot moves so far from one scan to the next
LEAST = {ALONG: 0.005, TURN: 0.1}  # sigmas per square root of a metre, m and deg: no odometry of wheels is better
COARSE = 2.0  # times the range noise of the description: from there on that which is measured is taken. It is that of
# single beams on straight walls; the description also stands for walls that are not straight
UNITS = np.array([1.0, 1.0, math.radians(1.0), 1.0, math.radians(1.0)])  # of `NAMES`, as fields have them
NOISE = ("distance_sigma_m", "distance_sigma_turning_m", "turn_sigma_deg", "turn_sigma_turning_deg")
FIELDS = (*NAMES, *NOISE, "range_sigma_m")  # that are calibrated
OF_SENSOR = frozenset({"x_m", "heading_deg", "range_sigma_m"})


@dataclass(frozen=True, slots=True)
class Estimate:
    """The value of a field, and where it is from."""

    value: float
    sigma: float | None  # None where there is none
    source: Literal["estimated", "default", "given"]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a log says of its robot."""

    sensor: SensorModel
    odometry: OdometryModel
    estimates: Mapping[str, Estimate]  # of each of `FIELDS`
    registered: int  # motions between scans that were registered,
    tried: int  # of so many
    range_noise_m: float | None  # of beams on straight walls, as measured
    notes: tuple[str, ...] = ()  # which fields keep their defaults, and why

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `metrics.json`."""
        fields = {name: asdict(estimate) for name, estimate in self.estimates.items()}
        counts = {"registered": self.registered, "tried": self.tried, "range_noise_m": self.range_noise_m}
        return {"fields": fields, **counts, "notes": list(self.notes)}


def calibrated(
    scan_at: Callable[[int], Scan], T_odom_robot: Array, config: SlamConfig, given: Mapping[str, float] | None = None
) -> Calibration:
    """The models by the scans of rows, which `scan_at` gives, and odometry poses (n,3) m, rad.

    `config` describes the laser as far as it is known, `given` are values of `FIELDS` that are kept. Raises
    `SensorError` for odometry that never moves, or jumps.
    """
    check_path(T_odom_robot)
    kept, noise_m = dict(given or {}), range_noise(scan_at, len(T_odom_robot), config)
    laser = _laser(noise_m, config.sensor) | _kept({name: kept[name] for name in kept if name in OF_SENSOR})
    known = config.sensor.model_copy(update={name: estimate.value for name, estimate in laser.items()})
    motions = registered_motions(scan_at, T_odom_robot, config.model_copy(update={"sensor": known}))
    try:
        estimates = _defaults(config.sensor) | laser | _estimates(motions, known.T_robot_laser, kept) | _kept(kept)
        return _models(estimates, motions, config.sensor, noise_m)
    except ConfigError as error:
        return uncalibrated(config.sensor, kept, f"scans and odometry contradict each other ({error})")


def check_path(T_odom_robot: Array) -> None:
    """Raise `SensorError` for odometry (n,3) that never moves, or jumps."""
    steps = between(T_odom_robot[:-1], T_odom_robot[1:])
    metres = np.hypot(steps[:, 0], steps[:, 1])
    if not (len(steps) and (metres.any() or steps[:, 2].any())):
        raise SensorError(f"odometry: never moves in {len(T_odom_robot)} scans")
    if metres.max() > JUMP_M:
        row = int(metres.argmax()) + 1
        raise SensorError(f"odometry[{row}]: jumps by {metres.max():.2f} m, at most {JUMP_M:g} expected")


def uncalibrated(sensor: SensorModel, given: Mapping[str, float], reason: str) -> Calibration:
    """The defaults, for a `reason` that is said."""
    nothing = Motions(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)), 1.0, 0, 1)
    calibration = _models(_defaults(sensor) | _kept(given), nothing, sensor, math.nan)
    named = ", ".join(f"{name} {e.value:g}" for name, e in calibration.estimates.items() if e.source == "default")
    return replace(calibration, notes=(f"calibration: {reason}; defaults are used: {named}",))


def _defaults(sensor: SensorModel) -> dict[str, Estimate]:
    values = OdometryModel().model_dump() | sensor.model_dump()
    return {name: Estimate(values[name], None, "default") for name in FIELDS}


def _kept(given: Mapping[str, float]) -> dict[str, Estimate]:
    return {name: Estimate(value, None, "given") for name, value in given.items()}


def _laser(noise_m: float, sensor: SensorModel) -> dict[str, Estimate]:
    """The range noise, where it is larger than by the description of the laser; nan is not."""
    coarse = noise_m > COARSE * sensor.range_sigma_m
    return {"range_sigma_m": Estimate(noise_m, None, "estimated")} if coarse else {}


def _estimates(motions: Motions, T_robot_laser: Array, given: Mapping[str, float]) -> dict[str, Estimate]:
    """What the motions tell of odometry and mounting, of a laser at T_robot_laser (3,) as described."""
    if len(motions) < LEAST_MOTIONS:
        return {}
    systematic = fitted(motions, T_robot_laser, *_start(given))
    left = residuals(motions, systematic.values, T_robot_laser)
    return _systematic(systematic, T_robot_laser) | _noise(left)


def _start(given: Mapping[str, float]) -> tuple[Array, Ints]:
    """(5,) the values to start from, relative to the described mounting, and which of them are free."""
    start = NOTHING.copy()
    for i, name in enumerate(NAMES[:3]):
        start[i] = given.get(name, start[i] / UNITS[i]) * UNITS[i]
    return start, np.array([i for i, name in enumerate(NAMES) if name not in given], np.int64)


def _systematic(found: Systematic, described: Array) -> dict[str, Estimate]:
    """The estimates of scale, bias and mounting that the motions tell."""
    values = found.values + np.array([0.0, 0.0, 0.0, described[0], described[2]])
    values[-1] = math.remainder(float(values[-1]), 2.0 * math.pi)  # of a laser that looks backwards, about half a turn
    values, sigmas = values / UNITS, found.sigmas / UNITS
    known = np.flatnonzero(found.sigmas < UNKNOWN_SHARE * SPREAD)
    return {NAMES[i]: Estimate(float(values[i]), float(sigmas[i]), "estimated") for i in known}


def _noise(left: Residuals) -> dict[str, Estimate]:
    """The estimates of the noise of distance and turn, each where enough motions tell it."""
    found = dict[str, Estimate]()
    for component, names, rows in zip((ALONG, TURN), (NOISE[:2], NOISE[2:]), told(left), strict=True):
        if rows.sum() < LEAST_MOTIONS:
            continue
        some = left.of(rows)
        noise = with_tails(some, noise_of(some))
        slip = slip_as_turn(some, noise) if component == TURN else 0.0
        sigmas = np.sqrt(noise[component] + [slip, 0.0])
        sigmas = np.maximum(np.degrees(sigmas) if component == TURN else sigmas, [LEAST[component], 0.0])
        found |= {name: Estimate(value, None, "estimated") for name, value in zip(names, sigmas.tolist(), strict=True)}
    return found


def _models(estimates: Mapping[str, Estimate], motions: Motions, sensor: SensorModel, noise_m: float) -> Calibration:
    """The models of the estimates, with a note of the fields that keep their defaults."""
    values = {name: estimate.value for name, estimate in estimates.items()}
    odometry = OdometryModel(**{name: value for name, value in values.items() if name not in OF_SENSOR})
    laser = SensorModel(**sensor.model_dump() | {name: values[name] for name in OF_SENSOR})
    measured = None if math.isnan(noise_m) else noise_m
    counts = len(motions), motions.tried, measured
    return Calibration(laser, odometry, estimates, *counts, _notes(estimates, motions, measured))


def _notes(estimates: Mapping[str, Estimate], motions: Motions, noise_m: float | None) -> tuple[str, ...]:
    """A note of the fields that keep their defaults, with the reason; the range noise may be measured and small."""
    told = set() if noise_m is None else {"range_sigma_m"}
    unknown = [name for name, estimate in estimates.items() if estimate.source == "default" and name not in told]
    if not unknown:
        return ()
    reason = f"{len(motions)} of {motions.tried} motions between scans are registered"
    few = f", at least {LEAST_MOTIONS} needed" if len(motions) < LEAST_MOTIONS else ""
    named = ", ".join(f"{name} {estimates[name].value:g}" for name in unknown)
    return (f"calibration: {reason}{few}; they do not tell these, whose defaults are used: {named}",)


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
