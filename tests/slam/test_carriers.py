"""The small compiled functions behind the messages, against NumPy: indices, blocks, rows of ids."""

from itertools import compress

import numpy as np
import pytest

from mecp_env.slam.association import MatchBuilder
from mecp_env.slam.landmark_map import are_whole, groups_of, link, without_doubles
from mecp_env.slam.messages import Decision, FeatureState, Reason
from tests.slam import make


def corners_of(rng, n):
    A = rng.normal(size=(2 * n, 2 * n))
    z = np.column_stack((rng.uniform(1.0, 5.0, n), rng.uniform(-3.0, 3.0, n)))
    return make.corners(z, cov=A @ A.T)


def test_measurements_are_rows_and_blocks():
    corners, index = corners_of(np.random.default_rng(1), 5), np.array([3, 0, 4])
    z, R = corners.measurements(index)
    rows = np.ravel(np.column_stack((2 * index, 2 * index + 1)))
    assert (z == corners.z[index]).all()
    assert (corners.cov[np.ix_(rows, rows)] == R).all()
    assert (corners.R[3] == corners.cov[6:8, 6:8]).all()


def test_a_polygon_is_linked_to_features_of_its_room_from_the_least_id():
    ids, rows = np.array([8, 3, 5, -1, 3]), make.features(9, room=[0, 0, 0, 1, 0, 1, 0, 0, 1]).rows
    intervals = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.5, 0.0], [1.0, 0.5, 1.0, 2.0], [2.0, 0.0, 1.0, 1.0]])

    def linked(corners, current):
        ring, rolled = np.empty(len(corners), np.int64), np.empty_like(intervals)
        sound = link(np.array(corners), ids, rows, current, ring, intervals, rolled)
        return (ring.tolist(), rolled[:, 0].tolist()) if sound else None

    assert linked([0, 1, 2], 1) == ([3, 5, 8], [0.0, 0.0, 1.0, 2.0])
    assert linked([0, 1, 2], 0) is None  # another room
    assert linked([0, 1, 3], 1) is None  # a corner without an id
    assert linked([1, 2, 4], 1) is None  # one feature twice


def polygons_of(rings):
    """Polygons whose room is their number."""
    return [make.map_polygon(ring, room) for room, ring in enumerate(rings)]


def test_whole_polygons_are_found_as_vertex_by_vertex():
    rng = np.random.default_rng(3)
    state, room = rng.integers(1, 4, 40), rng.integers(0, 2, 40)
    rings = [rng.choice(40, rng.integers(1, 5)).tolist() for _ in range(300)]
    now = dict(enumerate(rng.integers(0, 2, len(rings)).tolist()))
    dead = int(FeatureState.DEAD)
    wanted = [ring for i, ring in enumerate(rings) if all(state[v] != dead and room[v] == now[i] for v in ring)]
    polygons = polygons_of(rings)
    rooms, features = np.array(list(now.values())), make.features(40, state=state, room=room)
    kept = list(compress(polygons, are_whole(groups_of(polygons), rooms, features)))
    assert [polygon.ids.tolist() for polygon in kept] == wanted
    assert 10 < len(wanted) < 290
    last = {tuple(polygon.ids.tolist()): polygon for polygon in kept}
    assert without_doubles(kept) == [last[ring] for ring in last if len(set(ring)) == len(ring)]


def test_nobody_can_change_a_match():
    match = MatchBuilder(3).match()
    for column in (match.ids, match.decision, match.reason, match.nis):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1
    changed = match.assign([1], 7, Decision.LANDMARK, Reason.ROOM)
    assert changed.ids.tolist() == [-1, 7, -1]
    assert match.ids.tolist() == [-1, -1, -1]
