from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from mecp_env.core.errors import ActionError
from mecp_env.episode.actions import COMMANDS, DISCRETE, check_choice, check_velocity, normalised_command
from tests.env.helpers import make, same

GOOD_VELOCITIES = [
    np.array([0.5, -1.0], np.float32),
    np.array([1.0, 0.0]),
    np.array([1, -1]),
    np.zeros(2, np.float16),
    [0.5, 1],
    (0.0, np.float32(1.0)),
]
BAD_VELOCITIES = [
    None,
    "stop",
    b"ab",
    1.0,
    3,
    {},
    {0.1, 0.2},
    object(),
    [],
    [0.1],
    [0.1, 0.2, 0.3],
    [[0.1, 0.2]],
    ["a", "b"],
    [None, 0.0],
    [True, False],
    [0.5, 1j],
    [Fraction(1, 2), 0.0],
    [10**400, 0],
    [-(10**400), 0],
    (float("nan"), 0.0),
    (0.0, float("inf")),
    (0.0, float("-inf")),
    (1.0000001, 0.0),
    (0.0, 1e38),
    np.array(0.5),
    np.zeros(3, np.float32),
    np.zeros((1, 2), np.float32),
    np.zeros((2, 1), np.float32),
    np.zeros(0),
    np.zeros(2, complex),
    np.zeros(2, bool),
    np.array(["a", "b"]),
    np.array([0.1, 0.2], object),
    np.array([np.nan, 0.0], np.float32),
    np.array([0.0, np.inf], np.float32),
    np.array([1e38, 0.0], np.float32),
    np.array([1.0001, 0.0]),
    np.array([2, 0]),
    np.float32(0.5),
]
GOOD_CHOICES = [0, 4, np.int64(3), np.uint8(2), np.array(1), np.array(4, np.int32)]
BAD_CHOICES = [
    None,
    "1",
    1.0,
    True,
    np.True_,
    float("nan"),
    -1,
    5,
    10**400,
    [1],
    (1,),
    {},
    np.array([1]),
    np.array(1.0),
    np.array(True),
    np.float32(1),
    np.int64(-1),
    np.array(5),
]


@pytest.mark.parametrize("action", GOOD_VELOCITIES, ids=repr)
def test_good_velocities_pass_unchanged(action):
    assert check_velocity(action) == (float(action[0]), float(action[1]))


@pytest.mark.parametrize("action", BAD_VELOCITIES, ids=lambda a: f"{a!r:.15}")
def test_bad_velocities_are_refused(action):
    with pytest.raises(ActionError, match="action"):
        check_velocity(action)


@pytest.mark.parametrize("action", GOOD_CHOICES, ids=repr)
def test_good_choices_pass(action):
    assert check_choice(action, 5) == int(action)


@pytest.mark.parametrize("action", BAD_CHOICES, ids=lambda a: f"{a!r:.15}")
def test_bad_choices_are_refused(action):
    with pytest.raises(ActionError, match="action"):
        check_choice(action, 5)


def test_a_refusal_names_component_value_and_bound():
    with pytest.raises(ActionError, match=r"action\[turn\]: 1\.5 does not lie in \[-1, 1\]"):
        check_velocity([0.0, 1.5])
    with pytest.raises(ActionError, match=r"7 does not lie in 0\.\.4"):
        check_choice(7, 5)


@pytest.mark.parametrize(
    ("kind", "bad"), [("velocity", BAD_VELOCITIES), ("discrete", BAD_CHOICES), ("goal", [32, -1, 1.0, None, "1", [1]])]
)
def test_a_refused_action_leaves_the_environment_as_it_was(kind, bad):
    env = make(actions=kind).unwrapped if kind != "goal" else make(actions=kind)
    env.reset(seed=3)
    before = env.unwrapped.get_state()
    for action in bad:
        with pytest.raises(ActionError):
            env.unwrapped.step(action) if kind != "goal" else goal_wrapper(env).step(action)
    assert same(before, env.unwrapped.get_state())


def goal_wrapper(env):
    while not hasattr(env, "drive"):
        env = env.env
    return env


def test_discrete_actions_move_as_they_are_called():
    env = make(actions="discrete", laser={"preset": "ideal"}).unwrapped
    ways = {}
    for index, name in enumerate(DISCRETE):
        env.reset(seed=0)
        for _ in range(3):
            _, _, _, _, info = env.step(index)
        ways[name] = info["truth_pose"]
    assert np.allclose(ways["stop"], 0.0)
    assert ways["forward"][0] > 0.3
    assert ways["back"][0] < -0.3
    assert ways["left"][2] > 0.3
    assert ways["right"][2] < -0.3
    assert COMMANDS.shape == (5, 2)


def test_two_seconds_at_full_speed_are_a_metre_and_a_half_less_the_acceleration():
    env = make(laser={"preset": "ideal"}).unwrapped
    env.reset(seed=0)
    for _ in range(5):
        _, _, _, _, info = env.step(np.array([1.0, 0.0], np.float32))
    assert 1.0 < info["truth_pose"][0] < 1.5  # 0.75 m/s, reached at 1 m/s^2


def test_a_command_becomes_shares_within_the_limits():
    assert normalised_command(0.75, -1.75, (0.75, 1.75)).tolist() == [1.0, -1.0]
    assert normalised_command(9.0, 0.0, (0.75, 1.75)).tolist() == [1.0, 0.0]
