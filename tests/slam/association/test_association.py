"""Greedy joint compatibility against plain linear algebra and exhaustive search."""

import itertools

import numpy as np
import pytest

from mecp_env.slam.association.gating import (
    FIXED,
    HERE,
    MatchBuilder,
    greedy_joint_compatibility,
    mask_by_descriptor,
    mask_by_room,
)
from mecp_env.slam.association.mecp import PolygonMatcher, accept, polygon_hypotheses
from mecp_env.slam.config import AssociationConfig, FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.messages import UNKNOWN_ROOM, CornerKind, FeatureState, Reason
from tests.slam import make
from tests.slam.make import polar

NONE = np.empty(0, np.int64)


def features_of(n, **columns):
    """(n,) features with these columns, otherwise zero."""
    return make.features(n, **columns).rows


def test_accepted_nis_add_up_to_the_joint_nis():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(8, 8))
    S = A @ A.T + np.eye(8)
    nu = 0.5 * rng.normal(size=8)
    nis, _ = greedy_joint_compatibility(nu, S, np.arange(4), np.arange(4), NONE, 1e9, 0.0)
    assert np.isclose(nis.sum(), nu @ np.linalg.solve(S, nu))


def test_a_corner_with_two_equal_choices_is_ambiguous_and_paired_with_neither():
    nu = np.array([0.1, 0.0, 0.1, 0.0])
    S = np.eye(4)
    nis, ambiguous = greedy_joint_compatibility(nu, S, np.array([0, 0]), np.array([0, 1]), NONE, 13.8, 6.0)
    assert np.isnan(nis).all()
    assert ambiguous.any()


def test_no_corner_and_no_landmark_is_used_twice():
    rng = np.random.default_rng(2)
    corner, landmark = np.array(list(itertools.product(range(4), range(5)))).T
    corner, landmark = np.ascontiguousarray(corner), np.ascontiguousarray(landmark)
    A = rng.normal(size=(40, 40))
    S = A @ A.T + np.eye(40)
    nis, _ = greedy_joint_compatibility(rng.normal(size=40), S, corner, landmark, NONE, 13.8, 0.0)
    kept = ~np.isnan(nis)
    assert len(set(corner[kept])) == kept.sum() == len(set(landmark[kept]))


def compatible(heading, convex, seen, features, tolerance):
    nis = np.zeros((len(seen), len(features)))
    mask_by_descriptor(nis, convex, seen, heading, np.arange(len(features)), features, tolerance)
    return (nis == 0.0).tolist()


def test_the_descriptor_separates_the_two_faces_of_a_wall():
    heading = 0.3
    north, south, east = np.pi / 2, -np.pi / 2, 0.0
    features = features_of(3, normals=[[north, east], [south, east], [np.nan, north]])
    seen = np.array([[north - heading, east - heading], [np.nan, south - heading]])
    inner = np.zeros(2, np.bool_)
    expected = [[True, False, False], [False, False, False]]
    assert compatible(heading, inner, seen, features, np.deg2rad(40)) == expected
    assert not np.any(compatible(heading, ~inner, seen, features, np.deg2rad(40)))


def test_the_descriptor_wraps_at_pi():
    seen, features = np.array([[np.pi - 0.01, np.nan]]), features_of(1, normals=[[-np.pi + 0.01, 0.0]], convex=True)
    assert compatible(0.0, np.array([True]), seen, features, 0.1) == [[True]]


def masked(nis, features, home_gate, home=0, beyond=None, behind=NONE):
    beyond, costs = np.full(len(nis), -1) if beyond is None else np.array(beyond), np.empty(nis.shape)
    mask_by_room(nis, costs, home, beyond, behind, np.arange(len(features)), features, home_gate)
    return costs.tolist()


def test_rooms_keep_corners_apart_but_not_those_unknown_at_home():
    nis = np.array([[1.0, 2.0], [50.0, 2.0], [1.0, 2.0]])
    features, beyond, inf = features_of(2, room=[0, 1]), [-1, -1, 0], np.inf
    assert masked(nis, features, inf, beyond=beyond) == [[1.0, inf], [50.0, inf], [1.0, 2.0]]
    assert masked(nis, features, 13.8, beyond=beyond) == [[1.0, inf], [50.0, 2.0], [1.0, 2.0]]


