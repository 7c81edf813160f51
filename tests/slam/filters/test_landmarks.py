"""Ids, slots, capacity, removal, copies, and the belief in world coordinates."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from mecp_env.core.se2 import to_map
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import Ekf, Filter, FilterError, SubmapEkf, make_filter
from mecp_env.slam.protocols import FullFilterWarning
from tests.slam.filters.conftest import Pair, random_odometry, sensor_cov


def test_kind_is_chosen_by_the_configuration():
    assert type(make_filter(FilterConfig())) is SubmapEkf
    paper: Filter = make_filter(FilterConfig(kind="ekf"))
    assert isinstance(paper, Ekf)


def test_the_prior_is_the_configured_one(kind):
    config = FilterConfig(kind=kind, prior_sigma_m=0.02, prior_sigma_rad=0.003)
    belief = make_filter(config).belief()
    np.testing.assert_array_equal(belief.T_map_robot, 0.0)
    np.testing.assert_allclose(belief.pose_cov, np.diag([0.02**2, 0.02**2, 0.003**2]))
    assert belief.p_map.shape == (0, 2)
    assert belief.covs.shape == (0, 2, 2)


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


def test_belief_is_a_copy(pair):
    belief = pair.filter.belief()
    before = [a.copy() for a in (belief.T_map_robot, belief.pose_cov, belief.ids, belief.p_map, belief.covs)]
    pair.predict()
    pair.update(4)
    pair.filter.remove(pair.ids[:2])
    after = (belief.T_map_robot, belief.pose_cov, belief.ids, belief.p_map, belief.covs)
    for a, b in zip(after, before, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_new_landmark_lies_where_it_was_seen(kind):
    pair = Pair(kind, seed=3)
    pose = pair.filter.belief().T_map_robot
    z = np.array([[2.0, 0.5], [3.0, -2.0]])
    pair.filter.augment(z, sensor_cov(pair.rng, 2), np.array([7, 8]))
    seen = z[:, :1] * np.stack([np.cos(z[:, 1]), np.sin(z[:, 1])], axis=1)
    np.testing.assert_allclose(pair.filter.belief().p_map[-2:], to_map(pose, seen), atol=1e-14)


def test_remove_leaves_the_rest_as_it_was(pair):
    rest = pair.ids[[0, 2, 3, 5]]
    mean, cov = pair.filter.marginal(rest)
    pair.filter.remove(pair.ids[[4, 1]])
    assert pair.filter.ids.tolist() == rest.tolist()
    assert [pair.filter.has(int(i)) for i in pair.ids] == [True, False, True, True, False, True]
    after_mean, after_cov = pair.filter.marginal(rest)
    np.testing.assert_array_equal(after_mean, mean)
    np.testing.assert_array_equal(after_cov, cov)
    with pytest.raises(FilterError, match="no landmarks"):
        pair.filter.remove(pair.ids[[1]])


def test_ids_are_stable_through_growth_removal_and_fusion(kind):
    rng = np.random.default_rng(0)
    estimate = make_filter(FilterConfig(kind=kind))
    where: dict[int, np.ndarray] = {}
    for k in range(60):
        ids = np.array([3 * k + 1, 3 * k])
        z = np.stack([rng.uniform(1, 9, 2), rng.uniform(-3, 3, 2)], axis=1)
        estimate.augment(z, np.eye(4) * 1e-4, ids)
        belief = estimate.belief()
        where |= {int(i): p for i, p in zip(belief.ids[-2:], belief.p_map[-2:], strict=True)}
        if k % 5 == 4:
            gone = rng.choice(belief.ids, 2, replace=False)
            estimate.remove(gone)
            where = {i: p for i, p in where.items() if i not in gone}
        belief = estimate.belief()
        assert belief.ids.tolist() == list(where)
        np.testing.assert_array_equal(belief.p_map, list(where.values()))


def test_capacity_grows_without_changing_a_bit(kind):
    """Two filters, one of which had to grow its arrays: the same numbers."""
    beliefs = []
    for first in (1, 40):
        rng = np.random.default_rng(1)
        estimate = make_filter(FilterConfig(kind=kind))
        z = np.stack([rng.uniform(1, 9, 40), rng.uniform(-3, 3, 40)], axis=1)
        for part in np.split(np.arange(40), [first] if first < 40 else []):
            estimate.augment(z[part], np.eye(2 * len(part)) * 1e-4, part)
        estimate.predict(random_odometry(rng))
        beliefs.append(estimate.marginal(np.arange(40)))
    np.testing.assert_array_equal(beliefs[0][0], beliefs[1][0])
    np.testing.assert_array_equal(beliefs[0][1], beliefs[1][1])


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
    assert not estimate.has(8)
    estimate.remove(np.array([0]))
    estimate.augment(z[2, :1], np.eye(2) * 1e-4, np.array([99]))
    assert estimate.ids.tolist() == [1, 2, 3, 4, 5, 6, 7, 99]


def test_snapshot_lives_on_alone(pair):
    copied = copy.deepcopy(pair.filter)
    before = copied.marginal(pair.ids)
    pair.predict()
    pair.update(4)
    pair.filter.remove(pair.ids[:1])
    for a, b in zip(copied.marginal(pair.ids), before, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_copies_continue_bit_for_bit(kind, duplicate):
    pair = Pair(kind, seed=4)
    other = duplicate(pair.filter)
    for _ in range(20):
        odometry = random_odometry(pair.rng)
        z, R, slots = pair.scan(3)
        for estimate in (pair.filter, other):
            estimate.predict(odometry)
            estimate.update(z, R, pair.ids[slots])
    np.testing.assert_array_equal(pair.filter.mean, other.mean)
    np.testing.assert_array_equal(pair.filter.cov, other.cov)


def test_all_state_is_plain(pair):
    for name, value in vars(pair.filter).items():
        assert isinstance(value, (int, float, np.ndarray, dict, tuple)), name


def test_set_pose_pins_the_robot_and_keeps_the_map(pair):
    mean, cov = pair.filter.marginal(pair.ids)
    T_map_robot = np.array([1.0, -2.0, 3.0])
    pair.filter.set_pose(T_map_robot)
    pinned, pinned_cov = pair.filter.marginal(pair.ids)
    np.testing.assert_array_equal(pinned[:3], T_map_robot)
    np.testing.assert_array_equal(pinned[3:], mean[3:])
    np.testing.assert_allclose(pinned_cov[3:, 3:], cov[3:, 3:], atol=1e-12)
    np.testing.assert_allclose(pinned_cov[:3, 3:], 0.0, atol=1e-12)
    np.testing.assert_allclose(pinned_cov[:3, :3], 1e-12 * np.eye(3), atol=1e-14)


def test_set_pose_with_a_covariance_is_independent_of_the_map(pair):
    mean, cov = pair.filter.marginal(pair.ids)
    T_map_robot, pose_cov = (
        np.array([1.0, -2.0, 0.5]),
        np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.02], [0.0, -0.02, 0.1]]),
    )
    pair.filter.set_pose(T_map_robot, pose_cov)
    placed, placed_cov = pair.filter.marginal(pair.ids)
    np.testing.assert_array_equal(placed, [*T_map_robot, *mean[3:]])
    np.testing.assert_allclose(placed_cov[:3, :3], pose_cov, atol=1e-12)
    np.testing.assert_allclose(placed_cov[3:, 3:], cov[3:, 3:], atol=1e-12)
    np.testing.assert_allclose(placed_cov[:3, 3:], 0.0, atol=1e-12)


def test_loosening_adds_to_the_pose_and_keeps_what_the_map_says_of_it(pair):
    mean, cov = pair.filter.marginal(pair.ids)
    more = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.02], [0.0, -0.02, 0.1]])
    pair.filter.loosen(more)
    loose, loose_cov = pair.filter.marginal(pair.ids)
    np.testing.assert_array_equal(loose, mean)
    cov[:3, :3] += more
    np.testing.assert_allclose(loose_cov, cov, atol=1e-12)


def test_with_the_true_pose_landmarks_average_their_measurements(kind):
    rng = np.random.default_rng(0)
    estimate = make_filter(FilterConfig(kind=kind))
    corner, R = np.array([4.0, 1.0]), np.diag([0.05**2, 0.005**2])
    estimate.set_pose(np.zeros(3))
    for k in range(100):
        T = np.array([0.01 * k, 0.0, 0.002 * k])
        estimate.set_pose(T)
        d = corner - T[:2]
        z = np.array([[np.hypot(*d), np.arctan2(d[1], d[0]) - T[2]]]) + rng.normal(size=2) * [0.05, 0.005]
        estimate.update(z, R, np.array([0])) if k else estimate.augment(z, R, np.array([0]))
    belief = estimate.belief()
    assert np.hypot(*(belief.p_map[0] - corner)) < 0.02
    assert np.sqrt(np.trace(belief.covs[0])) == pytest.approx(np.hypot(0.05, 4 * 0.005) / 10, rel=0.1)


def test_bumper_widens_sideways_and_heading(kind):
    covs = []
    for bumper in (False, True):
        rng = np.random.default_rng(0)
        estimate = make_filter(FilterConfig(kind=kind, bumper_lateral_sigma_m=0.1, bumper_heading_sigma_deg=2.0))
        odometry = random_odometry(rng, arcs=4)
        still = type(odometry)(np.zeros((4, 2)), odometry.cov, bumper)
        estimate.predict(still)
        covs.append(estimate.belief().pose_cov)
    added = covs[1] - covs[0]
    np.testing.assert_allclose(added, np.diag([0.0, 0.1**2, np.radians(2.0) ** 2]), atol=1e-15)
