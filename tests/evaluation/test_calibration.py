"""Calibration: known errors of odometry and laser are found, what scans do not tell keeps its default, by name."""

import math
from dataclasses import replace

import numpy as np
import pytest

import mecp_env
from mecp_env.core.errors import ConfigError, SensorError
from mecp_env.core.se2 import between, composed
from mecp_env.evaluation.calibration import FIELDS, Calibration, calibrate_log
from mecp_env.evaluation.log_run import config_for, run_log
from mecp_env.evaluation.scan_motions import (
    ALONG,
    NOTHING,
    TURN,
    Motions,
    Residuals,
    fitted,
    noise_of,
    residuals,
    told,
)
from mecp_env.evaluation.trajectory import trajectory_error
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import OdometryModel, measured
from mecp_env.world.config import OdometryConfig
from tests.logs.calibrated import simulated_log
from tests.slam.make import slopes

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


SIGMAS = {"distance_scale": 0.03, "turn_scale": 0.01, "turn_bias_deg_per_m": 0.3, "x_m": 0.01, "heading_deg": 9.0}


@pytest.mark.parametrize("noise", [0.3, 5.0])
def test_known_errors_are_found(noise: float) -> None:
    true = odometry_of(noise)
    found = calibration_of(simulated_log(true, seed=3))
    for name, value in {**OFF, "x_m": 0.08, "heading_deg": 0.0}.items():
        estimate = found.estimates[name]
        assert estimate.source == "default" or abs(estimate.value - value) < 3.5 * estimate.sigma
        assert (estimate.sigma or 1.0) < 0.01 + SIGMAS[name] * noise or noise > 1.0
    for motion in ((0.5, 0.0), (0.4, math.radians(20.0))):
        ratio = found.odometry.sigmas(*motion) / true.sigmas(*motion)
        assert 0.75 < ratio.min() < ratio.max() < 1.6
    assert found.range_noise_m == pytest.approx(0.02, rel=0.1)


def test_a_stream_is_calibrated_as_a_log_is(log: Log, found: Calibration) -> None:
    scans = [log.scan(row) for row in range(len(log))]
    models = mecp_env.calibrate(scans, log.T_odom_robot)
    assert models.odometry == found.odometry
    assert models.sensor.x_m == found.sensor.x_m
    with pytest.raises(ConfigError, match="x_meter"):
        mecp_env.calibrate(scans, log.T_odom_robot, {"x_meter": 0.08})


def test_what_is_given_wins(log: Log, found: Calibration) -> None:
    kept = calibration_of(log, {"x_m": 0.2}, turn_sigma_deg=4.5, distance_scale=1.1)
    given = kept.sensor.x_m, kept.odometry.distance_scale, kept.odometry.turn_sigma_deg
    assert given == (0.2, 1.1, 4.5)
    assert (kept.estimates["turn_sigma_deg"].source, kept.estimates["turn_scale"].source) == ("given", "estimated")
    assert kept.estimates["turn_scale"].value == pytest.approx(found.estimates["turn_scale"].value, abs=0.02)


@pytest.mark.slow
def test_a_calibrated_run_is_better(log: Log, found: Calibration) -> None:
    raw, calibrated = trajectory_error(log.T_odom_robot, log.T_ref_robot), run_log(log, calibration=found)
    assert calibrated.pipeline.config.sensor.x_m == found.sensor.x_m
    metrics = calibrated.metrics()
    assert metrics["calibration"]["fields"]["x_m"]["source"] == "estimated"
    assert set(metrics["calibration"]["fields"]) == set(FIELDS)
    assert metrics["dead_reckoning_ate_m"] < 0.7 * raw.rmse_m
    assert metrics["ate_m"] < 0.15


def test_what_scans_do_not_tell_keeps_its_default_by_name(log: Log) -> None:
    short = {name: getattr(log, name)[:20] for name in ("t", "ranges", "T_odom_robot")}
    for changes in ({"ranges": np.full_like(log.ranges, np.nan)}, short):
        bad = replace(log, T_ref_robot=None, **changes)
        found = calibration_of(bad)
        assert found.odometry == OdometryModel()
        assert found.sensor == config_for(bad).sensor
        (note,) = found.notes
        for name in set(FIELDS) - {"range_sigma_m"}:
            assert f"{name} " in note
        assert {estimate.source for estimate in found.estimates.values()} == {"default"}
    away = np.sin(log.T_odom_robot[:, 2][:, None] + BEARINGS)
    wall = np.where(away > 2.0 / 15.0, 2.0 / np.maximum(away, 1e-9), np.nan)  # single, 2 m to the left
    found = calibration_of(replace(log, ranges=wall, T_ref_robot=None))  # which tells no distance
    assert found.estimates["distance_sigma_m"].source == found.estimates["distance_scale"].source == "default"
    assert "distance_scale 1" in found.notes[0]


