"""Registration of constructed scans: known motions are found, open directions stay open, others are refused; twins."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mecp_env.core.se2 import to_map, wrap_angle
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.panorama import registration
from mecp_env.slam.panorama.registration import (
    RegistrationLimits,
    align,
    count_against,
    index_of,
    likelier,
    register,
    surfaces_of,
)
from tests.slam import make
from tests.slam.frontend.make import PAPER, front_end, on_walls
from tests.slam.scans import moved, ring, take_scan

CONFIG = SlamConfig()
LIMITS = RegistrationLimits.of(CONFIG)
ROOM = ring((-2.0, -1.5), (3.0, -1.5), (3.0, 0.5), (4.0, 0.5), (4.0, 2.5), (-2.0, 2.5))
CORRIDOR = np.array([[[-60.0, -1.0], [60.0, -1.0]], [[60.0, 1.0], [-60.0, 1.0]]])
PRIOR = np.diag([0.2, 0.2, 0.2]) ** 2


def surfaces_and_beams(faces, seed, max_range_m=30.0):
    beams, clusters, segments, _ = front_end(take_scan(faces, seed=seed, max_range_m=max_range_m))
    return surfaces_of(beams, segments, on_walls(clusters, beams), PAPER), beams


def registered(faces, T, prior, cov=PRIOR, other=None, **scan):
    past, beams = surfaces_and_beams(faces, 1, **scan)
    now, _ = surfaces_and_beams(moved(faces if other is None else other, T), 2, **scan)
    return register(past, now, beams, (np.asarray(prior, float), cov), LIMITS)


@pytest.mark.parametrize(("T", "off"), [((0.6, 0.2, 0.3), (0.15, -0.1, 0.2)), ((-0.4, 0.1, -0.45), (-0.1, 0.1, -0.4))])
def test_a_known_motion_is_found(T, off):
    found = registered(ROOM, T, np.add(T, off))
    error = found.T_past_now - T
    assert np.hypot(*error[:2]) < 0.01
    assert abs(wrap_angle(error[2])) < math.radians(0.3)
    assert found.share > 0.95


def test_the_error_is_as_large_as_the_covariance_says():
    nis = []
    for seed in range(20):
        past, beams = surfaces_and_beams(ROOM, 2 * seed)
        now, _ = surfaces_and_beams(moved(ROOM, (0.5, 0.2, 0.3)), 2 * seed + 1)
        found = register(past, now, beams, (np.array([0.5, 0.2, 0.3]), PRIOR), LIMITS)
        error = found.T_past_now - [0.5, 0.2, 0.3]
        nis.append(error @ np.linalg.solve(found.cov(LIMITS), error))
    assert np.mean(nis) < 3.0


def test_a_corridor_leaves_its_length_open():
    found = registered(CORRIDOR, (0.5, 0.1, 0.1), (0.6, 0.0, 0.0), max_range_m=8.0)
    cov = found.cov(LIMITS)
    assert cov[0, 0] > 0.1**2 > cov[1, 1]
    assert abs(found.T_past_now[0] - 0.6) < 0.05  # the prior decides
    assert abs(found.T_past_now[1] - 0.1) < 0.02


def test_another_place_is_refused():
    other = ring((-1.0, -4.0), (1.2, -4.0), (1.2, 5.0), (-1.0, 5.0))
    found = registered(ROOM, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), other=other)
    assert not found.is_sound((np.zeros(3), PRIOR), LIMITS)
    assert likelier(found, found, (np.zeros(3), PRIOR), (np.zeros(3), 2.0 * PRIOR), LIMITS) is None
    assert not found.is_possible((np.zeros(3), PRIOR), LIMITS)


@pytest.mark.parametrize(
    ("turn_of_flat", "turn_of_all", "expected"), [(0.1, 0.0, 0.1), (0.8, 0.1, 0.1), (0.8, None, 0.8)]
)
def test_what_the_prior_hardly_allows_is_compared_with_a_registration_of_all_points(
    monkeypatch, turn_of_flat, turn_of_all, expected
):
    """One wall alone may fit where it is not: on CSAIL it turned the pose by ten degrees, and all its points agreed."""
    past, beams = surfaces_and_beams(ROOM, 1)
    past = replace(past, normals=past.normals * (np.arange(len(past)) % 3 > 0)[:, None])  # a third is not flat
    turns = {len(past.flat()): turn_of_flat, len(past): turn_of_all}

    def register_all(past, now, past_beams, prior, limits, told=()):
        turn = turns[len(past)]
        return None if turn is None else make.registration(turn, 50)

    monkeypatch.setattr(registration, "register_all", register_all)
    assert register(past, past, beams, (np.zeros(3), PRIOR), LIMITS).T_past_now[2] == expected


@pytest.mark.parametrize(("paired", "expected"), [(170, 1.0), (110, 0.8)])
def test_many_more_points_that_agree_outweigh_the_prior(monkeypatch, paired, expected):
    """Odometry errs by more than a Gaussian: of two registrations far from the prior, points decide, not the nearer."""
    past, beams = surfaces_and_beams(ROOM, 1)

    def from_start(T, past, now, past_beams, prior, limits):
        return [make.registration(1.0, paired) if T[2] > 0.3 else make.registration(0.8, 105, 4)]

    monkeypatch.setattr(registration, "_from", from_start)
    assert register(past, past, beams, (np.zeros(3), PRIOR), replace(LIMITS, turn_rad=1.0)).T_past_now[2] == expected


@pytest.mark.parametrize(("agree", "near", "far"), [(98, True, True), (80, True, False), (5, False, False)])
def test_a_registration_is_sound_when_nearly_all_points_agree_or_most_do_and_the_prior_allows_for_it(agree, near, far):
    for x, sound in ((0.0, near), (2.0, far)):
        found = make.registration(0.0, agree, 100 - agree, x)
        assert found.is_sound((np.zeros(3), PRIOR), LIMITS) == sound


EXPECTED = make.registration(0.0, 80, 20)  # most points agree where the prior expects it
SLIPPED = make.registration(0.4, 100)  # all agree where it hardly allows it, and failed odometry does


@pytest.mark.parametrize(
    ("kept", "free", "chosen"),
    [
        pytest.param(EXPECTED, None, "kept", id="most agree"),
        pytest.param(make.registration(0.0, 60, 40), None, None, id="few agree"),
        pytest.param(make.registration(0.4, 100), None, None, id="the prior does not allow it"),
        pytest.param(EXPECTED, SLIPPED, "free", id="odometry has failed"),
        pytest.param(None, SLIPPED, "free", id="nothing where the prior expects it"),
        pytest.param(make.registration(0.0, 90, 10), SLIPPED, "kept", id="too few more for failed odometry"),
        pytest.param(None, make.registration(0.4, 35), None, id="too few of all for failed odometry"),
        pytest.param(None, make.registration(0.4, 60), "free", id="enough of all"),
        pytest.param(None, make.registration(0.4, 90, 10), None, id="failed odometry explains nearly all"),
        pytest.param(None, make.registration(0.4, 200, 0, x=2.0), None, id="farther than odometry can fail"),
    ],
)
def test_odometry_has_failed_where_that_explains_so_much_more(kept, free, chosen):
    prior, failed = (np.zeros(3), np.diag([0.02, 0.02, 0.04]) ** 2), (np.zeros(3), np.diag([0.3, 0.3, 0.3]) ** 2)
    assert likelier(kept, free, prior, failed, LIMITS) is {"kept": kept, "free": free, None: None}[chosen]


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


@pytest.mark.parametrize("seed", range(4))
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


def test_points_on_floor_that_was_seen_free_are_counted():
    rng, bearings = np.random.default_rng(0), np.linspace(-1.5, 1.5, 181)
    ranges, points, alone = rng.uniform(1.0, 5.0, 181), 3.0 * rng.normal(size=(500, 2)), rng.random(500) < 0.7
    bearing = np.arctan2(points[:, 1], points[:, 0])
    inside = (bearing > bearings[0]) & (bearing < bearings[-1])
    seen = np.interp(bearing, bearings, ranges)
    expected = int((alone & inside & (np.hypot(*points.T) < seen - 0.1)).sum())
    assert count_against(points, alone, bearings, ranges, 0.1) == expected > 20
