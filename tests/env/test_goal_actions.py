from fractions import Fraction
from itertools import islice

import numpy as np
import pytest
from gymnasium.wrappers import FrameStackObservation, RecordEpisodeStatistics, RescaleAction

from mecp_env.core.errors import ActionError, ConfigError
from mecp_env.core.snapshot import StateError
from mecp_env.env import MecpEnv
from mecp_env.episode.actions import check_choice, check_velocity, normalised_command
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.planning.goal_list import Goal, GoalKind, Goals, RowTimes
from mecp_env.wrappers import GoalActions
from tests.env.helpers import below, episode_of, make, same, until_over


def drives(env, seed=1):
    """The result of each drive of an exploration by the paper's explorer, up to the end of the episode."""
    policy = BreadthFirst()
    observation, _ = env.reset(seed=seed)
    return until_over(env, lambda seen: policy.act(seen, env.get_wrapper_attr("action_masks")()), observation)


def explore(env, seed=1, limit=60):
    """The results of at most `limit` drives."""
    return list(islice(drives(env, seed), limit))


@pytest.mark.parametrize("laser", [{"preset": "paper", "sweeps": 4}, {"field_of_view_deg": 180.0, "beams": 360}])
def test_the_explorer_completes_two_rooms_with_a_true_map(laser):
    env = make(actions="goal", laser=laser)
    rows = explore(env)
    assert rows[-1][2]
    summary = env.unwrapped.summary()
    assert (summary["rooms_found"], summary["doors_found"]) == (2, 1)
    assert summary["rooms_false"] == summary["doors_false"] == summary["contacts"] == 0
    assert summary["coverage"] > 0.95
    assert summary["association_precision"] > 0.99
    assert summary["pose_error_worst_m"] < 0.15
    assert sum(row[4]["periods"] for row in rows) == summary["periods"]


def test_the_mask_tells_the_rows_with_goals_and_is_what_the_space_samples_with():
    env = make(actions="goal", layout="paper")
    observation, info = env.reset(seed=1)
    assert info["goals"] == info["action_mask"].sum() > 0
    for _ in range(4):
        mask = info["action_mask"]
        assert (mask.dtype, mask.shape) == (np.int8, (GOALS,))
        assert np.array_equal(mask == 1, observation["goals"][:, 8] == 1.0)
        assert np.array_equal(mask == 1, env.get_wrapper_attr("action_masks")())
        observation, *_, info = env.step(env.action_space.sample(mask=mask))
        assert info["event"] != "masked"
    assert "action_mask" not in make().reset(seed=1)[1]
    other = make(actions="goal", layout="paper")
    other.unwrapped.set_state(env.unwrapped.get_state())
    *masked, info = env.step(GOALS - 1)  # an empty row: the robot drives to the nearest goal
    *chosen, its_info = GoalActions(other.unwrapped).step(int(other.unwrapped.goals.path_m.argmin()))
    assert info["event"] == "masked"
    assert same([*masked, info | {"event": ""}], [*chosen, its_info | {"event": ""}])


def test_the_best_row_explores_and_waiting_is_the_last_resort():
    kinds = (GoalKind.WAIT, GoalKind.PLACE, GoalKind.DOOR, GoalKind.FRONTIER)
    goals = [Goal(kind, 0.0, 0.0, 0.0, 0, path_m=path_m) for kind, path_m in zip(kinds, (0, 1, 9, 7), strict=True)]
    times = RowTimes(speed_m_s=0.5, wait_s=4.0)
    assert times.seconds(Goals.of(goals)).tolist() == [4.0, 2.0, 18.0, 14.0]
    best = [times.best(Goals.of(goals[:count]), GOALS) for count in range(5)]
    assert best == [None, 0, 1, 2, 3]
    assert times.best(Goals.of(goals), 3) == 2  # of the rows that are offered


def test_rewards_are_summed_and_the_callback_sees_every_step():
    env = make(actions="goal")
    env.reset(seed=1)
    seen = []
    below(env).callback = seen.append
    _, reward, _, _, info = env.step(0)
    assert len(seen) == info["periods"] == info["period"]
    assert reward == pytest.approx(sum(step[1] for step in seen))
    assert [step[4]["period"] for step in seen] == list(range(1, len(seen) + 1))
    assert {step[4]["event"] for step in seen} == {""}  # the arguments of the callback are not changed later
    env = GoalActions(RecordEpisodeStatistics(make(max_steps=2)))  # whose wrappers below see every step, too
    env.reset(seed=1)
    _, _, terminated, truncated, info = env.step(0)
    assert (terminated, truncated, info["event"], info["periods"]) == (False, True, "ended", 2)
    assert info["episode"]["l"] == 2


def test_no_episode_ends_as_complete_while_the_pose_is_searched_for(monkeypatch):
    """`50015848`: the planner refused every goal from a wrong pose, and 19 % of the floor were called complete."""
    env, left, tried = make(actions="goal", layout="paper", max_steps=80), [], []
    rows = drives(env)
    guard = episode_of(env).pipeline.guard
    guard.localised, guard.doubts = False, guard.config.scans
    monkeypatch.setattr(type(guard), "search", lambda *_: None)
    for row in rows:
        left.append(row[4]["goals"])
        tried.append(len(episode_of(env).goal_history.drives))
    assert row[2:4] == (False, True)
    assert not row[4]["localised"]
    assert min(left) > 0  # all are offered again when none is left
    assert max(tried) >= 2  # not the same ones in turn


