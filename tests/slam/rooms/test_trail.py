"""The path since a room was entered, and whether it crossed a gap."""

import numpy as np
from shapely.geometry import LineString

from mecp_env.slam.config import SlamConfig
from mecp_env.slam.rooms.doors import RoomLimits
from mecp_env.slam.rooms.room_graph import Trail, last_crossing

CONFIG = RoomLimits.of(SlamConfig())
MOST = CONFIG.trail_places
GAP = np.array([[0.45, 0.0], [-0.45, 0.0]])


def path(*ys, x=0.0):
    return np.array([(x, y) for y in ys])


def test_a_crossing_is_the_first_place_behind_the_gap():
    assert last_crossing(path(-1.0, -0.5, 0.5, 1.0), GAP) == 2
    assert last_crossing(path(1.0, 0.5, -0.5), GAP) == 2


def test_there_and_back_is_none_and_there_and_back_and_there_is_the_last():
    assert last_crossing(path(-1.0, 1.0, -1.0), GAP) == -1
    assert last_crossing(path(-1.0, 1.0, -1.0, 1.0), GAP) == 3


def test_beside_the_gap_is_none():
    assert last_crossing(path(-1.0, 1.0, x=0.5), GAP) == -1
    assert last_crossing(np.empty((0, 2)), GAP) == -1


def test_one_step_against_shapely():
    rng = np.random.default_rng(4)
    for _ in range(500):
        step, gap = rng.uniform(-2, 2, (2, 2)), rng.uniform(-2, 2, (2, 2))
        assert (last_crossing(step, gap) == 1) == LineString(step).crosses(LineString(gap))


def test_a_robot_that_stands_leaves_one_place_and_old_places_are_forgotten():
    trail = Trail()
    for step in range(20):
        trail.add(step, 3, np.array([1.0, 2.0, 0.1 * step]), CONFIG)
    assert len(trail.places) == 2
    for step in range(20, 20 + 2 * MOST):
        trail.add(step, 5, np.array([1.0 + 0.2 * (step - 19), 2.0, 0.0]), CONFIG)
    assert len(trail.places) == MOST + 1
    assert trail.places[-1, 2:].tolist() == [19 + 2 * MOST, 5]


def test_passed_tells_when_and_how_many_features_there_were():
    trail = Trail()
    for step, y in enumerate((-1.0, -0.6, -0.2, 0.2, 0.6)):
        trail.add(step, 10 + step, np.array([0.0, y, 1.6]), CONFIG)
    assert trail.passed(GAP) == (3, 13)
    assert trail.passed(GAP + 3.0) is None