def test_odometry_that_says_nothing_is_refused(log: Log) -> None:
    scans, poses, rows = [log.scan(row) for row in range(100)], log.T_odom_robot[:100], np.arange(100)[:, None]
    for wrong, said in (
        (0.0 * poses, "never moves"),
        (poses + np.where(rows > 50, 1.0, 0.0) * [9.0, 0.0, 0.0], r"odometry\[51\]"),
        (np.where(rows == 7, np.nan, poses), r"odometry\[7\]: not finite"),
    ):
        with pytest.raises(SensorError, match=said):
            mecp_env.calibrate(scans, wrong)


def test_corrections_are_undone_by_what_is_measured() -> None:
    model, rng = OdometryModel(**OFF), np.random.default_rng(0)
    true = rng.normal(size=(200, 3)) * [0.5, 0.1, 0.5]
    np.testing.assert_allclose(model.corrected(measured(true, model.correction)), true, atol=1e-12)
    straight = measured(np.array([1.02, 0.0, 0.0]), model.correction)
    assert np.hypot(*straight[:2]) == pytest.approx(1.0)
    assert straight[2] == pytest.approx(-math.radians(1.5) / 0.98)


N = 4000
TRUE = np.array([1.05, 0.97, 0.03, 0.12, 0.02])
PER_METRE, PER_RAD = (0.05, math.radians(2.0)), (0.03, math.radians(3.0))


def exact(n: int = 60) -> Motions:
    """Motions without noise of a robot that is off by `TRUE`."""
    rng = np.random.default_rng(0)
    robot = np.column_stack((rng.uniform(0.0, 1.0, n), 0.05 * rng.normal(size=n), 0.4 * rng.normal(size=n)))
    X = np.array([TRUE[3], 0.0, TRUE[4]])
    cov = np.tile(np.diag([0.004, 0.004, 0.002]) ** 2, (n, 1, 1))
    return Motions(measured(robot, TRUE[:3]), between(X, composed(robot, X)), cov, 5.0, n, 1)


def drawn(outliers: float = 0.0) -> Residuals:
    """Residuals of arcs with the noise above, and a share that is five times as large."""
    rng = np.random.default_rng(1)
    metres, turn = rng.uniform(0.2, 1.0, N), abs(0.4 * rng.normal(size=N))
    sigmas = [np.sqrt(a**2 * metres + b**2 * turn) for a, b in zip(PER_METRE, PER_RAD, strict=True)]
    halves = rng.normal(size=(2, N)) * sigmas[1] / math.sqrt(2.0)
    sideways = metres * (0.75 * halves[0] + 0.25 * halves[1])
    off = np.column_stack((sigmas[0] * rng.normal(size=N), sideways, halves.sum(axis=0)))
    off[rng.random(N) < outliers] *= 5.0
    return Residuals(off, np.zeros((N, 3, 3)), metres, turn, 5.0, False)


def test_the_covariance_is_that_of_the_registration_in_the_frame_of_the_course() -> None:
    motions, values, course = exact(1), np.array([1.0, 1.0, 0.0, 0.5, 0.3]), np.array([0.7])

    def off(noise: np.ndarray) -> np.ndarray:
        one = replace(motions, laser=motions.laser + noise)
        return residuals(one, values, np.zeros(3), course).off[0]

    J = slopes(off, np.zeros(3))
    expected = J @ motions.cov[0] @ J.T
    np.testing.assert_allclose(residuals(motions, values, np.zeros(3), course).cov[0], expected, rtol=1e-3, atol=1e-9)


def test_the_true_values_are_fitted() -> None:
    np.testing.assert_allclose(fitted(exact(), np.zeros(3), NOTHING.copy(), np.arange(5)).values, TRUE, atol=1e-3)
    held = fitted(exact(), np.zeros(3), NOTHING.copy(), np.array([1, 3]))
    np.testing.assert_array_equal(held.values[[0, 2, 4]], NOTHING[[0, 2, 4]])
    assert np.isinf(held.sigmas[[0, 2, 4]]).all()


def test_noise_is_told_apart_by_metres_and_radians_among_outliers() -> None:
    noise = np.sqrt(noise_of(drawn(outliers=0.02)))
    np.testing.assert_allclose(noise[[ALONG, TURN], 0], PER_METRE, rtol=0.15)
    np.testing.assert_allclose(noise[[ALONG, TURN], 1], PER_RAD, rtol=0.25)


def test_a_corridor_tells_a_turn_but_no_distance() -> None:
    left = drawn()
    left.cov[:, 0, 0] = 0.3**2
    distances, turns = told(left)
    assert turns.all()
    assert not distances.any()
    left.cov[:, 2, 2] = math.radians(3.0) ** 2
    assert not told(left)[1].any()
