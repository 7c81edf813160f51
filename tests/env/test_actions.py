from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from mecp_env.core.errors import ActionError
from mecp_env.episode.actions import DISCRETE, check_choice, check_velocity, normalised_command
from tests.env.helpers import below, make, same

NAN, INF = float("nan"), float("inf")
GOOD_VELOCITIES = [np.array([0.5, -1.0], np.float32), np.array([1, -1]), [0.5, 1], (0.0, np.float32(1.0))]
BAD_VELOCITIES = [None, "stop", 1.0, {0.1, 0.2}, [], [0.1, 0.2, 0.3], [[0.1, 0.2]], ["a", "b"], [None, 0.0]]
BAD_VELOCITIES += [[True, False], [0.5, 1j], [Fraction(1, 2), 0.0], [10**400, 0], [-(10**400), 0], (NAN, 0.0)]
BAD_VELOCITIES += [(0.0, INF), (0.0, -INF), (1.0000001, 0.0), np.array(0.5), np.zeros(3), np.zeros((1, 2))]
BAD_VELOCITIES += [np.zeros(2, complex), np.zeros(2, bool), np.array(["a", "b"]), np.array([0.1, 0.2], object)]
BAD_VELOCITIES += [np.array([NAN, 0.0], np.float32), np.array([1e38, 0.0], np.float32), np.array([2, 0])]
GOOD_CHOICES = [0, 4, np.int64(3), np.uint8(2), np.array(1)]
BAD_CHOICES = [None, "1", 1.0, True, np.True_, NAN, -1, 5, 10**400, [1], np.array([1]), np.array(1.0), np.array(True)]
BAD_CHOICES += [np.float32(1), np.int64(-1), np.array(5)]
BAD = {"velocity": BAD_VELOCITIES, "discrete": BAD_CHOICES, "goal": [32, -1, 1.0, None, "1", [1]]}


def test_good_actions_pass_unchanged():
    assert [check_velocity(action) for action in GOOD_VELOCITIES] == [tuple(map(float, a)) for a in GOOD_VELOCITIES]
    assert [check_choice(action, 5) for action in GOOD_CHOICES] == [int(action) for action in GOOD_CHOICES]
    assert normalised_command(0.75, -1.75, (0.75, 1.75)).tolist() == [1.0, -1.0]
    assert normalised_command(9.0, 0.0, (0.75, 1.75)).tolist() == [1.0, 0.0]


def test_a_refusal_names_component_value_and_bound():
    with pytest.raises(ActionError, match=r"action\[turn\]: 1\.5 does not lie in \[-1, 1\]"):
        check_velocity([0.0, 1.5])
    with pytest.raises(ActionError, match=r"7 does not lie in 0\.\.4"):
        check_choice(7, 5)


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


def test_discrete_actions_move_as_they_are_called():
    env = make(actions="discrete", laser={"preset": "ideal"}).unwrapped
    ways = {}
    for index, name in enumerate(DISCRETE):
        env.reset(seed=0)
        for _ in range(3):
            _, _, _, _, info = env.step(index)
        ways[name] = info["truth_pose"]
    assert np.allclose(ways["stop"], 0.0)
    assert (ways["forward"][0] > 0.3, ways["back"][0] < -0.3) == (True, True)
    assert (ways["left"][2] > 0.3, ways["right"][2] < -0.3) == (True, True)
