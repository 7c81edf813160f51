"""The tests of association: single, joint, iterated joint, and the mean of Gaussians of a polygon."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.slam.filters.conftest import Pair, lost, random_cov
from tests.slam.filters.twin import J, expected, rotation


def test_individual_nis_is_that_of_each_pair(pair):
    z, R, _ = pair.scan(4)
    blocks = np.stack([R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(4)])
    nis = pair.filter.individual_nis(z, blocks, pair.ids)
    assert nis.shape == (4, 6)
    for i in range(4):
        for j, landmark in enumerate(pair.ids):
            nu, S = pair.filter.innovation(z[i : i + 1], blocks[i], np.array([landmark]))
            single = nu @ np.linalg.solve(S, nu)
            assert nis[i, j] == pytest.approx(single, rel=1e-9) or (np.isinf(nis[i, j]) and single > 1e4)


def test_linear_joint_nis_is_the_innovation_squared(pair):
    z, R, ids = pair.scan(4)
    nu, S = pair.filter.innovation(z, R, ids)
    assert pair.filter.joint_nis(z, R, ids) == pytest.approx(nu @ np.linalg.solve(S, nu), rel=1e-10)


def test_bayes_factor_is_that_of_a_loosened_copy(pair):
    z, R, ids = pair.scan(4)
    slack = np.array([[0.3, 0.1, 0.0], [0.1, 0.2, 0.05], [0.0, 0.05, 0.1]])
    loose = pair.filter.copy()
    loose.loosen(slack)
    costs = [some.joint_nis(z, R, ids) for some in (pair.filter, loose)]
    spreads = [np.linalg.slogdet(some.innovation(z, R, ids)[1])[1] for some in (pair.filter, loose)]
    plain = (costs[0] + spreads[0]) - (costs[1] + spreads[1])
    assert pair.filter.log_bayes_factor(z, R, ids, slack) == pytest.approx(plain, rel=1e-6)
    assert pair.filter.log_bayes_factor(z, R, ids, 1e-9 * slack) == pytest.approx(0.0, abs=1e-5)


def iterated(pair, z, R, iterations):
    pair.filter.update_iterations = iterations
    return pair.filter.joint_nis(z, R, pair.ids, iterate=True)


@pytest.mark.parametrize(
    ("kind", "heading_error", "off"),
    [("ekf", 0.1, 1e-5), ("ekf", -1.0, 1e-5), ("riekf", 0.0, 0.02), ("riekf", 0.5, 0.02)],
)
def test_iterated_joint_nis_is_the_least_cost(kind, heading_error, off):
    """That of the twin; for the invariant error, however unsure the map as a whole is."""
    pair, z, R = lost(kind, heading_error)
    z = z + pair.rng.normal(size=z.shape) * [0.02, 0.005]
    nis = iterated(pair, z, R, 20)
    assert nis == pytest.approx(pair.twin.update(z, R, pair.ids, iterate=True), rel=off)
    assert iterated(pair, z, R, 4) == pytest.approx(nis, rel=1e-2)
    if kind == "riekf":
        pair.filter.cov[0, 0] += 0.1
        assert iterated(pair, z, R, 20) == pytest.approx(nis, rel=1e-6)


def test_iterated_test_keeps_the_truth_under_a_heading_error(kind):
    """Derivations 3.2: the linear joint test rejects the true match at 17 degrees, because the poses form an arc."""
    gate, kept = chi2.ppf(0.99, 10), {1: 0, 2: 0, 6: 0}
    for seed in range(150):
        rng = np.random.default_rng(seed)
        pair, z, R = lost(kind, 0.3 * rng.normal(), seed=1)
        z = z + rng.normal(size=z.shape) * [0.02, 0.005]
        for iterations in kept:
            kept[iterations] += iterated(pair, z, R, iterations) < gate
    assert kept[1] < 75
    assert min(kept[2], kept[6]) > (140 if kind == "riekf" else 90)


def test_one_wrong_vertex_is_refused(kind):
    pair, z, R = lost(kind, 0.2)
    wrong = z.copy()
    wrong[2] += [0.5, 0.0]
    assert iterated(pair, z, R, 6) < chi2.ppf(0.99, 10)
    assert iterated(pair, wrong, R, 6) > chi2.ppf(0.999, 10)


def centre_twin(pair: Pair, z: np.ndarray, R: np.ndarray, slots: np.ndarray, paper_S: bool) -> float:
    """Derivations 3.1 in world coordinates, dense: S_obs + S_map - C - C^T."""
    k, P, x = len(slots), pair.twin.world_cov(), pair.twin.x
    body = z[:, :1] * np.stack([np.cos(z[:, 1]), np.sin(z[:, 1])], axis=1)
    seen = (x[1:3] + body @ rotation(x[0]).T).mean(axis=0)
    G = np.column_stack([np.eye(2), J @ (seen - x[1:3])])
    B = np.zeros((2, 2 * k))
    for i, (r, b) in enumerate(z):
        Jz = np.array([[np.cos(b), -r * np.sin(b)], [np.sin(b), r * np.cos(b)]])
        B[:, 2 * i : 2 * i + 2] = rotation(x[0]) @ Jz / k
    M = np.zeros((2, P.shape[0]))
    for slot in slots:
        M[:, 3 + 2 * slot : 5 + 2 * slot] = np.eye(2) / k
    C = G @ P[:3] @ M.T
    S = G @ P[:3, :3] @ G.T + B @ R @ B.T + M @ P @ M.T - (0.0 if paper_S else C + C.T)
    nu = seen - x[3:].reshape(-1, 2)[slots].mean(axis=0)
    return float(nu @ np.linalg.solve(S, nu))


@pytest.mark.parametrize("paper_S", [True, False])
def test_mean_of_gaussians(kind, paper_S):
    pair = Pair(kind, seed=6)
    slots = np.array([3, 0, 5, 2])
    z = expected(pair.twin.x, slots)
    R = random_cov(pair.rng, np.tile([0.05, 0.01], 4))
    noisy = z + 0.05 * pair.rng.multivariate_normal(np.zeros(8), R).reshape(4, 2)
    nis = pair.filter.mean_of_gaussians_nis(noisy, R, pair.ids[slots], paper_S)
    tolerance = 1e-9 if paper_S or kind == "ekf" else 2e-3  # the others leave out J nu, which vanishes with the noise
    assert nis == pytest.approx(centre_twin(pair, noisy, R, slots, paper_S), rel=tolerance)
    shifted = pair.filter.mean_of_gaussians_nis(np.roll(noisy, 1, axis=0), np.eye(8) * 1e-4, pair.ids[slots])
    unshifted = pair.filter.mean_of_gaussians_nis(noisy, np.eye(8) * 1e-4, pair.ids[slots])
    assert shifted == pytest.approx(unshifted)  # the centre does not depend on the order of the vertices


def test_the_paper_gate_is_too_wide(kind):
    """Derivations 3.1: without the cross term of pose and map the gate is too wide."""
    pair, z, R = lost(kind, 0.0)
    z[:, 0] += 0.3
    full = pair.filter.mean_of_gaussians_nis(z, R, pair.ids)
    assert pair.filter.mean_of_gaussians_nis(z, R, pair.ids, paper_S=True) < full
