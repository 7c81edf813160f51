"""Products as plain loops, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.core.linalg import add_product, pick_lower, product

SIZES = [(1, 1, 1), (2, 4, 3), (5, 7, 5), (8, 3, 9), (31, 18, 31)]


@pytest.mark.parametrize(("m", "depth", "n"), SIZES)
def test_products_are_those_of_numpy(m: int, depth: int, n: int) -> None:
    rng = np.random.default_rng(m)
    A, B, C = rng.normal(size=(m, depth)), rng.normal(size=(depth, n)), rng.normal(size=(m, n))
    np.testing.assert_allclose(product(A, B), A @ B, rtol=0.0, atol=1e-12)
    total = C.copy()
    add_product(total, A, B, 0, False)
    np.testing.assert_allclose(total, C + A @ B, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 5, 32])
def test_a_lower_product_is_right_up_to_the_diagonal(m: int) -> None:
    rng = np.random.default_rng(m)
    A, C = rng.normal(size=(m, 6)), rng.normal(size=(m, m))
    total = C.copy()
    add_product(total, A, np.ascontiguousarray(A.T), 0, True)
    np.testing.assert_allclose(np.tril(total), np.tril(C + A @ A.T), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("first", [0, 3])
def test_a_part_of_a_covariance_is_picked_and_changed_in_place(first: int) -> None:
    rng = np.random.default_rng(first)
    P, A, numbers = rng.normal(size=(9, 9)), rng.normal(size=(4, 5)), np.array([1, 2, 5, 8])
    picked = np.full((first + 5, first + 5), 7.0)
    pick_lower(P, numbers, picked, first)
    add_product(picked, A, np.ascontiguousarray(A.T), first, True)
    part = slice(first, first + 4)
    np.testing.assert_allclose(np.tril(picked[part, part]), np.tril(P[np.ix_(numbers, numbers)] + A @ A.T), atol=1e-12)
    assert (picked[:first] == 7.0).all()
    assert (picked[:, :first] == 7.0).all()
    assert (picked[first + 4 :] == 7.0).all()
