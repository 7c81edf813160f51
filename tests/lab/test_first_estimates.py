"""The filter `fej`: Jacobians at first estimates, and what it never learns: where the map as a whole lies."""

import numpy as np
import pytest

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam.filters.conftest import Life
from tests.slam.filters.twin import J

STEPS = ("predict", "slip", "update", "update", "augment", "augment", "merge", "remove")


def unobservable(at: np.ndarray) -> np.ndarray:
    """(n,3) the directions that turn and move robot and map together, at a state (n,)."""
    N = np.zeros((len(at), 3))
    N[0, 0], N[1:, 0] = 1.0, (at[1:].reshape(-1, 2) @ J.T).ravel()
    N[1::2, 1], N[2::2, 2] = 1.0, 1.0
    return N


@pytest.mark.parametrize("seen", ["update", "iterate"])
def test_nothing_is_learnt_of_where_the_map_as_a_whole_lies(seen: str) -> None:
    """However unsure that is: the same estimate, and the same uncertainty of it in the end."""
    sigma, (sure, unsure) = 0.2, (make_filter(FilterConfig(kind="fej")) for _ in range(2))
    unsure.cov[:3, :3] += sigma**2 * np.eye(3)
    life = Life(sure, unsure, seed=1)
    life.live("augment", *(seen if step == "update" else step for step in life.rng.choice(STEPS, 100)))
    size = sure.size
    assert size > 30
    np.testing.assert_allclose(unsure.mean[:size], sure.mean[:size], atol=1e-8)
    N = unobservable(sure.first)
    gained = unsure.cov[:size, :size] - sure.cov[:size, :size]
    np.testing.assert_allclose(gained, sigma**2 * N @ N.T, atol=1e-8)
