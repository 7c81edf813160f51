"""A past pose as two landmarks of the filter: the same motion and covariance as integrating the odometry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.core.se2 import compose, inverse, wrap_angle
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.panorama.recent_scans import marks_seen, poses_of_marks, poses_since, seen_from
from tests.slam import make

MARKS = np.array([-2, -3])
TINY = np.eye(3) * 1e-12
POSE, SPREAD = (
    np.array([1.2, -0.4, 0.7]),
    np.array([[0.02, 0.003, 0.001], [0.003, 0.01, -0.002], [0.001, -0.002, 0.004]]),
)


def drive(landmark_filter, increments, sigma_m=0.03, sigma_rad=0.02):
    landmark_filter.predict(make.odometry(increments, (sigma_m, sigma_rad)))


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
def test_a_clone_knows_the_motion_since(kind):
    drives = [[(0.5, 0.3), (0.4, -0.6)], [(0.2, 1.0)]]
    since = make_filter(FilterConfig(kind=kind, prior_sigma_m=1e-5, prior_sigma_rad=1e-6))
    for increments in drives:
        drive(since, increments)
    cloned = make_filter(FilterConfig(kind=kind))
    drive(cloned, [(2.0, 0.8), (1.0, -0.5)], 0.1, 0.1)  # before: it does not matter how uncertain the past pose is
    cloned.augment(*marks_seen(np.zeros(3), TINY), MARKS)
    for increments in drives:
        drive(cloned, increments)
    poses, covs = poses_since(cloned, MARKS[None])
    expected = since.belief()
    assert np.allclose(poses[0], expected.T_map_robot, atol=1e-9)
    assert np.allclose(covs[0], expected.pose_cov, atol=2e-6)


def test_marks_are_no_landmarks_of_the_belief():
    landmark_filter = make_filter(FilterConfig())
    landmark_filter.augment(np.array([[3.0, 0.1]]), np.eye(2) * 1e-4, np.array([0]))
    landmark_filter.augment(*marks_seen(np.zeros(3), TINY), MARKS)
    assert landmark_filter.ids.tolist() == landmark_filter.belief().ids.tolist() == [0]
    assert landmark_filter.has(-2)
    landmark_filter.remove(MARKS)
    assert not landmark_filter.has(-2)


def numerical_jacobian(function, at, step=1e-6):
    columns = [(function(at + e) - function(at - e)) / (2.0 * step) for e in step * np.eye(len(at))]
    return np.stack(columns, axis=1)


def test_the_covariance_of_marks_is_that_of_the_pose():
    J = numerical_jacobian(lambda T: marks_seen(T, TINY)[0].ravel(), POSE)
    expected = J @ SPREAD @ J.T
    assert np.allclose(marks_seen(POSE, SPREAD)[1] - marks_seen(POSE, TINY)[1], expected, rtol=1e-5, atol=1e-8)


def test_the_inverse_motion_has_its_covariance():
    J = numerical_jacobian(inverse, POSE)
    T_now_past, cov = seen_from(POSE, SPREAD)
    assert np.allclose(compose(T_now_past, POSE), 0.0, atol=1e-12)
    assert np.allclose(cov, J @ SPREAD @ J.T, atol=1e-8)


def test_a_registration_moves_the_pose_to_where_it_was_found():
    landmark_filter = make_filter(FilterConfig())
    landmark_filter.augment(*marks_seen(np.zeros(3), TINY), MARKS)
    drive(landmark_filter, [(0.3, 0.5), (0.3, -0.5), (0.3, 0.2)], 0.1, 0.3)
    before = poses_since(landmark_filter, MARKS[None])[0][0]
    found = before + np.array([0.05, -0.03, 0.04])
    landmark_filter.update(*marks_seen(found, np.eye(3) * 1e-8), MARKS)
    after = poses_since(landmark_filter, MARKS[None])[0][0]
    assert np.hypot(*(after - found)[:2]) < 2e-3
    assert abs(wrap_angle(after[2] - found[2])) < math.radians(0.2)


def test_poses_since_have_the_covariance_of_pose_and_marks():
    """Two past poses, whose marks are seen from afar and a little bent."""
    rng = np.random.default_rng(0)
    mean = np.array([1.0, 2.0, 0.4, 11.0, -1.0, -8.0, 3.0, 4.0, 12.0, 2.0, -7.5])
    root = rng.normal(size=(11, 30))
    cov = 1e-3 * root @ root.T
    poses, covs = poses_of_marks(mean, cov)
    for k in range(2):
        J = numerical_jacobian(lambda x, k=k: poses_of_marks(x, cov)[0][k], mean)
        assert np.allclose(covs[k], J @ cov @ J.T, rtol=1e-5, atol=1e-7)
        middle, axis = 0.5 * (mean[3 + 4 * k : 5 + 4 * k] + mean[5 + 4 * k : 7 + 4 * k]), mean[3 + 4 * k : 5 + 4 * k]
        axis = axis - middle
        past = np.array([*middle, math.atan2(axis[1], axis[0])])
        assert np.allclose(compose(past, poses[k]), mean[:3])
