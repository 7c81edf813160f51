"""Greedy joint compatibility against plain linear algebra and exhaustive search."""

import itertools

import numpy as np
import pytest

from mecp_env.slam.association.base import chi2_gate, one_to_one
from mecp_env.slam.association.joint_compatibility import best_growth, grow, likeliest
from mecp_env.slam.association.polygon_matching import plausible_rings
from mecp_env.slam.association.single_corners import (
    HERE,
    fix_rows,
    possible_pairs,
    rooms_seen,
    strike_by_room,
    strike_by_signature,
)
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief, CornerKind, FeatureState


def common_error_case(rng, wrong):
    """Four pairings that share a large common error; `wrong` of them have an individual error as well."""
    count = 4
    common = rng.normal(0.0, 1.0, 2)
    nu = np.tile(common, count) + rng.normal(0.0, 0.01, 2 * count)
    for p in wrong:
        nu[2 * p : 2 * p + 2] += (0.5, -0.5)
    S = np.kron(np.ones((count, count)), np.eye(2)) + 1e-4 * np.eye(2 * count)
    return nu, S


def test_chi2_gates_are_those_of_the_tables():
    assert np.allclose([chi2_gate(2, 0.99), chi2_gate(4, 0.95), chi2_gate(12, 0.999)], [9.21, 9.49, 32.91], atol=0.005)


def test_common_error_is_taken_out_and_the_odd_one_left():
    rng = np.random.default_rng(0)
    nu, S = common_error_case(rng, wrong=(2,))
    corner = landmark = np.arange(4)
    nis, ambiguous = best_growth(nu, S, corner, landmark, np.array([-1, 0, 1, 2, 3]), 13.8, 6.0)
    assert np.isnan(nis).tolist() == [False, False, True, False]
    assert not ambiguous.any()


def test_accepted_nis_add_up_to_the_joint_nis():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(8, 8))
    S = A @ A.T + np.eye(8)
    nu = 0.5 * rng.normal(size=8)
    nis, _ = grow(nu, S, np.arange(4), np.arange(4), np.empty(0, np.int64), 1e9, 0.0)
    assert np.isclose(nis.sum(), nu @ np.linalg.solve(S, nu))


def test_a_corner_with_two_equal_choices_is_ambiguous_and_paired_with_neither():
    nu = np.array([0.1, 0.0, 0.1, 0.0])
    S = np.eye(4)
    nis, ambiguous = grow(nu, S, np.array([0, 0]), np.array([0, 1]), np.empty(0, np.int64), 13.8, 6.0)
    assert np.isnan(nis).all()
    assert ambiguous.any()


def test_no_corner_and_no_landmark_is_used_twice():
    rng = np.random.default_rng(2)
    corner, landmark = np.array(list(itertools.product(range(4), range(5)))).T
    corner, landmark = np.ascontiguousarray(corner), np.ascontiguousarray(landmark)
    A = rng.normal(size=(40, 40))
    nis, _ = grow(rng.normal(size=40), A @ A.T + np.eye(40), corner, landmark, np.empty(0, np.int64), 13.8, 0.0)
    kept = ~np.isnan(nis)
    assert len(set(corner[kept])) == kept.sum() == len(set(landmark[kept]))


def test_one_to_one_takes_the_smallest_first():
    cost = np.array([[1.0, 2.0], [0.5, 9.0], [20.0, 20.0]])
    assert one_to_one(cost, 13.8).tolist() == [1, 0, -1]


def compatible(heading, convex, seen, known_convex, known, tolerance):
    nis = np.zeros((len(seen), len(known)))
    strike_by_signature(nis, heading, convex, seen, np.arange(len(known)), known_convex, known, tolerance)
    return (nis == 0.0).tolist()


def test_signature_tells_the_two_faces_of_a_wall_apart():
    heading = 0.3
    north, south, east = np.pi / 2, -np.pi / 2, 0.0
    known = np.array([[north, east], [south, east], [np.nan, north]])
    seen = np.array([[north - heading, east - heading], [np.nan, south - heading]])
    inner = np.zeros(2, np.bool_)
    expected = [[True, False, False], [False, False, False]]
    assert compatible(heading, inner, seen, np.zeros(3, np.bool_), known, np.deg2rad(40)) == expected
    assert not np.any(compatible(heading, ~inner, seen, np.zeros(3, np.bool_), known, np.deg2rad(40)))


def test_signature_wraps_at_pi():
    seen, known = np.array([[np.pi - 0.01, np.nan]]), np.array([[-np.pi + 0.01, 0.0]])
    assert compatible(0.0, np.array([True]), seen, np.array([True]), known, 0.1) == [[True]]


