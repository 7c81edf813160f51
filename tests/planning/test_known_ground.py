"""Goals on known ground: which places are offered, and what the virtual filter along a path predicts."""

import math

import numpy as np
import pytest
import shapely
from scipy.spatial.distance import cdist, pdist

from mecp_env.planning.config import KnownGroundConfig, PathsConfig, PlanningConfig, PredictionConfig
from mecp_env.planning.goal_list import PLACE, WAIT, Goal, GoalKind, Goals, Outcome, PlaceKind
from mecp_env.planning.goals import GoalHistory
from mecp_env.planning.known_ground import (
    Surroundings,
    correct_pose,
    drive_on,
    in_sight,
    landmark_information,
    offered_goals,
    predict,
)
from mecp_env.planning.navigator import CostToGoField, cost_to_go_field
from mecp_env.slam.messages import Belief, Cell
from mecp_env.slam.output import SlamOutput
from tests.slam import make

CONFIG = PlanningConfig(known_ground=KnownGroundConfig(places=8, wait_steps=5))
ROWS = 32


def hall(x: float = 10.0, sigma_m: float = 0.1) -> SlamOutput:
    """A robot at (x, 5) in an empty hall of 20 m by 10 m, with two well-known landmarks in a corner."""
    label = np.full((100, 200), int(Cell.FREE), np.uint8)
    label[0] = label[-1] = label[:, 0] = label[:, -1] = int(Cell.OCCUPIED)
    belief = make.belief((x, 5.0, 0.0), [[1.0, 1.0], [1.0, 2.0]], pose_cov=sigma_m**2)
    return make.output(grid=make.grid(label), belief=belief, graph=make.graph())


def travelled(*corners: tuple[float, float]) -> np.ndarray:
    """The points of a path, 0.1 m apart."""
    return shapely.get_coordinates(shapely.segmentize(shapely.LineString(corners), 0.1))


THERE = travelled((2.0, 2.0), (2.0, 8.0), (10.0, 8.0), (10.0, 5.0))


def offered(path: np.ndarray = THERE, history=None, goals: Goals | None = None, output=None, **changes) -> Goals:
    config = CONFIG.model_copy(update={"known_ground": CONFIG.known_ground.model_copy(update=changes)})
    around = Surroundings(output or hall(), history or GoalHistory(), path)
    return offered_goals(goals or Goals(), around, config, ROWS)


def places(goals: Goals, why: int | None = None) -> np.ndarray:
    """(n,2) m, of all kinds or of those that are offered for a reason."""
    return goals.p_map[(goals.kind == PLACE) & ((goals.level == why) | (why is None))]


def test_without_places_the_goals_stay_as_they_are_and_waiting_costs_no_way() -> None:
    goals = Goals.of([Goal(GoalKind.FRONTIER, 1.0, 1.0, 1.0, 0)])
    assert offered(goals=goals, places=0, wait_steps=0) is None
    waiting = offered(places=0)
    assert (waiting.kind.tolist(), waiting.path_m.tolist(), waiting.p_map.tolist()) == ([WAIT], [0.0], [[10.0, 5.0]])


def test_exploration_comes_first_then_places_that_are_apart_then_waiting() -> None:
    exploration = [Goal(GoalKind.FRONTIER, 3.0 + 0.3 * k, 3.0, 1.0, 0, visits=k, path_m=float(k)) for k in range(40)]
    rows = offered(goals=Goals.of(exploration))
    there = places(rows)
    kept = ROWS - len(there) - 1
    assert rows.kind.tolist() == [GoalKind.FRONTIER] * kept + [PLACE] * len(there) + [WAIT]
    assert rows.visits[:kept].tolist() == rows.path_m[:kept].tolist() == list(range(kept))
    assert 2 <= len(there) <= 8
    assert pdist(there).min() >= 2.0
    assert min(cdist(there, [[10.0, 5.0]]).min(), rows.path_m[kept:-1].min()) >= 1.0  # not where the robot is


def test_well_known_landmarks_make_a_place() -> None:
    assert math.dist(places(offered(loop_m=1000.0), PlaceKind.LANDMARKS)[0], (1.0, 1.5)) < 4.0
    worth = landmark_information(np.array([[1.0, 1.0], [9.0, 9.0]]), hall().belief)
    assert worth.tolist() == pytest.approx([2e4, 0.0])


def test_a_place_left_long_ago_and_near_closes_a_loop() -> None:
    around = travelled((10.0, 6.5), (2.0, 6.5), (2.0, 2.0), (10.0, 2.0), (10.0, 5.0))
    assert math.dist(places(offered(around), PlaceKind.LOOP)[0], (10.0, 6.5)) < 1.5
    assert not len(places(offered(around, loop_m=100.0), PlaceKind.LOOP))


