"""Derivatives against central differences, the exponential map against expm, the filters against their dense twins."""

import numpy as np
import pytest

from mecp_env.slam.filters.models import linearise, retract
from tests.slam import make
from tests.slam.filters.conftest import Pair
from tests.slam.filters.twin import exp_map, expected, wrap

SLOTS = np.array([0, 3, 2])
STEPS = ("predict", "slip", "update", "augment", "merge", "remove", "pin", "place", "loosen", "shift")


def random_state(rng: np.random.Generator, landmarks: int = 4) -> np.ndarray:
    x = rng.normal(size=3 + 2 * landmarks) * 3.0
    x[0] = rng.uniform(-np.pi, np.pi)
    return x


def retracted(x: np.ndarray, xi: np.ndarray, invariant: bool) -> np.ndarray:
    moved = x.copy()
    retract(moved, len(x), xi, invariant)
    return moved


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-3, 0.0099, 0.0101, 0.5, -3.0])
def test_exponential_is_that_of_the_matrix_group(turn):
    rng = np.random.default_rng(0)
    x, xi = random_state(rng), rng.normal(size=11)
    xi[0] = turn
    difference = retracted(x, xi, True) - exp_map(x, xi)
    difference[0] = wrap(difference[0])
    np.testing.assert_allclose(difference, 0.0, atol=1e-13)


@pytest.mark.parametrize("invariant", [True, False])
def test_measurement_jacobian(invariant):
    rng = np.random.default_rng(3)
    for _ in range(20):
        x, xi = random_state(rng), np.zeros(11)
        h, A, a_heading = np.empty((3, 2)), np.empty((3, 2, 2)), np.empty((3, 2))
        linearise(x, SLOTS, invariant, h, A, a_heading)
        H = np.zeros((3, 2, 11))
        H[:, :, 0], H[:, :, 1:3] = a_heading, -A
        for k, slot in enumerate(SLOTS):
            H[k, :, 3 + 2 * slot : 5 + 2 * slot] = A[k]
        numeric = make.slopes(lambda e, x=x: expected(retracted(x, e, invariant), SLOTS), xi)
        np.testing.assert_allclose(wrap(h - expected(x, SLOTS)), 0.0, atol=1e-12)
        np.testing.assert_allclose(H, numeric, atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_same_belief_as_the_dense_twin(kind, seed):
    """Whatever happens to both, in any order, and with more landmarks than there was room for at first."""
    pair = Pair(kind, seed)
    for step in [*pair.rng.choice(STEPS, 80), "crowd", "update"]:
        pair.augment(60) if step == "crowd" else pair.live(step)
        assert pair.ids.tolist() == pair.twin.ids
        np.testing.assert_allclose(wrap(pair.mean - pair.twin.x)[0], 0.0, atol=1e-9, err_msg=step)
        np.testing.assert_allclose(pair.mean[1:], pair.twin.x[1:], atol=1e-9, err_msg=step)
        np.testing.assert_allclose(pair.cov, pair.twin.P, atol=1e-9, err_msg=step)
