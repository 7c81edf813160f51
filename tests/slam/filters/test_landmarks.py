"""Ids, slots, capacity, removal, the belief in world coordinates, and lasers off the centre."""

import numpy as np
import pytest

from mecp_env.core.se2 import compose
from mecp_env.core.sensors import LaserView
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.filters.mounting import mount, predict_mounted, robot_belief
from mecp_env.slam.protocols import FullFilterWarning
from tests.slam.filters.conftest import random_odometry

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