def test_the_last_good_place_is_remembered() -> None:
    history = GoalHistory()
    for output in (hall(3.0, 0.01), hall(10.0, 0.3)):  # sure, then unsure
        history.remember_good_place(output.belief, 0.05)
    assert history.good_place.tolist() == [3.0, 5.0]
    rows = offered(history=history)
    assert rows.level[rows.kind == PLACE][0] == PlaceKind.GOOD


def test_a_place_that_was_refused_is_not_offered_again_but_one_that_was_visited_is() -> None:
    rows, history = offered(), GoalHistory()
    place = places(rows)[:1]
    for ended, times, offered_again in ((Outcome.REACHED, 10, True), (Outcome.REFUSED, CONFIG.goals.refusals, False)):
        for _ in range(times):
            history.record(rows, rows.kind.tolist().index(PLACE), ended, CONFIG.goals)
        assert (cdist(places(offered(history=history)), place).min() < 0.1) == offered_again


PREDICTION = PredictionConfig(distance_sigma_m=0.05, turn_sigma_deg=2.0, turn_m=0.5, max_range_m=3.0)
CELL_M = 0.1
REACH_M = 0.5


def covariance(seed: int, scale: float = 0.1) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(3, 3)) * scale
    return root @ root.T


def test_a_drive_is_the_textbook_prediction() -> None:
    P, dx, dy, turn = covariance(0), 0.3, -0.7, 0.4
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    length, noise = math.hypot(dx, dy), PREDICTION.numbers
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


def corridor(belief: Belief) -> CostToGoField:
    """Paths in a corridor of 2 m by 16 m, its middle along y = 0."""
    label = np.pad(np.full((20, 156), Cell.FREE, np.uint8), 2, constant_values=Cell.OCCUPIED)
    grid = make.grid(label, origin=(0.0, -1.2), resolution_m=CELL_M)
    return cost_to_go_field(grid, belief.T_map_robot, PathsConfig())


def predicted(x: float, landmarks: list[tuple[float, float]], sigma_m: float = 0.01, **changes: float) -> Goal:
    """The goal `x` m along the corridor, of a robot at 1 m whose place is known as well as the landmarks."""
    pose_cov = np.diag([sigma_m**2, sigma_m**2, 1e-6])
    belief = make.belief((1.0, 0.0, 0.0), landmarks, pose_cov=pose_cov, covs=sigma_m**2)
    goal = Goal(GoalKind.FRONTIER, x, 0.0, 1.0, 0)
    predict([goal], [REACH_M], corridor(belief), belief, PREDICTION.model_copy(update=changes))
    return goal


def test_without_landmarks_the_position_is_that_of_dead_reckoning() -> None:
    far = predicted(13.0, [])
    metres, turn = 12.0, math.radians(2.0)
    along, across = 0.05**2 * metres, turn**2 * metres**3 / 3.0
    assert far.sigma_m == pytest.approx(math.sqrt(0.5 * (along + across)), rel=0.1)
    assert far.sigma_rad == pytest.approx(turn * math.sqrt(metres), rel=0.05)
    assert far.gain_nat == 0.0
    assert predicted(4.0, []).sigma_m < far.sigma_m


def test_landmarks_on_the_way_keep_the_pose_and_gain_information() -> None:
    marks = [(x, y) for x in (3.0, 6.0, 9.0, 12.0) for y in (-1.0, 1.0)]
    with_marks, without = predicted(13.0, marks), predicted(13.0, [])
    assert with_marks.sigma_m < 0.2 * without.sigma_m
    assert with_marks.sigma_rad < without.sigma_rad
    assert with_marks.gain_nat > 0.0
    assert predicted(13.0, marks, field_of_view_deg=1.0).sigma_m > with_marks.sigma_m
    assert predicted(13.0, marks, max_range_m=0.5).gain_nat == 0.0


def test_landmarks_mapped_from_this_pose_hardly_correct_it() -> None:
    assert 0.15 < predicted(1.0, [(3.0, 1.0), (3.0, -1.0)], sigma_m=0.2).sigma_m <= 0.2


def test_a_wall_hides_a_landmark() -> None:
    costs = corridor(make.belief((1.0, 0.0, 0.0)))
    view, clear = (np.array([12, 30]), 0.0, CELL_M), (costs.clearance, costs.cost)
    assert in_sight(view, np.array([50.0, 12.0]), clear, PREDICTION.numbers)
    blocked = costs.cost.copy()
    blocked[:, 40] = 0
    assert not in_sight(view, np.array([50.0, 12.0]), (costs.clearance, blocked), PREDICTION.numbers)
    assert not in_sight(view, np.array([90.0, 12.0]), clear, PREDICTION.numbers)  # out of range
