"""The relaxation of CLIPPER."""

import numpy as np
import pytest

from benchmarks.clipper import densest


@pytest.mark.parametrize("seed", range(3))
def test_a_planted_clique_is_found(seed: int) -> None:
    rng, n, size = np.random.default_rng(seed), 40, 12
    joined = np.triu(rng.uniform(size=(n, n)) < 0.2, 1)
    planted = np.sort(rng.choice(n, size, replace=False))
    joined[np.ix_(planted, planted)] = np.triu(np.ones((size, size), np.bool_), 1)
    affinity = np.where(joined | joined.T, 1.0, 0.0)
    assert densest(affinity).tolist() == planted.tolist()


def test_what_is_selected_has_no_missing_edge_and_nothing_is_selected_of_nothing() -> None:
    rng = np.random.default_rng(7)
    joined = np.triu(rng.uniform(size=(25, 25)) < 0.5, 1)
    affinity = np.where(joined | joined.T, rng.uniform(0.5, 1.0, (25, 25)), 0.0)
    affinity = 0.5 * (affinity + affinity.T)
    chosen = densest(affinity)
    among = affinity[np.ix_(chosen, chosen)]
    assert (among[~np.eye(len(chosen), dtype=bool)] > 0.0).all()
    assert len(chosen) >= 3
    assert len(densest(np.zeros((0, 0)))) == 0
    assert len(densest(np.zeros((3, 3)))) == 1