def test_rooms_keep_corners_apart_but_not_those_unknown_at_home():
    nis = np.array([[1.0, 2.0], [50.0, 2.0], [1.0, 2.0]])
    seen, known = np.array([0, 0, -1]), np.array([0, 1])
    inf, kind = np.inf, np.zeros(2, np.int64)
    costs, nearest = np.empty((3, 2)), np.empty(3)
    strike_by_room(nis, costs, nearest, seen, np.arange(2), known, kind, 13.8, False)
    assert costs.tolist() == [[1.0, inf], [50.0, inf], [1.0, 2.0]]
    strike_by_room(nis, costs, nearest, seen, np.arange(2), known, kind, 13.8, True)
    assert costs.tolist() == [[1.0, inf], [50.0, 2.0], [1.0, 2.0]]
    assert nearest.tolist() == [1.0, 2.0, 1.0]


def test_a_corner_lies_here_beyond_a_gap_or_behind_a_door():
    beyond, behind = np.array([-1, 0, -1, 0]), np.array([HERE, HERE, 5, UNKNOWN_ROOM])
    assert rooms_seen(3, beyond, behind).tolist() == [3, -1, 5, -1]
    assert rooms_seen(-1, beyond, behind).tolist() == [-1, -1, 5, -1]
    assert rooms_seen(3, beyond, np.empty(0, np.int64)).tolist() == [3, -1, 3, -1]


def test_jambs_belong_to_both_rooms():
    nis, costs = np.array([[1.0, 2.0]]), np.empty((1, 2))
    kind = np.array([int(CornerKind.CROSSING), int(CornerKind.JAMB)])
    strike_by_room(nis, costs, np.empty(1), np.array([1]), np.arange(2), np.zeros(2, np.int64), kind, 13.8, False)
    assert costs.tolist() == [[np.inf, 2.0]]


def test_possible_pairs_keep_the_fixed_ones_and_the_cheapest():
    costs = np.array([[1.0, 3.0, 99.0], [99.0, 2.0, 4.0]])
    free = np.array([-1, -1])

    def pairs(fixed, most):
        corner, row = np.empty(6, np.int64), np.empty(6, np.int64)
        count = possible_pairs(costs, 13.8, fixed, most, corner, row)
        return np.stack((corner, row), axis=1)[:count].tolist()

    assert pairs(free, 9) == [[0, 0], [0, 1], [1, 1], [1, 2]]
    assert pairs(free, 2) == [[0, 0], [1, 1]]
    assert pairs(np.array([2, -1]), 2) == [[0, 2], [1, 1]]


def test_a_polygon_fixes_the_rows_of_its_corners():
    fixed = np.empty(4, np.int64)
    fix_rows(np.array([2, 0]), np.array([7, 9]), np.array([9, 5, 7]), fixed)
    assert fixed.tolist() == [0, -1, 2, -1]


def test_the_likeliest_pairings_are_tried_after_a_free_choice():
    costs = np.array([[3.0, 1.0], [2.0, 1.0]])
    corner, landmark = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    assert likeliest(costs, corner, landmark, 0).tolist() == [-1]
    assert likeliest(costs, corner, landmark, 3).tolist() == [-1, 1, 3, 2]
    assert likeliest(costs, corner, landmark, 9).tolist() == [-1, 1, 3, 2, 0]


@pytest.mark.parametrize("seed", range(20))
def test_plausible_rings_against_every_turn_of_every_ring(seed):
    rng = np.random.default_rng(seed)
    landmarks = rng.permutation(8)
    state = np.full(8, int(FeatureState.LANDMARK))
    state[landmarks[7]] = int(FeatureState.TRACK)
    rings = np.array([rng.permutation(8)[:4] for _ in range(5)])
    nis, corners, gate = rng.uniform(0.0, 2.0, (6, 8)), rng.permutation(6)[:4], 1.5
    column = {landmark: j for j, landmark in enumerate(landmarks.tolist())}
    expected = [
        (c, np.roll(ring, -shift).tolist())
        for c, ring in enumerate(rings)
        for shift in range(4)
        if (state[ring] == int(FeatureState.LANDMARK)).all()
        and all(nis[corner, column[i]] <= gate for corner, i in zip(corners, np.roll(ring, -shift), strict=True))
    ]
    found, which = np.empty((20, 4), np.int64), np.empty(20, np.int64)
    h = plausible_rings(nis, corners, landmarks, state, rings, gate, found, which)
    assert list(zip(which[:h].tolist(), found[:h].tolist(), strict=True)) == expected


def test_rows_of_finds_ids_in_any_order():
    belief = Belief(np.zeros(3), np.eye(3), np.array([7, 2, 9]), np.zeros((3, 2)), np.zeros((3, 2, 2)))
    assert belief.rows(np.array([[9, 7], [2, 2]])).tolist() == [[2, 0], [1, 1]]
