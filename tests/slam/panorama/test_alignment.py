"""The compiled registration against plain twins: nearest points, pairs, normal equations, points on free floor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mecp_env.core.se2 import to_map, wrap_angle
from mecp_env.slam.panorama.registration import align, count_against, index_of, nearest


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_point_is_that_of_a_search_of_all(seed):
    rng = np.random.default_rng(seed)
    scale = rng.choice([0.3, 4.0, 60.0])
    points = scale * rng.normal(size=(rng.integers(1, 400), 2))
    index, reach = index_of(points), float(rng.uniform(0.01, 0.5) * scale)
    for x, y in 1.3 * scale * rng.normal(size=(200, 2)):
        far = np.hypot(points[:, 0] - x, points[:, 1] - y)
        found = nearest(points, index, x, y, reach)
        assert found == (int(np.argmin(far)) if far.min() < reach else -1)


def test_points_in_one_place_are_one_cell():
    points = np.zeros((5, 2))
    assert nearest(points, index_of(points), 0.05, 0.0, 0.1) in range(5)
    assert nearest(points, index_of(points), 0.05, 0.0, 0.04) == -1


def surfaces(rng, count):
    """Points on the walls of a room with their normals, every fifth on no flat surface."""
    along, side = rng.uniform(-2.0, 2.0, count), rng.integers(0, 4, count)
    turn = 0.5 * math.pi * side
    normals = np.stack([-np.cos(turn), -np.sin(turn)], axis=1)
    points = -2.0 * normals + along[:, None] * normals[:, ::-1] * [1.0, -1.0] + rng.normal(0.0, 0.005, (count, 2))
    normals[::5] = 0.0
    return points, normals, rng.uniform(0.005, 0.02, count)


def plain_align(past, now, T, prior, reaches, limits):
    """Plain twin of `align`, with a k-d tree, arrays and a general solver."""
    (reach, near), (facing, least), tree = reaches, limits, cKDTree(past[0])
    for _ in range(2 * math.ceil(math.log2(reach / near)) + 4):
        points, turned = to_map(T, now[0]), to_map(np.array([0.0, 0.0, T[2]]), now[1])
        distance, at = tree.query(points, distance_upper_bound=reach)
        mine = np.flatnonzero(np.isfinite(distance))
        theirs = at[mine]
        loose = ~(turned[mine].any(axis=1) & past[1][theirs].any(axis=1))
        alike = loose | ((turned[mine] * past[1][theirs]).sum(axis=1) > facing)
        mine, theirs = mine[alike], theirs[alike]
        if len(mine) < least:
            return None
        information, push = np.zeros((3, 3)), np.zeros(3)
        for i, j in zip(mine, theirs, strict=True):
            sigma = math.hypot(now[2][i], past[2][j])
            for normal in past[1][j : j + 1] if past[1][j].any() else np.eye(2):
                arm, off = points[i] - T[:2], normal @ (points[i] - past[0][j])
                J = np.array([*normal, normal[1] * arm[0] - normal[0] * arm[1]])
                weight = 1.0 / (sigma**2 + off**2 * (sigma / max(sigma, reach / 3.0)) ** 2)
                information, push = information + weight * np.outer(J, J), push + weight * off * J
        from_prior = T - prior[0]
        from_prior[2] = wrap_angle(from_prior[2])
        T = T - np.linalg.solve(information + prior[1], push + prior[1] @ from_prior)
        reach = max(near, reach * math.sqrt(0.5))
    return T, information, mine


@pytest.mark.parametrize("seed", range(10))
def test_alignment_is_that_of_the_plain_twin(seed):
    rng = np.random.default_rng(seed)
    past, now, motion = surfaces(rng, 300), surfaces(rng, 120), np.array([0.2, -0.1, 0.15])
    c, s = math.cos(motion[2]), math.sin(motion[2])
    turn = np.array([[c, -s], [s, c]])
    now = (now[0] - motion[:2]) @ turn, now[1] @ turn, now[2]
    start = motion + rng.normal(0.0, 0.05, 3)
    prior = start, np.diag([25.0, 25.0, 100.0])
    given = prior, (0.5, 0.05), (0.7, 40)
    T, information, meets = align(past, index_of(past[0]), now, start, *given)
    expected = plain_align(past, now, start, *given)
    assert np.allclose(T, expected[0], atol=1e-6)
    assert np.allclose(information, expected[1], rtol=1e-4, atol=1e-4 * information.max())
    assert np.flatnonzero(meets).tolist() == expected[2].tolist()
    assert np.allclose(T, motion, atol=0.02)


def test_with_too_few_pairs_none_is_paired():
    rng = np.random.default_rng(0)
    past, now = surfaces(rng, 100), surfaces(rng, 30)
    start = np.array([9.0, 0.0, 0.0])
    _, _, meets = align(past, index_of(past[0]), now, start, (start, np.eye(3)), (0.5, 0.05), (0.7, 10))
    assert not meets.any()


def test_points_on_floor_that_was_seen_free_are_counted():
    rng, bearings = np.random.default_rng(0), np.linspace(-1.5, 1.5, 181)
    ranges, points, alone = rng.uniform(1.0, 5.0, 181), 3.0 * rng.normal(size=(500, 2)), rng.random(500) < 0.7
    bearing = np.arctan2(points[:, 1], points[:, 0])
    inside = (bearing > bearings[0]) & (bearing < bearings[-1])
    seen = np.interp(bearing, bearings, ranges)
    expected = int((alone & inside & (np.hypot(*points.T) < seen - 0.1)).sum())
    assert count_against(points, alone, bearings, ranges, 0.1) == expected > 20
