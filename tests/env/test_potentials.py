"""Potentials of the reward: formulas, more for better beliefs, nothing for detours, custom ones by name."""

import math

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.episode.potentials import (
    TAU_M,
    RewardInputs,
    a_optimality,
    d_optimality,
    entropy,
    expected_area,
    register_reward,
    t_optimality,
)
from tests.env.helpers import make
from tests.env.make import reward_inputs
from tests.slam.make import belief, grid


def inputs(
    sigmas: tuple[float, ...] = (0.1, 0.1), known: int = 40, pose: float = 1e-2, diverged: bool = False
) -> RewardInputs:
    """Columns of a grid of 8 m by 4 m that are known, from the left, and landmarks at 1 m, 5 m, ... of these sigmas."""
    label = np.zeros((40, 80))
    label[:, :known] = 1
    p_map = [(1.0 + 4.0 * n, 2.0) for n in range(len(sigmas))]
    known = belief(p_map=p_map, pose_cov=pose**2, covs=np.square(sigmas))
    return reward_inputs(known, grid(label), diverged=diverged)


def reliability(sigma: float) -> float:
    return 1.0 - math.exp(-(TAU_M**2) / (2.0 * sigma**2))


def test_expected_area_is_the_mapped_area_times_the_reliability_of_the_nearest_landmark() -> None:
    assert expected_area(inputs((0.1,))) == pytest.approx(16.0 * reliability(0.1))
    near, far = 0.05, 0.5  # the second landmark, 5 m from the left, is nearer from 3 m on
    split = 4.0 * (3.2 * reliability(near) + 0.8 * reliability(far))
    assert expected_area(inputs((near, far))) == pytest.approx(split, rel=0.05)


def test_entropy_is_that_of_cells_that_are_right_with_a_probability() -> None:
    r = reliability(0.1)
    p = 0.5 * (1.0 + r)
    uncertain = -(p * math.log(p) + (1.0 - p) * math.log(1.0 - p))
    assert entropy(inputs((0.1,))) == pytest.approx(16.0 * (math.log(2.0) - uncertain))


def test_optimality_criteria_of_eigenvalues() -> None:
    now = inputs((0.1, 0.4), pose=0.2)
    turned = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    now.belief.covs[1] = turned @ np.diag([0.04, 0.25]) @ turned.T
    values = np.array([0.04, 0.04, 0.04, 0.01, 0.01, 0.04, 0.25])
    assert d_optimality(now) == pytest.approx(-0.5 * np.log(values).mean())
    assert a_optimality(now) == pytest.approx(-0.5 * math.log(values.mean()))
    assert t_optimality(now) == pytest.approx(0.5 * math.log((1.0 / values).mean()))


@pytest.mark.parametrize("potential", [expected_area, entropy, d_optimality, a_optimality, t_optimality])
def test_a_better_belief_is_worth_more_and_a_diverged_one_least(potential) -> None:
    poor, good = potential(inputs((0.3, 0.3))), potential(inputs((0.1, 0.1)))
    assert good > poor > potential(inputs((0.1, 0.1), diverged=True))


def landmarks_seen(inputs: RewardInputs) -> float:
    return float(len(inputs.belief.ids))


def test_a_custom_reward_by_name() -> None:
    register_reward("landmarks_seen", landmarks_seen)
    env = make(layout="two_rooms", reward={"custom": {"landmarks_seen": 2.0}})
    _, info = env.reset(seed=0)
    begin, total = info["landmarks"], 0.0
    for _ in range(15):
        *_, info = env.step(np.array([0.5, 0.3], np.float32))
        total += info["reward_landmarks_seen"]
    assert total == 2.0 * (info["landmarks"] - begin)


WRONG = [
    ({"landmark_seen": 1.0}, r"custom\.landmark_seen: landmark_seen: not registered.*did you mean 'landmarks_seen'"),
    ({"area": 1.0}, "area: one of ours"),
    ({"x": "much"}, "x"),
]
FAILING = [
    (lambda inputs: math.nan, "gave nan.*, a finite number expected"),
    (lambda inputs: None, "gave None.*, a finite number expected"),
    (lambda inputs: inputs.walls, r"failed: AttributeError: .*\(<lambda>, line \d+\)"),
]


def test_a_wrong_custom_reward_is_named() -> None:
    register_reward("landmarks_seen", landmarks_seen)
    for custom, message in WRONG:
        with pytest.raises(ConfigError, match=message):
            make(reward={"custom": custom})
    for name, potential in (("two words", landmarks_seen), ("seen", 3)):
        with pytest.raises(ConfigError):
            register_reward(name, potential)
    for potential, said in FAILING:
        register_reward("wrong", potential)
        with pytest.raises(ConfigError, match=f"potential 'wrong' {said}"):
            make(reward={"custom": {"wrong": 1.0}}).reset(seed=0)
