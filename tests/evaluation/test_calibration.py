"""Calibration: known errors of odometry and laser are found, what scans do not tell keeps its default, by name."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mecp_env
from mecp_env.core.errors import ConfigError, SensorError
from mecp_env.evaluation.calibration import FIELDS, Calibration, calibrate_log
from mecp_env.evaluation.log_run import config_for, run_log
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import OdometryModel, measured
from mecp_env.world.config import OdometryConfig
from tests.logs.calibrated import simulated_log

OFF = {"distance_scale": 1.02, "turn_scale": 0.98, "turn_bias_deg_per_m": 1.5}
BEARINGS = np.radians(np.linspace(-90.0, 90.0, 181))


def odometry_of(noise: float) -> OdometryModel:
    return OdometryModel.of_noise(OdometryConfig(scale=noise), **OFF)


def calibration_of(log: Log, given: dict[str, float] | None = None, **noise: float) -> Calibration:
    return calibrate_log(log, config_for(log), given or {}, noise)


@pytest.fixture(scope="module")
def log() -> Log:
    return simulated_log(odometry_of(1.0))


@pytest.fixture(scope="module")
def found(log: Log) -> Calibration:
    return calibration_of(log)


@pytest.mark.parametrize("noise", [0.3, 1.0, 5.0])
def test_known_errors_are_found(noise: float) -> None:
    true = odometry_of(noise)
    found = calibration_of(simulated_log(true, seed=3))
    for name, value in {**OFF, "x_m": 0.08, "heading_deg": 0.0}.items():
        estimate = found.estimates[name]
        assert estimate.source == "default" or abs(estimate.value - value) < 3.5 * estimate.sigma
    for name, sigma in {"distance_scale": 0.03, "turn_scale": 0.01, "turn_bias_deg_per_m": 0.3, "x_m": 0.01}.items():
        estimate = found.estimates[name]
        assert (estimate.sigma or 1.0) < 0.01 + sigma * noise or noise > 1.0
    for motion in ((0.5, 0.0), (0.4, math.radians(20.0))):
        ratio = found.odometry.sigmas(*motion) / true.sigmas(*motion)
        assert (ratio > 0.75).all()
        assert (ratio < 1.6).all()
    assert found.range_noise_m == pytest.approx(0.02, rel=0.1)


def test_a_noisy_laser_is_noticed() -> None:
    found = calibration_of(simulated_log(odometry_of(1.0), range_sigma_m=0.06, scans=300))
    assert found.estimates["range_sigma_m"].source == "estimated"
    assert found.sensor.range_sigma_m == pytest.approx(0.06, rel=0.1)


def test_scans_at_rest_and_close_to_each_other_change_little(log: Log, found: Calibration) -> None:
    rows = np.repeat(np.arange(len(log)), 5)
    taken = {"ranges": log.ranges[rows], "T_odom_robot": log.T_odom_robot[rows], "T_ref_robot": None}
    assert calibration_of(replace(log, t=np.arange(5.0 * len(log)), **taken)).odometry == found.odometry
    slow = calibration_of(simulated_log(odometry_of(1.0), step_m=0.03, scans=2500))
    assert slow.tried > 60
    assert slow.sensor.x_m == pytest.approx(0.08, abs=0.012)
    assert slow.odometry.distance_scale == pytest.approx(1.02, abs=0.05)


def test_the_reference_is_not_read(log: Log, found: Calibration) -> None:
    assert log.T_ref_robot is not None
    for reference in (None, log.T_ref_robot[::-1] + 5.0):
        assert calibration_of(replace(log, T_ref_robot=reference)).estimates == found.estimates


def test_a_stream_is_calibrated_as_a_log_is(log: Log, found: Calibration) -> None:
    scans = [log.scan(row) for row in range(len(log))]
    models = mecp_env.calibrate(scans, log.T_odom_robot)
    assert models.odometry == found.odometry
    assert models.sensor.x_m == found.sensor.x_m
    step = models.odometry.between(log.T_odom_robot[10], log.T_odom_robot[14])
    assert step.cov.shape == (2, 2, 2)
    known = mecp_env.calibrate(scans, log.T_odom_robot, {"x_m": 0.08, "range_sigma_m": 0.05})
    assert known.sensor.x_m == pytest.approx(0.08, abs=0.01)
    with pytest.raises(ConfigError, match="x_meter"):
        mecp_env.calibrate(scans, log.T_odom_robot, {"x_meter": 0.08})


def test_what_is_given_wins(log: Log, found: Calibration) -> None:
    kept = calibration_of(log, {"x_m": 0.2}, turn_sigma_deg=4.5, distance_scale=1.1)
    assert kept.sensor.x_m == 0.2
    assert kept.odometry.distance_scale == 1.1
    assert kept.odometry.turn_sigma_deg == 4.5
    wide = OdometryModel.of_noise(OdometryConfig(turn_sigma_deg=4.5))
    assert kept.odometry.turn_sigma_turning_deg == wide.turn_sigma_turning_deg
    assert kept.estimates["turn_sigma_deg"].source == "given"
    assert kept.estimates["distance_sigma_m"].source == "estimated"
    assert kept.estimates["turn_scale"].value == pytest.approx(found.estimates["turn_scale"].value, abs=0.02)
    tripled = calibration_of(log, scale=3.0)
    assert tripled.odometry.sigmas(0.4, 0.3) == pytest.approx(3.0 * found.odometry.sigmas(0.4, 0.3))
    assert tripled.odometry.distance_scale == found.odometry.distance_scale


@pytest.mark.slow
def test_a_calibrated_run_is_better(log: Log, found: Calibration) -> None:
    raw, calibrated = run_log(log), run_log(log, calibration=found)
    assert calibrated.pipeline.config.sensor.x_m == found.sensor.x_m
    metrics = calibrated.metrics()
    assert metrics["calibration"]["fields"]["x_m"]["source"] == "estimated"
    assert set(metrics["calibration"]["fields"]) == set(FIELDS)
    assert metrics["dead_reckoning_ate_m"] < 0.7 * raw.metrics()["dead_reckoning_ate_m"]
    assert metrics["ate_m"] < 0.15


def still_log(log: Log, ranges: np.ndarray, scans: int | None = None) -> Log:
    """The log with other ranges, up to a scan."""
    rows = slice(scans)
    return replace(log, t=log.t[rows], ranges=ranges[rows], T_odom_robot=log.T_odom_robot[rows], T_ref_robot=None)


def wall(log: Log) -> np.ndarray:
    """(n,B) ranges to a single wall that is 2 m to the left."""
    headings = log.T_odom_robot[:, 2][:, None] + BEARINGS
    with np.errstate(divide="ignore"):
        ranges = 2.0 / np.sin(headings)
    return np.where((ranges > 0.0) & (ranges < 15.0), ranges, np.nan)


def test_what_scans_do_not_tell_keeps_its_default_by_name(log: Log) -> None:
    dark = np.full_like(log.ranges, np.nan)
    for bad in (still_log(log, dark), still_log(log, log.ranges, 20)):
        found = calibration_of(bad)
        assert found.odometry == OdometryModel()
        assert found.sensor == config_for(bad).sensor
        (note,) = found.notes
        for name in set(FIELDS) - {"range_sigma_m"}:
            assert f"{name} " in note
        assert {estimate.source for estimate in found.estimates.values()} == {"default"}
    found = calibration_of(still_log(log, wall(log)))  # which tells no distance
    assert found.estimates["distance_sigma_m"].source == found.estimates["distance_scale"].source == "default"
    assert "distance_scale 1" in found.notes[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda poses, rows: 0.0 * poses, "never moves"),
        (lambda poses, rows: poses + np.where(rows > 50, 1.0, 0.0) * [9.0, 0.0, 0.0], r"odometry\[51\]"),
        (lambda poses, rows: np.where(rows == 7, np.nan, poses), r"odometry\[7\]: not finite"),
        (lambda poses, rows: poses[:-1], "shape"),
    ],
)
def test_odometry_that_says_nothing_is_refused(log: Log, change: Any, said: str) -> None:
    scans = [log.scan(row) for row in range(100)]
    with pytest.raises(SensorError, match=said):
        mecp_env.calibrate(scans, change(log.T_odom_robot[:100], np.arange(100)[:, None]))


def test_a_log_whose_odometry_says_nothing_takes_the_defaults_and_an_invalid_scan_is_refused(log: Log) -> None:
    found = calibration_of(replace(log, T_odom_robot=0.0 * log.T_odom_robot))
    assert found.odometry == OdometryModel()
    assert "never moves" in found.notes[0]
    assert "distance_scale 1" in found.notes[0]
    scans = [log.scan(row) for row in range(100)]
    scans[3] = replace(scans[3], ranges=-scans[3].ranges)
    with pytest.raises(SensorError, match=r"scan.ranges"):
        mecp_env.calibrate(scans, log.T_odom_robot[:100])


def test_corrections_are_undone_by_what_is_measured() -> None:
    model, rng = OdometryModel(**OFF), np.random.default_rng(0)
    true = rng.normal(size=(200, 3)) * [0.5, 0.1, 0.5]
    np.testing.assert_allclose(model.corrected(measured(true, model.correction)), true, atol=1e-12)
    straight = measured(np.array([1.02, 0.0, 0.0]), model.correction)
    assert np.hypot(*straight[:2]) == pytest.approx(1.0)
    assert straight[2] == pytest.approx(-math.radians(1.5) / 0.98)


def test_a_step_of_the_model_is_corrected_odometry() -> None:
    model = OdometryModel(**OFF, distance_sigma_m=0.1, distance_sigma_turning_m=0.0)
    step = model.between((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert step.increments.sum(axis=0) == pytest.approx([1.02, math.radians(1.5)], abs=1e-3)
    assert step.cov.sum(axis=0)[0, 0] == pytest.approx(0.01 * step.increments[:, 0].sum(), rel=1e-3)
    with pytest.raises(SensorError, match="finite"):
        model.between((0.0, 0.0, math.nan), (1.0, 0.0, 0.0))


def test_the_default_noise_is_that_of_the_paper() -> None:
    for motion in ((0.4, 0.1), (0.0, 1.0), (2.0, 0.0)):
        np.testing.assert_allclose(OdometryModel().sigmas(*motion), OdometryConfig().sigmas(*motion))
