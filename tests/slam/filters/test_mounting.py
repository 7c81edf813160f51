"""A laser off the robot's centre, in the filter: poses, covariances and innovations against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.core.se2 import compose, inverse, to_robot, wrap_angle
from mecp_env.core.sensors import LaserView
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.filters.mounting import mount, predict_mounted, robot_belief
from tests.slam.filters.conftest import Pair, random_odometry, sensor_cov

VIEW = LaserView(x_m=0.3, y_m=-0.2, heading_deg=40.0)
STEP = 1e-6


def derivative(function, x):
    """The derivative (m,n) of a function of x (n,), by central differences."""
    columns = [(function(x + STEP * axis) - function(x - STEP * axis)) / (2.0 * STEP) for axis in np.eye(len(x))]
    return np.array(columns).T


@pytest.mark.parametrize("seed", range(3))
def test_a_shifted_pose_has_the_covariance_of_finite_differences(kind, seed):
    pair, T = Pair(kind, seed), np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    before = pair.filter.belief()
    F = derivative(lambda pose: compose(pose, T), before.T_map_robot)
    pair.filter.shift_pose(T)
    after = pair.filter.belief()
    assert after.T_map_robot == pytest.approx(compose(before.T_map_robot, T))
    assert after.pose_cov == pytest.approx(F @ before.pose_cov @ F.T, abs=1e-9)
    assert np.array_equal(after.p_map, before.p_map)
    assert after.covs == pytest.approx(before.covs)
    assert np.array_equal(pair.cov, pair.cov.T)


def test_what_is_shifted_there_and_back_is_what_it_was(pair):
    ids, T = pair.ids, VIEW.T_robot_laser
    mean, cov = pair.filter.marginal(ids)
    pair.filter.shift_pose(T)
    believed = robot_belief(pair.filter.belief(), VIEW)
    pair.filter.shift_pose(inverse(T))
    again_mean, again_cov = pair.filter.marginal(ids)
    assert again_mean == pytest.approx(mean)
    assert again_cov == pytest.approx(cov, abs=1e-12)
    assert believed.T_map_robot == pytest.approx(mean[:3])
    assert believed.pose_cov == pytest.approx(cov[:3, :3], abs=1e-12)


def test_the_laser_moves_as_the_robot_does(kind):
    rng, (plain, mounted) = np.random.default_rng(1), (make_filter(FilterConfig(kind=kind)) for _ in range(2))
    mount(mounted, VIEW)
    for _ in range(10):
        odometry = random_odometry(rng)
        plain.predict(odometry)
        predict_mounted(mounted, odometry, VIEW)
    believed, expected = robot_belief(mounted.belief(), VIEW), plain.belief()
    assert believed.T_map_robot == pytest.approx(expected.T_map_robot)
    assert believed.pose_cov == pytest.approx(expected.pose_cov)
    assert mounted.belief().T_map_robot == pytest.approx(compose(expected.T_map_robot, VIEW.T_robot_laser))


def test_the_innovation_is_that_of_the_equations_with_the_mounting_in_them(pair):
    """S = H P H^T + R, H by finite differences of what a mounted laser measures, by the robot's pose and landmarks."""
    mean, P = pair.filter.marginal(pair.ids)
    pair.filter.shift_pose(VIEW.T_robot_laser)

    def measured(x):
        p = to_robot(compose(x[:3], VIEW.T_robot_laser), x[3:].reshape(-1, 2))
        return np.stack([np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])], axis=1).ravel()

    z, R = measured(mean) + 0.01, sensor_cov(pair.rng, len(pair.ids))
    H = derivative(measured, mean)
    nu, S = pair.filter.innovation(z.reshape(-1, 2), R, pair.ids)
    assert [wrap_angle(angle) for angle in nu] == pytest.approx(np.full(len(nu), 0.01))
    np.testing.assert_allclose(S, H @ P @ H.T + R, rtol=1e-5, atol=1e-8)


def test_a_centred_laser_leaves_the_belief_as_it_is(pair):
    belief = pair.filter.belief()
    assert robot_belief(belief, LaserView(field_of_view_deg=180.0)) is belief
    assert math.isclose(LaserView().field_of_view_rad, 2.0 * math.pi)
