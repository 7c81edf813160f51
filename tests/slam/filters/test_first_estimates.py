"""The filter `fej`: Jacobians at first estimates, and what it never learns: where the map as a whole lies."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.snapshot import StateError
from mecp_env.slam.config import KINDS, FilterConfig
from mecp_env.slam.filters import make_filter
from tests.env.helpers import episode_of
from tests.slam.filters.conftest import Pair, random_odometry, sensor_cov
from tests.slam.filters.twin import J, expected, wrap


def unobservable(at: np.ndarray) -> np.ndarray:
    """(n,3) the directions that turn and move robot and map together, at a state (n,)."""
    N = np.zeros((len(at), 3))
    N[0, 0], N[1:, 0] = 1.0, (at[1:].reshape(-1, 2) @ J.T).ravel()
    N[1::2, 1], N[2::2, 2] = 1.0, 1.0
    return N


class Drive:
    """A filter that predicts, corrects, maps, merges and forgets, with measurements that never depend on it."""

    def __init__(self, kind: str, whole_sigma: float) -> None:
        self.rng = np.random.default_rng(3)
        self.filter: Any = make_filter(FilterConfig(kind=kind))
        self.filter.cov[:3, :3] += whole_sigma**2 * np.eye(3)
        self.true = np.zeros(3)
        self.places = self.rng.uniform(-6.0, 6.0, (30, 2))

    def step(self, k: int, iterate: bool) -> None:
        arc = np.array([0.3, self.rng.normal() * 0.3])
        middle = self.true[0] + 0.5 * arc[1]
        self.true += [arc[1], arc[0] * np.cos(middle), arc[0] * np.sin(middle)]
        odometry = random_odometry(self.rng, arcs=1)
        self.filter.predict(type(odometry)(arc[None] + self.rng.normal(size=(1, 2)) * 0.02, odometry.cov, False))
        ids = self.rng.permutation(min(30, 4 + k))[:5]
        state = np.concatenate([self.true, self.places.ravel()])
        z = expected(state, ids) + self.rng.normal(size=(len(ids), 2)) * [0.05, 0.01]
        R, known = sensor_cov(self.rng, len(ids)), np.isin(ids, self.filter.ids)
        rows = np.repeat(known, 2)
        self.filter.update(z[known], R[np.ix_(rows, rows)], ids[known], iterate)
        self.filter.augment(z[~known], R[np.ix_(~rows, ~rows)], ids[~known])

    def double(self) -> None:
        """See a known landmark once more under another id, merge the two, and forget another one."""
        z = expected(np.concatenate([self.true, self.places[0]]), np.array([0])) + 0.03
        self.filter.augment(z, np.diag([1e-3, 1e-4]), np.array([99]))
        self.filter.fuse(0, 99)
        self.filter.remove(self.filter.ids[1:2])


@pytest.mark.parametrize("iterate", [False, True])
def test_nothing_is_learnt_of_where_the_map_as_a_whole_lies(iterate: bool) -> None:
    """However unsure that is: the same estimate, and the same uncertainty of it in the end."""
    sigma = 0.2
    sure, unsure = Drive("fej", 0.0), Drive("fej", sigma)
    for k in range(60):
        for drive in (sure, unsure):
            drive.step(k, iterate)
            if k == 30:
                drive.double()
    size = sure.filter.size
    assert size > 50
    np.testing.assert_allclose(unsure.filter.mean[:size], sure.filter.mean[:size], atol=1e-8)
    N = unobservable(sure.filter.first)
    gained = unsure.filter.cov[:size, :size] - sure.filter.cov[:size, :size]
    np.testing.assert_allclose(gained, sigma**2 * N @ N.T, atol=1e-8)


def test_the_plain_filter_learns_it() -> None:
    sigma = 0.2
    sure, unsure = Drive("ekf", 0.0), Drive("ekf", sigma)
    for k in range(60):
        for drive in (sure, unsure):
            drive.step(k, iterate=False)
    assert unsure.filter.cov[0, 0] - sure.filter.cov[0, 0] < 0.5 * sigma**2


def test_jacobians_are_those_at_first_estimates() -> None:
    pair = Pair("fej", seed=6)
    for _ in range(3):
        pair.predict()
        pair.update(4)
    fej = pair.filter
    z, R, slots = pair.scan(4)
    assert np.abs(fej.first - pair.mean)[3:].max() > 1e-3
    steps = 1e-6 * np.eye(len(fej.first))
    columns = [wrap(expected(fej.first + e, slots) - expected(fej.first - e, slots)).ravel() / 2e-6 for e in steps]
    H = np.stack(columns, axis=1)
    nu, S = fej.innovation(z, R, pair.ids[slots])
    np.testing.assert_allclose(S, H @ pair.cov @ H.T + R, atol=1e-8)
    np.testing.assert_allclose(H @ unobservable(fej.first), 0.0, atol=1e-7)
    np.testing.assert_allclose(wrap(nu - (z - expected(pair.mean, slots)).ravel()), 0.0, atol=1e-12)


def test_motion_is_that_from_the_pose_of_the_jacobians() -> None:
    """F takes what is unobservable before a prediction to what is unobservable after it."""
    pair = Pair("fej", seed=7)
    pair.update(5)
    before, cov = pair.filter.first.copy(), pair.cov.copy()
    assert np.abs(before - pair.mean)[:3].max() > 1e-3
    odometry = random_odometry(pair.rng, arcs=2)
    pair.filter.predict(type(odometry)(odometry.increments, np.zeros((2, 2, 2)), False))
    F = np.eye(len(before))
    F[1:3, 0] = J @ (pair.mean[1:3] - before[1:3])
    np.testing.assert_allclose(F @ unobservable(before), unobservable(pair.filter.first), atol=1e-12)
    np.testing.assert_allclose(pair.cov, F @ cov @ F.T, atol=1e-12)


def test_it_is_the_plain_filter_while_first_estimates_are_the_estimates() -> None:
    fej, ekf = Pair("fej", seed=8), Pair("ekf", seed=8)
    for pair in (fej, ekf):
        pair.update(5)
    np.testing.assert_allclose(fej.mean, ekf.mean, atol=1e-12)
    np.testing.assert_allclose(fej.cov, ekf.cov, atol=1e-12)
    for pair in (fej, ekf):
        pair.predict()
        pair.update(5)
    assert np.abs(fej.mean - ekf.mean).max() > 1e-6


def test_bayes_factor_is_that_of_the_plain_filter_at_first_estimates() -> None:
    pairs = [Pair(kind, seed=9) for kind in ("fej", "ekf")]
    z, R, slots = pairs[0].scan(4)
    noise = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.02], [0.0, -0.02, 0.1]])
    factors = [pair.filter.log_bayes_factor(z + np.array([0.3, 0.1]), R, pair.ids[slots], noise) for pair in pairs]
    assert factors[0] == pytest.approx(factors[1], rel=1e-9)


def test_first_estimates_follow_their_landmarks() -> None:
    pair = Pair("fej", seed=10)
    first = pair.filter.first[3:].reshape(-1, 2).copy()
    pair.update(5)
    other = copy.deepcopy(pair.filter)
    pair.filter.remove(pair.ids[[1, 4]])
    np.testing.assert_array_equal(pair.filter.first[3:].reshape(-1, 2), first[[0, 2, 3, 5]])
    pair.filter.set_pose(np.array([1.0, 2.0, 0.5]))
    np.testing.assert_array_equal(pair.filter.first[:3], [0.5, 1.0, 2.0])
    np.testing.assert_array_equal(other.first[3:].reshape(-1, 2), first)


@pytest.mark.parametrize("kind", KINDS.ours)
def test_an_episode_with_any_filter_continues_from_its_state(kind: str) -> None:
    keywords: Any = {"slam": {"filter": {"kind": kind}}, "layout": "two_rooms"}
    env = gym.make("mecp_env/Layout-v0", **keywords).unwrapped
    env.reset(seed=2)
    for _ in range(15):
        env.step(np.array([0.6, 0.3], np.float32))
    assert len(env.slam_output.belief.ids) > 3
    state, other = env.get_state(), gym.make("mecp_env/Layout-v0", **keywords).unwrapped
    other.set_state(state)
    for _ in range(5):
        first, second = (e.step(np.array([0.3, -0.2], np.float32))[0] for e in (env, other))
        assert all(np.array_equal(first[key], second[key]) for key in first)


@pytest.mark.parametrize("damage", [lambda first: first[:-1], lambda first: first * np.nan])
def test_a_state_with_damaged_first_estimates_is_refused(damage: Any) -> None:
    env = gym.make("mecp_env/PaperMap-v0", slam={"filter": {"kind": "fej"}}).unwrapped
    env.reset(seed=1)
    env.step(np.array([0.5, 0.1], np.float32))
    landmark_filter = episode_of(env).pipeline.filter
    landmark_filter.first = damage(landmark_filter.first)
    state = env.get_state()
    with pytest.raises(StateError, match="first"):
        gym.make("mecp_env/PaperMap-v0", slam={"filter": {"kind": "fej"}}).unwrapped.set_state(state)
