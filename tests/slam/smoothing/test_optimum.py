"""The batch optimum of a pose graph: derivatives, a dense solution, wrong factors, and what has no optimum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import wrapped
from mecp_env.slam.smoothing.optimum import Links, PoseGraph, Sightings, SmoothingError, smooth
from tests.slam import make
from tests.slam.smoothing.make import drive, error_m

SEEDS = range(4)


def moved(graph: PoseGraph, numbers: Array) -> PoseGraph:
    """The graph with all unknowns changed by `numbers`."""
    n = len(graph.T_map_laser)
    poses, places = numbers[: 3 * n].reshape(n, 3), numbers[3 * n :].reshape(-1, 2)
    return replace(graph, T_map_laser=graph.T_map_laser + poses, p_map=graph.p_map + places)


def whitened(graph: PoseGraph) -> Array:
    """All errors divided by their sigmas, one below the other."""
    T, roots = graph.T_map_laser, np.linalg.cholesky
    parts = [
        np.einsum("kji,kj->ki", roots(links.information), links.errors(T)[0]).ravel()
        for links in (graph.odometry, graph.registrations)
    ]
    seen = graph.sightings.errors(T, graph.p_map)[0].ravel()
    off = T[0] - graph.priors.T_map_laser
    off[2] = wrapped(off[2])
    joint = roots(graph.sightings.information.toarray()).T
    return np.concatenate([*parts, joint @ seen, roots(graph.priors.information).T @ off])


@pytest.mark.parametrize("heading", [0.3, 3.1415, -3.1415])
def test_derivatives_of_the_factors(heading: float) -> None:
    T = np.array([[0.2, -0.4, heading], [1.1, 0.6, -heading + 0.2]])
    links = Links.of([(0, 1, np.array([0.7, 0.1, 3.1]), np.eye(3))])
    _, by_start, by_end = links.errors(T)
    numeric = make.slopes(lambda poses: links.errors(poses)[0][0], T)
    np.testing.assert_allclose(np.hstack([by_start[0], by_end[0]]), numeric, atol=1e-7)

    seen = Sightings.of([(1, np.array([0]), np.array([[1.0, 3.1]]), np.eye(2))])
    p_map = np.array([[-2.0, 1.5]])
    _, by_pose, by_point = seen.errors(T, p_map)
    np.testing.assert_allclose(
        by_pose[0], make.slopes(lambda poses: seen.errors(poses, p_map)[0][0], T)[:, 3:], atol=1e-7
    )
    np.testing.assert_allclose(by_point[0], make.slopes(lambda places: seen.errors(T, places)[0][0], p_map), atol=1e-7)


def test_the_optimum_is_that_of_a_dense_solver() -> None:
    graph = drive(seed=1, poses=16, landmarks=4).graph
    found = smooth(graph, gate_probability=None, settled=1e-10)
    limits = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-12}
    dense = moved(graph, least_squares(lambda x: whitened(moved(graph, x)), np.zeros(graph.size), **limits).x)
    off = found.T_map_laser - dense.T_map_laser
    off[:, 2] = wrapped(off[:, 2])
    np.testing.assert_allclose(off, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.p_map, dense.p_map, atol=1e-6)


def test_wrong_associations_count_little() -> None:
    robust, plain = [], []
    for seed in SEEDS:
        one, rng = drive(seed), np.random.default_rng(seed)
        seen = one.graph.sightings
        wrong = rng.choice(len(seen.z), len(seen.z) // 20, replace=False)
        landmark = seen.landmark.copy()
        landmark[wrong] = (landmark[wrong] + 1) % len(one.p_map)
        graph = replace(one.graph, sightings=replace(seen, landmark=landmark))
        robust.append(error_m(smooth(graph).T_map_laser, one.T_map_laser))
        plain.append(error_m(smooth(graph, None).T_map_laser, one.T_map_laser))
    assert np.mean(robust) < 0.05 < np.mean(plain)
    assert np.max(robust) < 0.1


def test_a_robot_that_was_carried_is_no_odometry() -> None:
    one = drive(seed=4, landmarks=2)
    odometry = one.graph.odometry
    carried = odometry.T_start_end.copy()
    carried[20] += [2.0, -1.0, 1.0]
    parts = one.graph.registrations
    kept = ~((parts.start <= 20) & (parts.end > 20))
    names = "start", "end", "T_start_end", "information"
    parts = replace(parts, **{name: getattr(parts, name)[kept] for name in names})
    graph = replace(one.graph, odometry=replace(odometry, T_start_end=carried), registrations=parts)
    assert error_m(smooth(graph).T_map_laser, one.T_map_laser) < 0.05
    assert error_m(smooth(graph, None).T_map_laser, one.T_map_laser) > 0.1


def test_the_noise_of_the_odometry_is_estimated() -> None:
    graph = drive(seed=5, poses=300).graph
    told = replace(graph, odometry=replace(graph.odometry, information=9.0 * graph.odometry.information))
    assert smooth(graph).odometry_scale == pytest.approx(1.0, abs=0.3)
    assert smooth(told).odometry_scale == pytest.approx(9.0, rel=0.4)


def test_what_has_no_optimum_is_an_error() -> None:
    graph = drive(seed=6).graph
    with pytest.raises(SmoothingError, match="after 2 steps"):
        smooth(graph, steps=2, settled=1e-9)
    factors = {name: getattr(graph, name) for name in ("odometry", "registrations", "sightings")}
    loose = {name: replace(one, information=0.0 * one.information) for name, one in factors.items()}
    with pytest.raises(SmoothingError, match="solution"):
        smooth(replace(graph, **loose))
    broken = graph.T_map_laser.copy()
    broken[3] = np.nan
    with pytest.raises(SmoothingError):
        smooth(replace(graph, T_map_laser=broken))
    with pytest.raises(SmoothingError, match="singular"):
        Links.of([(0, 1, np.zeros(3), np.zeros((3, 3)))])
