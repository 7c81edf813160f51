"""What an environment gives depends on its seed alone; tests/test_golden.py compares processes and threads."""

from __future__ import annotations

import numpy as np

from tests.env.helpers import drive, make, same


def test_same_seed_same_bits_in_one_environment_and_in_another():
    env = make(laser={"preset": "paper"})
    first = [env.reset(seed=7), drive(env, 30), env.reset(), drive(env, 10)]
    again = [env.reset(seed=7), drive(env, 30), env.reset(), drive(env, 10)]
    other = make(laser={"preset": "paper"})
    assert same(first, again)
    assert same(first, [other.reset(seed=7), drive(other, 30), other.reset(), drive(other, 10)])
    assert not same(first[0], first[2])  # an unseeded reset continues the random stream


def test_the_global_generator_and_the_action_space_are_left_alone_and_change_nothing():
    rows, env = [], make()
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        env.action_space.seed(5)
        before = [*np.random.get_state(), env.action_space.np_random.bit_generator.state]  # noqa: NPY002
        rows.append([env.reset(seed=1), drive(env, 10)])
        assert same(before, [*np.random.get_state(), env.action_space.np_random.bit_generator.state])  # noqa: NPY002
    assert same(*rows)


def test_the_estimator_does_not_change_what_is_sensed():
    poses = []
    for estimator in ("slam", "known", "truth"):
        env = make(estimator=estimator, laser={"preset": "paper"})
        env.reset(seed=3)
        rows = drive(env, 20)
        assert estimator != "truth" or max(row[4]["pose_error_m"] for row in rows) < 1e-6
        assert estimator != "truth" or max(row[4]["heading_error_rad"] for row in rows) < 1e-6
        poses.append([row[4]["truth_pose"] for row in rows] + [env.unwrapped.np_random.bit_generator.state["state"]])
    assert same(poses[0], poses[1])
    assert same(poses[0], poses[2])
