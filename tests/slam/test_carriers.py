"""The small compiled functions behind the messages, against NumPy: indices, covariance blocks, rows of ids."""

import math

import numpy as np
import pytest

from mecp_env.core.arrays import find_equal, find_rows
from mecp_env.core.linalg import downdate
from mecp_env.core.se2 import polar_to_map, polar_to_points, to_map, wrap_angle
from mecp_env.slam.association import MatchBuilder
from mecp_env.slam.landmark_map.map_polygons import find_whole, link
from mecp_env.slam.messages import Corners, Decision, Doorways, Match, Reason
from tests.slam.tables import table_of


def corners_of(rng, n):
    A = rng.normal(size=(2 * n, 2 * n))
    z = np.column_stack((rng.uniform(1.0, 5.0, n), rng.uniform(-3.0, 3.0, n)))
    kinds, gaps = np.zeros(n, np.int64), np.full(n, -1, np.int64)
    none = Doorways(np.empty((0, 2), np.int64), np.empty(0), np.empty(0, np.bool_))
    flags = np.zeros(n, np.bool_)
    return Corners(z, A @ A.T, kinds, flags, np.zeros((n, 2)), gaps, ~flags, none)


def test_corners_are_placed_as_points_are_carried_to_the_map():
    rng = np.random.default_rng(0)
    z, T_map_robot = corners_of(rng, 9).z, np.array([1.0, -2.0, 0.7])
    p_map = np.empty((9, 2))
    polar_to_map(T_map_robot, z, p_map)
    assert (p_map == to_map(T_map_robot, polar_to_points(z))).all()


def test_measurements_are_rows_and_blocks():
    corners, index = corners_of(np.random.default_rng(1), 5), np.array([3, 0, 4])
    z, R = corners.measurements(index)
    rows = np.ravel(np.column_stack((2 * index, 2 * index + 1)))
    assert (z == corners.z[index]).all()
    assert (corners.cov[np.ix_(rows, rows)] == R).all()
    assert (corners.R[3] == corners.cov[6:8, 6:8]).all()


def test_recognised_corners_are_those_with_a_landmark():
    decision = np.array([int(Decision.NEW), int(Decision.LANDMARK), int(Decision.IGNORED), int(Decision.LANDMARK)])
    match = Match(np.arange(4), decision, np.zeros(4, np.int64), np.zeros(4), -1, -1, False)
    assert match.recognised().tolist() == [1, 3]


def test_integers_are_looked_up():
    found, rows = np.empty(4, np.int64), np.empty(3, np.int64)
    assert find_equal(np.array([5, 7, 5, 5]), 5, found) == 3
    assert found[:3].tolist() == [0, 2, 3]
    find_rows(np.array([4, 9, 2]), np.array([2, 4, 8]), rows)
    assert rows.tolist() == [2, 0, -1]


def test_small_angles_keep_their_bits_and_large_ones_are_wrapped():
    for angle in np.random.default_rng(2).uniform(-12.0, 12.0, 2000):
        wrapped = wrap_angle(angle)
        assert wrapped == angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
    assert wrap_angle(-math.pi) == math.pi
    assert math.isnan(wrap_angle(math.nan))


@pytest.mark.parametrize("n", [3, 8, 33, 70])
@pytest.mark.parametrize("rows", [2, 7, 20])
def test_downdate_with_and_without_a_margin(n, rows):
    rng = np.random.default_rng(n * rows)
    A, W = rng.normal(size=(n, n)), rng.normal(size=(rows, n))
    P = np.zeros((n + 5, n + 5))
    P[:n, :n] = A @ A.T
    expected = P[:n, :n] - W.T @ W
    with_margin = P.copy()
    downdate(P, n, W)
    downdate(with_margin, n, np.pad(W, ((0, 0), (0, -n % 8))))
    assert np.allclose(P[:n, :n], expected)
    assert (P[:n, :n] == P[:n, :n].T).all()
    assert (with_margin == P).all()
    assert not P[n:].any()
    assert not P[:, n:].any()


def test_a_polygon_is_linked_to_features_of_its_room_from_the_least_id():
    ids, rows = np.array([8, 3, 5, -1, 3]), table_of(9, room=[0, 0, 0, 1, 0, 1, 0, 0, 1]).rows
    intervals = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.5, 0.0], [1.0, 0.5, 1.0, 2.0], [2.0, 0.0, 1.0, 1.0]])

    def linked(corners, current):
        ring, rolled = np.empty(len(corners), np.int64), np.empty_like(intervals)
        sound = link(np.array(corners), ids, rows, current, ring, intervals, rolled)
        return (ring.tolist(), rolled[:, 0].tolist()) if sound else None

    assert linked([0, 1, 2], 1) == ([3, 5, 8], [0.0, 0.0, 1.0, 2.0])
    assert linked([0, 1, 2], 0) is None  # another room
    assert linked([0, 1, 3], 1) is None  # a corner without an id
    assert linked([1, 2, 4], 1) is None  # one feature twice


def are_whole(rings, rooms, rows):
    whole = np.empty(len(rings), np.bool_)
    find_whole(np.concatenate(rings), np.cumsum([len(ring) for ring in rings]), rows, np.array(rooms), whole)
    return whole.tolist()


def test_a_polygon_is_whole_while_its_vertices_live_in_its_room():
    rows = table_of(4, state=[1, 1, 1, 2], room=[0, 0, 1, 0]).rows
    rings = [np.array(ring) for ring in ([0, 1], [0, 2], [0, 3], [1, 1])]
    assert are_whole(rings, [0] * 4, rows) == [True, False, False, False]


def test_whole_polygons_are_found_as_one_by_one():
    rng = np.random.default_rng(3)
    rows = table_of(40, state=rng.integers(1, 4, 40), room=rng.integers(0, 2, 40)).rows
    rings = [rng.choice(40, rng.integers(1, 5)) for _ in range(300)]
    rooms = rng.integers(0, 2, len(rings))
    whole = are_whole(rings, rooms, rows)
    assert whole == [are_whole([ring], [now], rows)[0] for ring, now in zip(rings, rooms, strict=True)]
    assert 10 < sum(whole) < 290


def test_nobody_can_change_a_match():
    match = MatchBuilder(3).match()
    for column in (match.ids, match.decision, match.reason, match.nis):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1
    changed = match.assign([1], 7, Decision.LANDMARK, Reason.ROOM)
    assert changed.ids.tolist() == [-1, 7, -1]
    assert match.ids.tolist() == [-1, -1, -1]
