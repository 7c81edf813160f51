"""Residuals and noise of a calibration on constructed motions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.core.se2 import between, composed
from mecp_env.evaluation.calibration.motions import (
    ALONG,
    NOTHING,
    SIDE,
    TURN,
    Motions,
    Residuals,
    fitted,
    noise_of,
    residuals,
    slip_as_turn,
    told,
    with_tails,
)
from mecp_env.logs.odometry_model import measured

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


def drawn(side: float = 0.0, outliers: float = 0.0) -> Residuals:
    """Residuals of arcs with the noise above, more to the side (m per m), and a share that is five times as large."""
    rng = np.random.default_rng(1)
    metres, turn = rng.uniform(0.2, 1.0, N), abs(0.4 * rng.normal(size=N))
    sigmas = [np.sqrt(a**2 * metres + b**2 * turn) for a, b in zip(PER_METRE, PER_RAD, strict=True)]
    halves = rng.normal(size=(2, N)) * sigmas[1] / math.sqrt(2.0)
    sideways = metres * (0.75 * halves[0] + 0.25 * halves[1]) + side * metres * rng.normal(size=N)
    off = np.column_stack((sigmas[0] * rng.normal(size=N), sideways, halves.sum(axis=0)))
    off[rng.random(N) < outliers] *= 5.0
    return Residuals(off, np.zeros((N, 3, 3)), metres, turn, 5.0, False)


def test_the_true_values_leave_nothing() -> None:
    left = residuals(exact(), TRUE, np.zeros(3))
    np.testing.assert_allclose(left.off, 0.0, atol=1e-12)
    assert abs(residuals(exact(), NOTHING, np.zeros(3)).off).max() > 0.02
    described = residuals(exact(), TRUE * [1.0, 1.0, 1.0, 0.0, 0.0], np.array([TRUE[3], 0.0, TRUE[4]]))
    np.testing.assert_allclose(described.off, 0.0, atol=1e-12)


def test_the_covariance_is_that_of_the_registration_in_the_frame_of_the_course() -> None:
    motions, rng = exact(1), np.random.default_rng(2)
    values = np.array([1.0, 1.0, 0.0, 0.5, 0.3])
    course = np.array([0.7])
    off = []
    for noise in rng.normal(size=(4000, 1, 3)) * [0.004, 0.004, 0.002]:
        one = Motions(motions.measured, motions.laser + noise, motions.cov, 5.0, 1, 1)
        off.append(residuals(one, values, np.zeros(3), course).off[0])
    expected = residuals(motions, values, np.zeros(3), course).cov[0]
    np.testing.assert_allclose(np.cov(np.transpose(off)), expected, rtol=0.1, atol=6e-7)


def test_the_true_values_are_fitted() -> None:
    found = fitted(exact(), np.zeros(3), NOTHING.copy(), np.arange(5))
    np.testing.assert_allclose(found.values, TRUE, atol=1e-3)
    held = fitted(exact(), np.zeros(3), NOTHING.copy(), np.array([1, 3]))
    np.testing.assert_array_equal(held.values[[0, 2, 4]], NOTHING[[0, 2, 4]])
    assert np.isinf(held.sigmas[[0, 2, 4]]).all()


def test_noise_is_told_apart_by_metres_and_radians() -> None:
    for outliers in (0.0, 0.02):
        noise = np.sqrt(noise_of(drawn(outliers=outliers)))
        np.testing.assert_allclose(noise[[ALONG, TURN], 0], PER_METRE, rtol=0.15)
        np.testing.assert_allclose(noise[[ALONG, TURN], 1], PER_RAD, rtol=0.25)


def test_heavy_tails_widen_the_noise() -> None:
    gauss, heavy = drawn(), drawn(outliers=0.1)
    noise = noise_of(gauss)
    np.testing.assert_allclose(with_tails(gauss, noise)[[ALONG, TURN]], noise[[ALONG, TURN]], rtol=0.1)
    assert (with_tails(heavy, noise_of(heavy))[[ALONG, TURN]] > 2.0 * noise_of(heavy)[[ALONG, TURN]]).all()


def test_slip_to_the_side_is_covered_by_the_turn() -> None:
    arcs, slipping = drawn(), drawn(side=0.05)
    assert slip_as_turn(arcs, noise_of(arcs)) < 0.1 * PER_METRE[1] ** 2
    slip = slip_as_turn(slipping, noise_of(slipping))
    metres = 0.8
    assert math.sqrt(SIDE * slip * metres**3) == pytest.approx(0.05 * metres, rel=0.3)


def test_a_corridor_tells_a_turn_but_no_distance() -> None:
    left = drawn()
    left.cov[:, 0, 0] = 0.3**2
    distances, turns = told(left)
    assert turns.all()
    assert not distances.any()
    left.cov[:, 2, 2] = math.radians(3.0) ** 2
    assert not told(left)[1].any()
