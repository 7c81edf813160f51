"""Controller and navigator on a toy robot: doors, obstacles, recovery, goals that cannot be reached."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from mecp_env.core.se2 import compose, to_map
from mecp_env.planning.config import ControlConfig, PathsConfig, PlanningConfig
from mecp_env.planning.controller import coast, follow, look_ahead, near_points, safe_command, seen_points
from mecp_env.planning.goals import Goal, GoalHistory, GoalKind, Goals, find_goals
from mecp_env.planning.navigator import (
    SQUEEZE,
    Navigator,
    Outcome,
    Target,
    cost_to_go_field,
    open_floor,
    plan,
    plan_through,
    squeezed,
)
from mecp_env.slam.messages import MergedScan
from tests.toy import BEARINGS, Toy, look, wall_distance

CONTROL, BODY = ControlConfig(), PathsConfig()


def started(target: Target, **navigator: int) -> Navigator:
    made = Navigator(PlanningConfig(navigator=navigator))
    made.start(target)
    return made


def drive(toy: Toy, target: Target, limit: int = 200) -> Navigator:
    """Drive until the navigator finishes; `nearest` of the toy is the smallest distance from a wall."""
    navigator, toy.nearest = started(target), math.inf
    for _ in range(limit):
        v, w = navigator.step(toy.output())
        if navigator.outcome != Outcome.RUNNING:
            break
        toy.move(v, w)
        toy.nearest = min(toy.nearest, wall_distance(toy.T_world_robot[:2]))
    return navigator


def target(toy: Toy, x: float, y: float) -> Target:
    """A place; as an open edge nothing but a polygon settles it on the way, and there is none."""
    place = to_map(toy.T_map_world, np.array([[x, y]]))[0]
    return Target.of(Goals.of([Goal(GoalKind.OPEN, *place, 1.0, toy.current)]), 0)


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_goes_through_a_door_into_the_unknown(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.array([rng.uniform(0.5, 5.2), rng.uniform(0.5, 3.5), rng.uniform(-3, 3)])
    toy = Toy(pose, rng.uniform(-3, 3, 3), 0.03, 0.01, seed=seed)
    output = toy.output()
    goals = find_goals(output, GoalHistory(), PlanningConfig())
    row = goals.kind.tolist().index(GoalKind.DOOR)
    navigator = drive(toy, Target.of(goals, row))
    assert navigator.outcome == Outcome.REACHED
    assert toy.current == 1
    assert not toy.contact
    assert toy.nearest > BODY.radius_m


def test_a_robot_far_behind_a_door_does_not_drive_straight_through_what_lies_between() -> None:
    """Seen in a building of 14 rooms: in line with a door two rooms away, it drove against the wall between."""
    toy = Toy(np.array([14.0, 1.95, 0.0]))  # in line with the door, a pillar between them
    toy.output()
    output = toy.output()
    door = output.graph.doors[0]
    costs = cost_to_go_field(output.grid, output.belief.T_map_robot, BODY)
    for way_of in (door, replace(door, jambs=door.jambs[::-1], other_face=None, rooms=(1, -1))):  # into A, into B
        path = plan_through(way_of, output, costs, PlanningConfig())
        walls = [wall_distance(p) for a, b in pairwise(path) for p in np.linspace(a, b, 50)]
        assert not walls or min(walls) > 0.9 * BODY.radius_m


def test_a_frontier_that_recedes_is_not_visited_in_vain() -> None:
    """Seen in a long corridor: two frontiers settled from afar, half a metre apart, closed the one at its end."""
    toy = Toy(np.array([14.0, 2.0, np.pi]))
    frontier = find_goals(toy.output(), GoalHistory(), PlanningConfig())
    row = frontier.kind.tolist().index(GoalKind.FRONTIER)
    navigator = drive(toy, Target.of(frontier, row))
    assert navigator.outcome == Outcome.SETTLED
    assert np.hypot(*(toy.output().belief.T_map_robot[:2] - frontier.p_map[row])) > 1.0


def test_no_way_is_refused_after_some_tries() -> None:
    toy = Toy(np.array([2.0, 2.0, 0.0]), confirmed=False)
    navigator = drive(toy, target(toy, 20.0, 2.0), 20)
    assert navigator.outcome == Outcome.REFUSED
    assert navigator.steps <= 5
    assert Navigator(PlanningConfig()).step(toy.output()) == (0.0, 0.0)  # without a drive


def test_a_lost_robot_without_a_path_drives_to_open_floor() -> None:
    """In the halls, lost explorers stood still: the paths on a wrong map led into walls, or there were none."""
    toy = Toy(np.array([2.0, 2.0, 0.0]), confirmed=False)
    output, out_of_reach, in_room = toy.output(), target(toy, 20.0, 2.0), target(toy, 4.5, 3.2)
    lost, config = replace(output, localised=False), PlanningConfig()
    here, ahead = output.belief.T_map_robot[:2], open_floor(output)
    assert ahead is not None
    assert 1.0 <= np.hypot(*(ahead - here)) <= 3.0
    assert not len(plan(out_of_reach, output, config))
    np.testing.assert_array_equal(plan(out_of_reach, lost, config), [here, ahead])
    np.testing.assert_array_equal(plan(in_room, lost, config), plan(in_room, output, config))
    np.testing.assert_array_equal(plan(in_room, lost, config, stuck=True), [here, ahead])  # its map may be wrong here
    np.testing.assert_array_equal(plan(in_room, output, config, stuck=True), plan(in_room, output, config))
    boxed = replace(lost, beams=replace(lost.beams, ranges=np.full_like(lost.beams.ranges, 1.0)))
    assert not len(plan(out_of_reach, boxed, config))


def test_a_robot_that_is_held_backs_off_keeps_less_far_off_in_its_last_try_and_gives_up(monkeypatch) -> None:
    toy, guards = Toy(np.array([1.0, 1.0, 0.0]), confirmed=False), dict[int, set[float]]()
    navigator, commands = started(target(toy, 4.5, 3.2)), []

    def noted(path: np.ndarray, pose: np.ndarray, beams: MergedScan, control: ControlConfig, *more: Any) -> Any:
        guards.setdefault(navigator.recoveries, set()).add(control.guard_m)
        return follow(path, pose, beams, control, *more)

    monkeypatch.setattr("mecp_env.planning.navigator.follow", noted)
    while navigator.outcome == Outcome.RUNNING:
        commands.append(navigator.step(toy.output()))  # the robot does not move
    guard = CONTROL.guard_m
    assert guards == {0: {guard}, 1: {guard}, 2: {guard}, 3: {SQUEEZE * guard}}
    assert navigator.outcome == Outcome.REFUSED
    assert any(v < 0.0 for v, _ in commands)
    assert len(commands) < 100


def test_a_drive_has_the_time_that_its_way_takes_and_is_then_refused() -> None:
    """In KTH floors every drive of more than 75 m was refused, three times."""
    toy = Toy(np.array([1.0, 1.0, 0.0]), confirmed=False)
    held, navigator = (started(target(toy, 4.5, 3.2), limit_steps=limit) for limit in (3, 12))
    while held.outcome == Outcome.RUNNING:
        held.step(toy.output())  # the robot does not move
        held.best_step = held.steps  # and does not know that it is stuck
    assert (held.outcome, held.steps) == (Outcome.REFUSED, 3 + held.way_steps + 1)
    while navigator.outcome == Outcome.RUNNING:
        toy.move(*navigator.step(toy.output()))
    assert navigator.outcome == Outcome.REACHED
    assert navigator.way_steps == math.ceil(math.dist((1.0, 1.0), (4.5, 3.2)) / 0.3)
    assert navigator.steps > 12


def test_what_lies_behind_is_turned_to_first_and_speed_falls_towards_the_end_of_the_path() -> None:
    pose = np.array([2.0, 2.0, 0.0])
    beams, _ = look(pose)
    v, w = follow(np.array([[2.0, 2.0], [1.0, 2.3]]), pose, beams, CONTROL, BODY)
    assert (v, w) == (0.0, pytest.approx(CONTROL.turn_rad_s))
    speeds = [follow(np.array([[2.0, 2.0], [2.0 + s, 2.0]]), pose, beams, CONTROL, BODY)[0] for s in (0.1, 0.3, 2.0)]
    assert speeds[0] < speeds[1] < speeds[2] == CONTROL.speed_m_s
    assert speeds[0] * CONTROL.period_s <= 0.11


@pytest.mark.parametrize("distance", [0.25, 0.35, 0.5, 0.8, 1.5])
def test_the_laser_stops_the_robot_before_a_wall(distance: float) -> None:
    wall = np.stack([np.full(201, distance), np.linspace(-1.0, 1.0, 201)], axis=1)
    v, w = safe_command(0.75, 0.0, wall, CONTROL.record, BODY.record)
    reach = v * CONTROL.period_s + v * v / (2.0 * CONTROL.acceleration_m_s2)
    end = reach if w == 0.0 else math.sin(reach * w / v) * v / w
    assert end <= max(distance - BODY.radius_m - CONTROL.guard_m, 0.0) + 1e-9
    assert v > 0.0 or distance < 0.5


def test_a_robot_that_rolls_on_does_not_turn_into_a_corner() -> None:
    beams, _ = look(np.array([5.6, 1.66, 0.0]))  # the jamb is ahead on the right
    assert coast((0.0, -1.75), (0.6, 0.1), beams, CONTROL, BODY) == (0.0, 0.05)
    assert coast((0.0, 1.75), (0.3, 0.0), beams, CONTROL, BODY) == (0.0, 1.75)
    assert coast((0.0, -1.75), (0.0, 0.0), beams, CONTROL, BODY) == (0.0, -1.75)
    assert coast((0.4, 0.2), (0.6, 0.1), beams, CONTROL, BODY) == (0.4, 0.2)


def test_a_robot_that_got_stuck_passes_a_gap_hardly_wider_than_itself() -> None:
    """It had come into a KTH room through one, and gave up one goal after another there: 60 drives of 60 steps."""
    half, stuck = BODY.radius_m + 0.6 * CONTROL.guard_m, squeezed(CONTROL)
    for aside, control, moves in ((half, CONTROL, False), (half, stuck, True), (0.9 * BODY.radius_m, stuck, False)):
        posts = np.array([[0.1, aside], [0.1, -aside]])
        assert (safe_command(0.5, 0.0, posts, control.record, BODY.record)[0] > 0.0) == moves


def test_points_seen_are_those_near_in_the_frame_of_the_robot_but_no_single_wild_one() -> None:
    pose, T_robot_laser = np.array([1.0, 2.0, 0.0]), np.array([0.1, -0.05, 2.0])
    beams, _ = look(pose)
    ranges = np.where(np.arange(720) == np.argmin(np.abs(BEARINGS)), 0.3, beams.ranges)
    points = near_points(ranges, beams.bearings, beams.hit, 2.5, np.zeros(3))
    assert np.hypot(*points.T).min() > 0.9
    near, mounted = seen_points(look(pose)[0], CONTROL), look(compose(pose, T_robot_laser))[0]
    assert np.hypot(*near.T).max() <= 2.1
    for points in (near, seen_points(mounted, CONTROL, T_robot_laser)):
        assert points[:, 0].min() == pytest.approx(-1.0, abs=0.01)


def test_look_ahead_is_on_the_path_and_counts_what_is_left() -> None:
    path, pose = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), np.array([0.6, 0.1, 2.0])
    x, y, left = look_ahead(path, pose, 0.6)
    assert to_map(pose, np.array([[x, y]]))[0] == pytest.approx([1.0, 0.2])
    assert left == pytest.approx(2.4)
