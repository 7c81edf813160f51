"""Updates: one scan at once, iterated at a loop closure, refused for a bad covariance; landmark merging."""

import copy

import numpy as np
import pytest

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import FilterError, make_filter
from tests.slam.filters.conftest import lost
from tests.slam.filters.twin import wrap


def test_bearings_are_wrapped_behind_the_robot(kind):
    estimate = make_filter(FilterConfig(kind=kind))
    R = np.diag([1e-4, 1e-4])
    estimate.augment(np.array([[2.0, np.pi - 0.01]]), R, np.array([0]))
    nu, _ = estimate.innovation(np.array([[2.0, -np.pi + 0.01]]), R, np.array([0]))
    assert nu[1] == pytest.approx(0.02)
    estimate.update(np.array([[2.0, -np.pi + 0.01]]), R, np.array([0]))
    assert np.hypot(*(estimate.belief().p_map[0] - [-2.0, 0.0])) < 0.03


@pytest.mark.parametrize("heading_error", [0.05, -0.6])
def test_iterated_update_is_that_of_the_twin(kind, heading_error):
    pair, z, R = lost(kind, heading_error)
    pair.filter.update_iterations = 20
    pair.filter.update(z, R, pair.ids, iterate=True)
    pair.twin.update(z, R, pair.ids, iterate=True)
    np.testing.assert_allclose(wrap(pair.mean - pair.twin.x), 0.0, atol=2e-6)
    np.testing.assert_allclose(pair.cov, pair.twin.P, atol=2e-6)


def test_iterating_never_turns_or_moves_the_map_as_a_whole():
    """However unsure the map as a whole is: the measurements are the same wherever it lies."""
    found = []
    for sigma in (0.0, 0.1, 3.0):
        pair, z, R = lost("riekf", -0.6)
        n, whole = len(pair.mean), np.zeros((3, len(pair.mean)))
        whole[0, 0], whole[1, 1::2], whole[2, 2::2] = 1.0, 1.0, 1.0  # errors that turn and move all alike
        pair.filter.cov[:n, :n] += sigma**2 * whole.T @ whole
        pair.filter.update(z, R, pair.ids, iterate=True)
        found.append(pair.mean.copy())
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], atol=1e-7)


def test_non_positive_covariance_is_refused_and_nothing_changed(pair):
    before = copy.deepcopy(pair.filter)
    z, R, ids = pair.scan(3)
    for bad in (-10.0 * np.eye(6), np.full((6, 6), np.nan)):
        with pytest.raises(FilterError, match="not positive"):
            pair.filter.update(z, bad, ids)
    with pytest.raises(FilterError, match="finite"):
        pair.filter.update(np.full((3, 2), np.nan), R, ids)
    np.testing.assert_array_equal(pair.filter.mean, before.mean)
    np.testing.assert_array_equal(pair.filter.cov, before.cov)


def test_wrong_input_is_named(pair):
    z, R, ids = pair.scan(3)
    with pytest.raises(FilterError, match=r"\[7\]"):
        pair.filter.update(z[:1], R[:2, :2], np.array([7]))
    with pytest.raises(FilterError, match="no landmarks"):
        pair.filter.remove(np.array([7]))
    with pytest.raises(FilterError, match=r"expected \(3, 2\)"):
        pair.filter.update(z, R[:4, :4], ids)
    with pytest.raises(FilterError, match="new"):
        pair.filter.augment(z, R, ids)
    with pytest.raises(FilterError, match="itself"):
        pair.filter.fuse(pair.ids[0], pair.ids[0])
