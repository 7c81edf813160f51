"""Covariances stay symmetric and positive through any sequence of predictions, updates, births, merges and removals."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam.filters.conftest import random_odometry, sensor_cov

STEPS = ("predict", "slip", "update", "sharp", "iterate", "augment", "merge", "remove", "pin")
SEQUENCES = st.lists(st.sampled_from(STEPS), min_size=1, max_size=25)


class Life:
    """A filter with a random life; measurements are near what it expects."""

    def __init__(self, kind: str, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.filter: Any = make_filter(FilterConfig(kind=kind))
        self.born = 0

    def predict(self) -> None:
        self.filter.predict(random_odometry(self.rng, int(self.rng.integers(1, 4))))

    def slip(self) -> None:
        self.filter.predict(random_odometry(self.rng, 1, bumper=True))

    def augment(self) -> None:
        m = int(self.rng.integers(1, 6))
        z = np.column_stack((self.rng.uniform(1.0, 9.0, m), self.rng.uniform(-np.pi, np.pi, m)))
        self.filter.augment(z, sensor_cov(self.rng, m), self.born + np.arange(m))
        self.born += m

    def update(self, iterate: bool = False, sharp: float = 1.0) -> None:
        ids = self.rng.permutation(self.filter.ids)[:5]
        nu, _ = self.filter.innovation(np.zeros((len(ids), 2)), np.eye(2 * len(ids)), ids)
        z = -nu.reshape(-1, 2) + sharp * self.rng.normal(size=(len(ids), 2)) * [0.05, 0.01]
        self.filter.update(z, sharp**2 * sensor_cov(self.rng, len(ids)), ids, iterate)

    def iterate(self) -> None:
        self.update(iterate=True)

    def sharp(self) -> None:
        self.update(sharp=1e-3)

    def merge(self) -> None:
        """The two nearest landmarks become one."""
        belief = self.filter.belief()
        if len(belief.ids) >= 2:
            distance = np.hypot(*(belief.p_map[:, None] - belief.p_map).transpose(2, 0, 1))
            np.fill_diagonal(distance, np.inf)
            i, j = np.unravel_index(distance.argmin(), distance.shape)
            self.filter.fuse(int(belief.ids[i]), int(belief.ids[j]))

    def remove(self) -> None:
        self.filter.remove(self.rng.permutation(self.filter.ids)[:2])

    def pin(self) -> None:
        self.filter.set_pose(self.filter.belief().T_map_robot + self.rng.normal(size=3) * 0.01)


def assert_covariance(cov: Any) -> None:
    np.testing.assert_array_equal(cov, cov.T)
    scale = np.sqrt(np.diag(cov))
    assert np.linalg.eigvalsh(cov / np.outer(scale, scale)).min() > -1e-9  # of the correlations: free of units


def assert_sound(life: Life) -> None:
    size, belief = life.filter.size, life.filter.belief()
    assert np.isfinite(life.filter.mean[:size]).all()
    for cov in (life.filter.cov[:size, :size], belief.pose_cov, *belief.covs):
        assert_covariance(cov)


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SEQUENCES, st.integers(0, 10**6))
def test_any_life_of_a_filter_keeps_a_covariance(kind, sequence, seed):
    life = Life(kind, seed)
    life.augment()
    for step in sequence:
        getattr(life, step)()
        assert_sound(life)


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_an_update_adds_no_uncertainty_and_a_prediction_removes_none(kind, seed):
    life = Life(kind, seed)
    life.augment()
    for grow, step in ((True, life.slip), (False, life.update), (True, life.predict), (False, life.update)):
        before = np.linalg.slogdet(life.filter.marginal(life.filter.ids)[1])[1]
        step()
        after = np.linalg.slogdet(life.filter.marginal(life.filter.ids)[1])[1]
        assert (after - before) * (1.0 if grow else -1.0) > -1e-6