def test_a_corner_is_here_beyond_a_gap_or_behind_a_door():
    nis, features = np.ones((4, 3)), features_of(3, room=[3, 5, 7])
    gap, behind = [-1, 0, -1, 0], np.array([HERE, HERE, 5, UNKNOWN_ROOM])

    def rooms(*corners, **where):
        costs = np.array(masked(nis, features, np.inf, beyond=gap, **where))
        return [features["room"][costs[i] < np.inf].tolist() for i in range(4)]

    assert rooms(home=3, behind=behind) == [[3], [3, 5, 7], [5], [3, 5, 7]]
    assert rooms(home=UNKNOWN_ROOM, behind=behind) == [[3, 5, 7], [3, 5, 7], [5], [3, 5, 7]]
    assert rooms(home=3) == [[3], [3, 5, 7], [3], [3, 5, 7]]


def test_jambs_belong_to_both_rooms():
    features = features_of(2, kind=[int(CornerKind.CROSSING), int(CornerKind.JAMB)])
    assert masked(np.array([[1.0, 2.0]]), features, np.inf, home=1) == [[np.inf, 2.0]]


def test_pairs_of_a_polygon_are_accepted_first_and_have_its_reason():
    corner, ids = np.array([0, 0, 1]), np.array([70, 71, 71])
    innovation = np.array([1.0, 0.0, 0.1, 0.0, 0.1, 0.0]), np.eye(6)

    def accepted(cost):
        builder = MatchBuilder(2)
        accept(innovation, corner, ids, np.array(cost), 13.8, 6.0, builder.rows)
        match = builder.match()
        return match.ids.tolist(), match.reason.tolist()

    polygon, joint = int(Reason.POLYGON), int(Reason.JOINT)
    assert accepted([FIXED, np.inf, 0.01]) == ([70, 71], [polygon, joint])
    assert accepted([1.0, 0.01, 0.01])[0] == [70, 71]


@pytest.mark.parametrize("seed", range(8))
def test_polygon_hypotheses_against_every_turn_of_every_map_polygon(seed):
    rng = np.random.default_rng(seed)
    landmarks = rng.permutation(8)[:7]  # and a track
    rings = np.array([rng.permutation(8)[:4] for _ in range(5)])
    nis, corners, gate = rng.uniform(0.0, 2.0, (6, 7)), rng.permutation(6)[:4], 1.5
    column = {landmark: j for j, landmark in enumerate(landmarks.tolist())}
    expected = [
        (c, np.roll(ring, -shift).tolist())
        for c, ring in enumerate(rings)
        for shift in range(4)
        if set(ring) <= column.keys()
        and all(nis[corner, column[i]] <= gate for corner, i in zip(corners, np.roll(ring, -shift), strict=True))
    ]
    found, which = np.empty((21, 4), np.int64), np.empty(21, np.int64)
    h = polygon_hypotheses(nis, corners, landmarks, 8, rings, gate, found, which)
    assert list(zip(which[:h].tolist(), found[:h].tolist(), strict=True)) == expected


@pytest.mark.parametrize(("moved_m", "known"), [(0.0, True), (0.5, False)])
def test_a_polygon_is_recognised_where_its_vertices_fit_together(moved_m, known):
    """By a filter whose pose is known to 0.5 m and 0.1 rad."""
    p_robot, R = np.array([(4.0, 3.0), (-3.0, 4.0), (-5.0, -2.0), (3.0, -4.0)]), np.diag(np.tile([1e-4, 1e-5], 4))
    belief = make_filter(FilterConfig(prior_sigma_m=0.5, prior_sigma_rad=0.1))
    belief.augment(polar(p_robot), R, np.arange(4))
    belief.predict(make.odometry(sigmas=(0.5, 0.1), bumper=True))
    table = make.features(4, state=FeatureState.LANDMARK, normals=(0.0, 1.5), convex=1)
    corners = make.corners(points=p_robot + np.outer(np.arange(4) == 2, (moved_m, 0.0)), cov=R)
    view = make.view(belief.belief(), table, corners, make.graph(), [range(4)])
    matcher = PolygonMatcher(AssociationConfig(), corners, view, belief, np.zeros((4, 4)), make.polygon_test())
    found = matcher.first_match((make.polygon(range(4)),))
    assert (found is not None and found.ids.tolist() == [0, 1, 2, 3]) == known
