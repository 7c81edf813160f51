"""What an environment gives depends on its seed alone; tests/test_golden.py compares processes and threads."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from mecp_env.core.errors import ConfigError
from mecp_env.slam.protocols import FullFilterWarning
from tests.env.helpers import drive, episode_of, make, same, started, world_of
from tests.env.test_goal_actions import explore

BAD_STARTS = ["nowhere", None, 1.0, [1.0, 2.0], ["a", "b", "c"], [float("nan"), 2.0, 0.0], [1e9, 2.0, 0.0]]
BAD_STARTS += [[1.0, 1.0, 1e300], [True, True, False], [0.0, 0.0, 0.0], {"x": 1.0}, np.zeros((3, 1, 2))]
BAD_OPTIONS = [3, "start", [("start", "random")], {"strat": "random"}, {"start": "random", "seed": 3}]
BAD_OPTIONS += [{"start": start} for start in BAD_STARTS]
BAD_SEEDS = [True, np.bool_(True), 1.0, np.float64(2.0), -1, np.int64(-3), "1", [1], np.array(1)]


def test_bad_options_and_seeds_are_refused_and_change_nothing():
    env = started()
    before = env.get_state()
    for options in BAD_OPTIONS:
        with pytest.raises(ConfigError, match=r"options|start"):
            env.reset(seed=5, options=options)
    for seed in BAD_SEEDS:
        with pytest.raises(ConfigError, match=r"seed: .*at least 0"):
            env.reset(seed=seed)
    assert same(env.get_state(), before)
    assert same(env.reset(seed=np.uint8(7))[0], env.reset(seed=7)[0])
    assert type(env.np_random_seed) is int


def test_the_start_can_be_given_or_random():
    env = started()
    pose = env.view().T_world_robot + np.array([0.3, 0.1, 0.5])
    _, info = env.reset(seed=1, options={"start": pose.tolist()})
    assert np.allclose(env.view().T_world_robot, pose)
    assert np.allclose(info["truth_pose"], 0.0)  # the map frame is the pose at reset
    env.reset(seed=1)
    assert not np.allclose(env.view().T_world_robot, pose)  # for one episode only
    env, other = started(1, start="random"), started(2, start="random")
    assert not same(env.view().T_world_robot, other.view().T_world_robot)
    env.reset(seed=1, options={"start": "layout"})
    assert same(env.view().T_world_robot, world_of(env).outline.starts[0])


@pytest.mark.parametrize("start", ["layout", "random"])
def test_what_no_episode_can_start_from_is_refused_when_the_environment_is_made(start):
    wide = {"corners": {"door_width_m": (0.75, 9.0)}}
    with pytest.raises(ConfigError, match=r"robot\.radius_m"):
        make(layout="twins", start=start, robot={"radius_m": 2.0}, slam=wide)
    with pytest.raises(ConfigError, match=r"start: .*wall|start: .*free space"):
        make(start=(0.0, 0.0, 0.0))


def test_step_needs_a_reset_which_takes_three_scans_at_rest_before_and_after_an_episode():
    env = make(max_steps=2).unwrapped
    for call in (lambda: env.step(np.zeros(2, np.float32)), env.get_state):
        with pytest.raises(ResetNeeded):
            call()
    observation, info = env.reset(seed=1)
    assert env.slam_output.step == 3
    assert (info["period"], info["landmarks"] > 0, observation["goals"][0, 8]) == (0, True, 1.0)
    assert np.allclose(observation["pose"], [0, 0, 1, 0], atol=0.02)
    env.step(np.zeros(2, np.float32))
    _, _, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
    assert (terminated, truncated) == (False, True)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2, np.float32))


def test_an_episode_in_which_nothing_is_mapped_is_not_complete():
    env = started(max_steps=30, slam={"segments": {"min_length_m": 5.0}})
    rows = drive(env, 30)
    assert [row[2:4] for row in rows[:30]] == [(False, False)] * 29 + [(False, True)]
    assert not env.slam_output.map_polygons


def test_info_counts_the_landmarks_that_found_no_room():
    with pytest.warns(FullFilterWarning, match="8 landmarks"):
        rows = explore(make(actions="goal", slam={"filter": {"max_landmarks": 8}}), limit=10)
    assert rows[0][4]["landmarks_dropped"] == 0
    assert (rows[-1][4]["landmarks"], rows[-1][4]["landmarks_dropped"] > 0) == (8, True)


def test_coverage_can_end_an_episode():
    env = started(end={"coverage": 0.3}, reward="terms")
    _, _, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert (terminated, truncated) == (True, False)
    assert info["reward_completion"] == pytest.approx(10.0 * episode_of(env).memory.area_m2 / 100.0)
    assert info["reward_completion"] > 1.0


def test_environments_in_one_building_share_its_rasters_and_nothing_that_an_episode_changes():
    first, other, far = make().unwrapped, make().unwrapped, make(laser={"max_range_m": 5.0}).unwrapped
    for env in (first, other, far):
        env.reset(seed=1)
    assert world_of(first).truth is world_of(other).truth
    assert world_of(first).truth is not world_of(far).truth
    before = other.get_state()
    drive(first, 5)
    assert same(other.get_state(), before)


@pytest.mark.parametrize("name", ["mecp_env/Layout-v0", "mecp_env/Rooms-v0"])
def test_same_seed_same_bits_in_one_environment_and_in_another_whatever_the_global_generator(name):
    """An earlier building does not affect the next one."""
    env, rows = gymnasium.make(name), []
    for seed, each in enumerate((env, env, gymnasium.make(name))):
        np.random.seed(seed)  # noqa: NPY002
        each.action_space.seed(5)
        before = [*np.random.get_state(), each.action_space.np_random.bit_generator.state]  # noqa: NPY002
        rows.append([each.reset(seed=7), drive(each, 20), each.reset(), drive(each, 10)])
        assert same(before, [*np.random.get_state(), each.action_space.np_random.bit_generator.state])  # noqa: NPY002
    assert same(rows[0], rows[1])
    assert same(rows[0], rows[2])
    assert not same(rows[0][0], rows[0][2])  # an unseeded reset continues the random stream


def test_the_estimator_does_not_change_what_is_sensed():
    poses = []
    for estimator in ("slam", "known", "truth"):
        env = make(estimator=estimator, laser={"preset": "paper"})
        env.reset(seed=3)
        rows = drive(env, 20)
        poses.append([row[4]["truth_pose"] for row in rows] + [env.unwrapped.np_random.bit_generator.state["state"]])
    assert same(poses[0], poses[1])
    assert same(poses[0], poses[2])
    assert max(max(row[4]["pose_error_m"], row[4]["heading_error_rad"]) for row in rows) < 1e-6  # of the truth
