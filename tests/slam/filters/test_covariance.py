"""Covariances stay symmetric and positive through any sequence of predictions, updates, births, merges and removals."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam.filters.conftest import Life

STEPS = ("predict", "slip", "update", "sharp", "iterate", "augment", "merge", "remove", "pin")
SEQUENCES = st.lists(st.sampled_from(STEPS), min_size=1, max_size=25)


def assert_covariance(cov: Any) -> None:
    np.testing.assert_array_equal(cov, cov.T)
    scale = np.sqrt(np.diag(cov))
    assert np.linalg.eigvalsh(cov / np.outer(scale, scale)).min() > -1e-9  # of the correlations: free of units


def assert_sound(estimate: Any) -> None:
    size, belief = estimate.size, estimate.belief()
    assert np.isfinite(estimate.mean[:size]).all()
    for cov in (estimate.cov[:size, :size], belief.pose_cov, *belief.covs):
        assert_covariance(cov)


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SEQUENCES, st.integers(0, 10**6))
def test_any_life_of_a_filter_keeps_a_covariance(kind, sequence, seed):
    life = Life(make_filter(FilterConfig(kind=kind)), seed=seed)
    life.augment()
    for step in sequence:
        life.live(step)
        assert_sound(life.filters[0])
