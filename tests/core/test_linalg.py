"""Small systems against NumPy; of products, what the filters beside their twins do not tell."""

import numpy as np
import pytest

from mecp_env.core.linalg import changed_part, inverse3, low_rank, own_blocks, product, sandwich, solve3


@pytest.mark.parametrize(("m", "depth", "n"), [(1, 1, 1), (8, 3, 9), (31, 18, 31)])
def test_a_product_is_that_of_numpy_for_odd_numbers_of_rows_too(m: int, depth: int, n: int) -> None:
    rng = np.random.default_rng(m)
    A, B = rng.normal(size=(m, depth)), rng.normal(size=(depth, n))
    np.testing.assert_allclose(product(A, B), A @ B, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("depth", [1, 4, 7, 34])
def test_own_blocks_are_to_the_bit_those_of_the_whole(depth: int) -> None:
    rng = np.random.default_rng(depth)
    P, A, B = (rng.normal(size=size) for size in ((20, 20), (8, depth), (8, depth)))
    numbers, first = np.array([3, 4, 5, 6, 9, 10, 17, 18]), 3
    whole, some = np.zeros((11, 11)), np.zeros((11, 11))
    changed_part(P, numbers, A, np.ascontiguousarray(B.T), whole, first, np.arange(0, 8, 2))
    own_blocks(P, numbers, A, B, some, first)
    for i in range(first, 11, 2):
        np.testing.assert_array_equal(some[i : i + 2, i : i + 2], whole[i : i + 2, i : i + 2])


@pytest.mark.parametrize("seed", range(5))
def test_small_systems_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    J, root = rng.normal(size=(4, 3)), rng.normal(size=(3, 5)) * [[1.0], [30.0], [0.02]]
    P, g = root @ root.T, rng.normal(size=3)
    np.testing.assert_allclose(sandwich(J, P), J @ P @ J.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inverse3(P) @ P, np.eye(3), atol=1e-6)
    solved, spoilt = g.copy(), P.copy()
    solve3(spoilt, solved)
    np.testing.assert_allclose(solved, np.linalg.solve(P + np.diag(1e-6 * np.diag(P)), g), rtol=1e-6)


def test_what_is_left_out_of_a_matrix_is_less_than_the_rounding() -> None:
    rng = np.random.default_rng(3)
    turned, _ = np.linalg.qr(rng.normal(size=(30, 30)))
    A = turned @ np.diag(0.1 ** np.arange(30)) @ turned.T
    Q, R = low_rank(A.copy(), 1e-6)
    assert 5 <= Q.shape[1] <= 9
    assert np.hypot.reduce(A - Q @ R).max() <= 1e-6 * np.hypot.reduce(A).max()
