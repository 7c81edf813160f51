"""The virtual filter along a path: against matrices, and what it must predict in plain cases."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.planning.config import PathsConfig, PredictionConfig
from mecp_env.planning.goal_list import Goal, GoalKind
from mecp_env.planning.known_ground import correct_pose, drive_on, in_sight, predict, waypoints
from mecp_env.planning.navigator import cost_to_go_field
from mecp_env.slam.messages import Cell
from tests.slam import make

CONFIG = PredictionConfig(distance_sigma_m=0.05, turn_sigma_deg=2.0, turn_m=0.5, max_range_m=3.0)
CELL_M = 0.1
REACH_M = 0.5


def covariance(seed: int, scale: float = 0.1) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(3, 3)) * scale
    return root @ root.T


def test_a_drive_is_the_textbook_prediction() -> None:
    P, dx, dy, turn = covariance(0), 0.3, -0.7, 0.4
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    length, noise = math.hypot(dx, dy), CONFIG.numbers
    path = length + 0.5 * turn / (0.5 * math.pi)
    ahead = np.array([dx, dy, 0.0]) / length
    Q = 0.05**2 * path * np.outer(ahead, ahead) + np.diag([0.0, 0.0, math.radians(2.0) ** 2 * path])
    expected = F @ P @ F.T + Q
    drive_on(P, dx, dy, turn, noise)
    assert np.allclose(P, expected, rtol=1e-12)


def test_a_landmark_corrects_as_the_textbook_update_does() -> None:
    P, cov, weight, sigma_m, lever = covariance(1), np.diag([0.02, 0.05]), 0.25, 0.03, (-1.2, 0.8)
    H = np.array([[1.0, 0.0, lever[0]], [0.0, 1.0, lever[1]]])
    alone = H @ P @ H.T + sigma_m**2 * np.eye(2)
    K = P @ H.T @ np.linalg.inv(alone + cov / weight)
    expected = P - K @ H @ P
    after = cov - cov @ np.linalg.inv(alone + cov) @ cov
    gain = correct_pose(P, lever, cov, weight, sigma_m)
    assert np.allclose(P, expected, rtol=1e-10)
    assert gain == pytest.approx(0.5 * math.log(np.linalg.det(cov) / np.linalg.det(after)))


def corridor(landmarks: list[tuple[float, float]], sigma_m: float = 0.01, length: int = 160) -> tuple:
    """Paths and belief in a corridor of 2 m by 16 m, its middle along y = 0, with the robot at x = 1 m."""
    label = np.full((24, length), int(Cell.FREE), np.uint8)
    label[:2] = label[-2:] = int(Cell.OCCUPIED)
    label[:, :2] = label[:, -2:] = int(Cell.OCCUPIED)
    grid = make.grid(label, origin=(0.0, -1.2), resolution_m=CELL_M)
    belief = make.belief((1.0, 0.0, 0.0), landmarks, covs=sigma_m**2)
    return cost_to_go_field(grid, belief.T_map_robot, PathsConfig()), belief


def predicted(x: float, landmarks: list[tuple[float, float]], **changes: float) -> Goal:
    """The goal `x` m along the corridor."""
    costs, belief = corridor(landmarks)
    goal = Goal(GoalKind.FRONTIER, x, 0.0, 1.0, 0)
    predict([goal], [REACH_M], costs, belief, CONFIG.model_copy(update=changes))
    return goal


def test_without_landmarks_the_position_is_that_of_dead_reckoning() -> None:
    far = predicted(13.0, [])
    metres, turn = 12.0, math.radians(2.0)
    along, across = 0.05**2 * metres, turn**2 * metres**3 / 3.0
    assert far.sigma_m == pytest.approx(math.sqrt(0.5 * (along + across)), rel=0.1)
    assert far.sigma_rad == pytest.approx(turn * math.sqrt(metres), rel=0.05)
    assert far.gain_nat == 0.0
    assert predicted(4.0, []).sigma_m < far.sigma_m
    nowhere = predicted(40.0, [])  # without a path: where the robot is
    assert nowhere.sigma_m == 0.0 or nowhere.sigma_m == pytest.approx(1e-3)


def test_landmarks_on_the_way_keep_the_pose_and_gain_information() -> None:
    marks = [(x, y) for x in (3.0, 6.0, 9.0, 12.0) for y in (-1.0, 1.0)]
    with_marks, without = predicted(13.0, marks), predicted(13.0, [])
    assert with_marks.sigma_m < 0.2 * without.sigma_m
    assert with_marks.sigma_rad < without.sigma_rad
    assert with_marks.gain_nat > 0.0
    assert predicted(13.0, marks, field_of_view_deg=1.0).sigma_m > with_marks.sigma_m
    assert predicted(13.0, marks, max_range_m=0.5).gain_nat == 0.0


def test_landmarks_mapped_from_this_pose_hardly_correct_it() -> None:
    costs, belief = corridor([(3.0, 1.0), (3.0, -1.0)], sigma_m=0.2)
    belief.pose_cov[:2, :2] = np.eye(2) * 0.2**2
    goal = Goal(GoalKind.WAIT, 1.0, 0.0, 0.0, 0)
    predict([goal], [REACH_M], costs, belief, CONFIG)
    assert 0.15 < goal.sigma_m <= 0.2


def test_waypoints_are_on_the_path_and_end_at_both_ends() -> None:
    costs, _ = corridor([])
    found = waypoints(costs.step, 12, 130, 8)
    assert found[0].tolist() == [11, 10]  # of the robot
    assert found[-1].tolist() == [12, 130]
    assert np.abs(np.diff(found, axis=0)).max() <= 8


def test_a_wall_hides_a_landmark() -> None:
    costs, _ = corridor([])
    view, clear = (np.array([12, 30]), 0.0, CELL_M), (costs.clearance, costs.cost)
    assert in_sight(view, np.array([50.0, 12.0]), clear, CONFIG.numbers)
    blocked = costs.cost.copy()
    blocked[:, 40] = 0
    assert not in_sight(view, np.array([50.0, 12.0]), (costs.clearance, blocked), CONFIG.numbers)
    assert not in_sight(view, np.array([90.0, 12.0]), clear, CONFIG.numbers)  # out of range