def test_a_robot_with_a_blind_side_looks_around_while_it_waits():
    """Once around in the steps without a goal that end an episode; one that sees all around stays as it is."""
    for laser, turns in (({"preset": "lms200"}, True), ({}, False)):
        env = make(actions="goal", laser=laser)
        env.reset(seed=0)
        before = env.unwrapped.view().T_world_robot.copy()
        episode_of(env).goals = Goals()
        for _ in range(3):
            below(env)._wait()
        moved = env.unwrapped.view().T_world_robot - before
        assert (abs(moved[2]) > 0.1) == turns
        assert np.hypot(*moved[:2]) < 1e-3


def test_an_episode_on_a_submap_continues_bit_for_bit():
    """The state holds the submap and the map at rest; a damaged one is refused."""
    config = {"actions": "goal", "layout": "office", "slam": {"filter": {"kind": "riekf_submaps", "submap": 10}}}
    env = make(**config)
    rows = drives(env, seed=3)
    while episode_of(env).pipeline.filter.rest is None:
        next(rows)
    state, other = env.unwrapped.get_state(), make(**config)
    row = env.step(0)
    other.reset(seed=5)
    other.unwrapped.set_state(state)
    assert same(row, other.step(0))
    landmark_filter = episode_of(env).pipeline.filter
    landmark_filter.slot_ids = np.delete(landmark_filter.slot_ids, landmark_filter.slot_ids.argmin())  # a probe
    with pytest.raises(StateError, match="probes"):
        other.unwrapped.set_state(env.unwrapped.get_state())


def test_a_drive_that_is_looked_at_gives_what_another_one_gives(monkeypatch):
    looked, counted, observe = [], [], MecpEnv.observation
    callbacks = None, looked.append, counted.append
    env, watched, half = (GoalActions(make(actions="velocity").unwrapped, callback) for callback in callbacks)
    rows = explore(watched, limit=6)
    seen = []
    monkeypatch.setattr(MecpEnv, "observation", lambda self: seen.append(self) or observe(self))
    half.observes = False
    for unseen in env, half:
        assert all(same(mine, other) for mine, other in zip(explore(unseen, limit=6), rows, strict=True))
    assert all(same(mine[1:], other[1:]) for mine, other in zip(counted, looked, strict=True))
    assert len(looked) == sum(row[4]["periods"] for row in rows) > 2 * len(rows)
    assert len(seen) == 2 * (len(rows) + 1)  # after the reset, and once a drive


NAN, INF = float("nan"), float("inf")
GOOD_VELOCITIES = [np.array([0.5, -1.0], np.float32), np.array([1, -1]), [0.5, 1], (0.0, np.float32(1.0))]
BAD_VELOCITIES = [None, "stop", 1.0, {0.1, 0.2}, [], [0.1, 0.2, 0.3], [[0.1, 0.2]], ["a", "b"], [None, 0.0]]
BAD_VELOCITIES += [[True, False], [0.5, 1j], [Fraction(1, 2), 0.0], [10**400, 0], (NAN, 0.0), (0.0, -INF)]
BAD_VELOCITIES += [(1.0001, 0.0), np.array(0.5), np.zeros((1, 2)), np.zeros(2, complex), np.array([0.1, 0.2], object)]
BAD_VELOCITIES += [np.array([NAN, 0.0], np.float32), np.array([2, 0])]
GOOD_CHOICES = [0, 4, np.int64(3), np.uint8(2), np.array(1)]
BAD_CHOICES = [None, "1", 1.0, True, np.True_, NAN, -1, 5, 10**400, [1], np.array([1]), np.array(1.0), np.array(True)]
BAD = {"velocity": BAD_VELOCITIES, "discrete": BAD_CHOICES, "goal": [32, -1, 1.0, None, "1", [1]]}


def test_good_actions_pass_unchanged_and_a_refusal_names_component_value_and_bound():
    assert [check_velocity(action) for action in GOOD_VELOCITIES] == [tuple(map(float, a)) for a in GOOD_VELOCITIES]
    assert [check_choice(action, 5) for action in GOOD_CHOICES] == [int(action) for action in GOOD_CHOICES]
    assert normalised_command(0.75, -1.75, (0.75, 1.75)).tolist() == [1.0, -1.0]
    assert normalised_command(9.0, 0.0, (0.75, 1.75)).tolist() == [1.0, 0.0]
    with pytest.raises(ActionError, match=r"action\[turn\]: 1\.5 does not lie in \[-1, 1\]"):
        check_velocity([0.0, 1.5])
    with pytest.raises(ActionError, match=r"7 does not lie in 0\.\.4"):
        check_choice(7, 5)


def test_what_a_wrapper_rescales_is_cut_where_rounding_leaves_the_bounds_but_not_below_a_drive():
    low, high = np.float32(-9.2), np.float32(-8.9)
    env = RescaleAction(make(actions="velocity"), low, high)
    moved = [env.action(np.full(2, bound, np.float32)) for bound in (low, high)]
    assert np.abs(moved).max() > 1.0
    cut = np.array([check_velocity(action) for action in moved])
    assert np.abs(cut).max() == 1.0
    np.testing.assert_allclose(cut, [[-1.0, -1.0], [1.0, 1.0]], atol=1e-5)
    for wrapped in (env, FrameStackObservation(make(), 2)):
        with pytest.raises(ConfigError, match=r"changes the \w+_space; put that wrapper around GoalActions"):
            GoalActions(wrapped)
    with pytest.raises(ConfigError, match="GoalActions"):
        GoalActions(make(actions="discrete"))


@pytest.mark.parametrize("kind", BAD)
def test_a_refused_action_leaves_the_environment_as_it_was(kind):
    env = make(actions=kind)
    env.reset(seed=3)
    step = below(env).step
    before = env.unwrapped.get_state()
    for action in BAD[kind]:
        with pytest.raises(ActionError, match="action"):
            step(action)
    assert same(before, env.unwrapped.get_state())
