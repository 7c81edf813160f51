"""Ids, slots, capacity, removal, the belief in world coordinates, and lasers off the centre."""

import numpy as np
import pytest

from mecp_env.core.se2 import compose, to_map
from mecp_env.core.sensors import LaserView
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import FilterError, make_filter
from mecp_env.slam.filters.mounting import mount, predict_mounted, robot_belief
from mecp_env.slam.protocols import FullFilterWarning
from tests.slam import make
from tests.slam.filters.conftest import Pair, random_odometry, sensor_cov

MORE = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.02], [0.0, -0.02, 0.1]])
VIEW = LaserView(x_m=0.3, y_m=-0.2, heading_deg=40.0)


def test_belief_and_marginal_are_those_of_the_world(pair):
    belief = pair.filter.belief()
    mean, cov = pair.filter.marginal(pair.ids)
    world = pair.twin.world_cov()
    np.testing.assert_allclose(cov, world, atol=1e-12)
    np.testing.assert_allclose(belief.pose_cov, world[:3, :3], atol=1e-12)
    np.testing.assert_allclose(belief.T_map_robot, mean[:3], atol=0)
    np.testing.assert_allclose(belief.p_map.ravel(), mean[3:], atol=0)
    for k in range(len(pair.ids)):
        i = 3 + 2 * k
        np.testing.assert_allclose(belief.covs[k], world[i : i + 2, i : i + 2], atol=1e-12)
    some, some_cov = pair.filter.marginal(pair.ids[[4, 1]])
    rows = [0, 1, 2, 11, 12, 5, 6]
    np.testing.assert_allclose(some, mean[rows], atol=0)
    np.testing.assert_allclose(some_cov, cov[np.ix_(rows, rows)], atol=1e-12)


def test_a_new_landmark_lies_where_it_was_seen(kind):
    pair = Pair(kind, seed=3)
    pose = pair.filter.belief().T_map_robot
    z = np.array([[2.0, 0.5], [3.0, -2.0]])
    pair.filter.augment(z, sensor_cov(pair.rng, 2), np.array([7, 8]))
    seen = z[:, :1] * np.stack([np.cos(z[:, 1]), np.sin(z[:, 1])], axis=1)
    np.testing.assert_allclose(pair.filter.belief().p_map[-2:], to_map(pose, seen), atol=1e-14)


def test_remove_leaves_the_rest_as_it_was(pair):
    rest, gone = pair.ids[[0, 2, 3, 5]], pair.ids[[4, 1]]
    mean, cov = pair.filter.marginal(rest)
    pair.filter.remove(gone)
    assert pair.filter.ids.tolist() == rest.tolist()
    after_mean, after_cov = pair.filter.marginal(rest)
    np.testing.assert_array_equal(after_mean, mean)
    np.testing.assert_array_equal(after_cov, cov)
    with pytest.raises(FilterError, match="no landmarks"):
        pair.filter.remove(gone[1:])


def test_a_full_filter_drops_the_newest_and_counts(kind):
    estimate = make_filter(FilterConfig(kind=kind, max_landmarks=8))
    rng = np.random.default_rng(1)
    z = np.stack([rng.uniform(1, 9, 15), rng.uniform(-3, 3, 15)], axis=1).reshape(3, 5, 2)
    estimate.augment(z[0], np.eye(10) * 1e-4, np.arange(5))
    with pytest.warns(FullFilterWarning, match="8 landmarks"):
        estimate.augment(z[1], np.eye(10) * 1e-4, 5 + np.arange(5))
    estimate.augment(z[2], np.eye(10) * 1e-4, 10 + np.arange(5))  # it is reported once
    assert estimate.ids.tolist() == list(range(8))
    assert estimate.dropped == 7
    estimate.remove(np.array([0]))
    estimate.augment(z[2, :1], np.eye(2) * 1e-4, np.array([99]))
    assert estimate.ids.tolist() == [1, 2, 3, 4, 5, 6, 7, 99]


@pytest.mark.parametrize("pose_cov", [None, MORE])
def test_set_pose_is_independent_of_the_map_and_keeps_it(pair, pose_cov):
    mean, cov = pair.filter.marginal(pair.ids)
    T_map_robot = np.array([1.0, -2.0, 3.0])
    pair.filter.set_pose(T_map_robot, pose_cov)
    placed, placed_cov = pair.filter.marginal(pair.ids)
    np.testing.assert_array_equal(placed, [*T_map_robot, *mean[3:]])
    np.testing.assert_allclose(placed_cov[:3, :3], 1e-12 * np.eye(3) if pose_cov is None else pose_cov, atol=1e-12)
    np.testing.assert_allclose(placed_cov[3:, 3:], cov[3:, 3:], atol=1e-12)
    np.testing.assert_allclose(placed_cov[:3, 3:], 0.0, atol=1e-12)
    np.testing.assert_array_equal(getattr(pair.filter, "first", pair.mean)[:3], [3.0, 1.0, -2.0])


def test_loosening_adds_to_the_pose_and_keeps_what_the_map_says_of_it(pair):
    mean, cov = pair.filter.marginal(pair.ids)
    pair.filter.loosen(MORE)
    loose, loose_cov = pair.filter.marginal(pair.ids)
    np.testing.assert_array_equal(loose, mean)
    cov[:3, :3] += MORE
    np.testing.assert_allclose(loose_cov, cov, atol=1e-12)


def test_a_shifted_pose_has_the_covariance_of_finite_differences(pair):
    T = pair.rng.uniform(-1.0, 1.0, 3)
    before = pair.filter.belief()
    F = make.slopes(lambda pose: compose(pose, T), before.T_map_robot)
    pair.filter.shift_pose(T)
    after = pair.filter.belief()
    assert after.T_map_robot == pytest.approx(compose(before.T_map_robot, T))
    assert after.pose_cov == pytest.approx(F @ before.pose_cov @ F.T, abs=1e-9)
    assert np.array_equal(after.p_map, before.p_map)
    assert after.covs == pytest.approx(before.covs)
    assert np.array_equal(pair.cov, pair.cov.T)


def test_the_laser_moves_as_the_robot_does(kind):
    rng, (plain, mounted) = np.random.default_rng(1), (make_filter(FilterConfig(kind=kind)) for _ in range(2))
    mount(mounted, VIEW)
    for _ in range(10):
        odometry = random_odometry(rng)
        plain.predict(odometry)
        predict_mounted(mounted, odometry, VIEW)
    belief = plain.belief()
    assert robot_belief(belief, LaserView(field_of_view_deg=180.0)) is belief
    believed, expected = robot_belief(mounted.belief(), VIEW), plain.belief()
    assert believed.T_map_robot == pytest.approx(expected.T_map_robot)
    assert believed.pose_cov == pytest.approx(expected.pose_cov)
    assert mounted.belief().T_map_robot == pytest.approx(compose(expected.T_map_robot, VIEW.T_robot_laser))
