"""Trajectory scores against brute force, and their invariance under a change of the map frame."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import minimize

from mecp_env.core.se2 import between, chained, compose, composed, interpolated, inverse, to_map
from mecp_env.evaluation.trajectory import align, coincident, relation_error, trajectory_error
from mecp_env.logs.odometry_model import arcs, end_of, reading
from mecp_env.world.config import OdometryConfig

RNG = np.random.default_rng(4)
PATH = chained(np.column_stack((RNG.uniform(0.0, 0.3, 60), RNG.normal(0.0, 0.01, 60), RNG.normal(0.0, 0.3, 60))))
ELSEWHERE = np.array([4.0, -7.0, 2.5])
T = np.arange(len(PATH)) * 0.5


def test_many_poses_as_one_by_one() -> None:
    np.testing.assert_allclose(composed(ELSEWHERE, PATH), [compose(ELSEWHERE, pose) for pose in PATH], atol=1e-12)
    one_by_one = [compose(inverse(a), b) for a, b in itertools.pairwise(PATH)]
    np.testing.assert_allclose(between(PATH[:-1], PATH[1:]), one_by_one, atol=1e-12)
    np.testing.assert_allclose(chained(between(PATH[:-1], PATH[1:])), PATH, atol=1e-9)


def test_interpolation_takes_the_shorter_turn() -> None:
    pair = np.array([[0.0, 0.0, 3.0], [2.0, 1.0, -3.0]])
    x, y, heading = interpolated(np.array([1.0, 2.0]), pair, np.array([1.5]))[0]
    assert (x, y) == (1.0, 0.5)
    assert abs(heading) == pytest.approx(math.pi)


def test_the_error_does_not_depend_on_the_map_frame() -> None:
    noisy = PATH + RNG.normal(0.0, 0.1, PATH.shape)
    there, here = trajectory_error(composed(ELSEWHERE, noisy), PATH), trajectory_error(noisy, PATH)
    assert there.rmse_m == pytest.approx(here.rmse_m)
    assert there.rmse_rad == pytest.approx(here.rmse_rad)


def test_the_alignment_is_the_best_one() -> None:
    noisy = PATH[:, :2] + RNG.normal(0.0, 0.2, (len(PATH), 2))
    found = minimize(lambda T_a_b: ((to_map(T_a_b, noisy) - PATH[:, :2]) ** 2).sum(), np.zeros(3))
    assert align(PATH[:, :2], noisy) == pytest.approx(found.x, abs=1e-4)


def test_relations() -> None:
    true = np.array([[T[3], T[20], *compose(inverse(PATH[3]), PATH[20])], [T[0] - 1.0, T[5], 0.0, 0.0, 0.0]])
    assert relation_error(T, composed(ELSEWHERE, PATH), true) == pytest.approx((0.0, 0.0, 0.0, 0.0, 1), abs=1e-9)
    true[0, 2:] += 0.3, -0.4, 0.1
    error = relation_error(T, PATH, true)
    assert (error.mean_m, error.mean_rad, error.relations) == (pytest.approx(0.5), pytest.approx(0.1), 1)
    assert relation_error(T, PATH, true[1:]).relations == 0
    late = np.vstack((true[0], true[0] + np.array([0.2, 0.0, 0.0, 0.0, 0.0])))
    np.testing.assert_array_equal(coincident(T, late), late[:1])


@pytest.mark.parametrize(
    "motion", [(0.3, 0.02, 0.1), (-0.3, 0.05, -0.2), (0.0, 0.0, 1.0), (0.0, 0.2, 0.0), (1e-4, -0.1, 3.1)]
)
def test_two_arcs_end_at_any_pose(motion: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(end_of(arcs(np.array(motion))), motion, atol=1e-12)


def test_noise_is_that_of_the_model() -> None:
    model, increments = OdometryConfig(), arcs(np.array([0.4, 0.03, 0.2]))
    odometry = reading(increments, model)
    np.testing.assert_array_equal(odometry.increments, increments)
    path = increments[:, 0].sum() + model.turn_m * 0.2 / (math.pi / 2.0)
    expected = path * np.array([model.distance_sigma_m, math.radians(model.turn_sigma_deg)]) ** 2
    np.testing.assert_allclose(odometry.cov.sum(axis=0).diagonal(), expected, rtol=1e-4)
    rng = np.random.default_rng(0)
    drawn = np.array([reading(increments, model, rng).increments.sum(axis=0) for _ in range(4000)])
    np.testing.assert_allclose(drawn.var(axis=0), expected, rtol=0.1)
