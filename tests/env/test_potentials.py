"""Potentials of the reward: formulas, more for better beliefs, nothing for detours, custom ones by name."""

import math

import numpy as np
import pytest
from scipy import stats

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
from tests.env.helpers import drive, make, started
from tests.env.make import reward_inputs
from tests.slam.make import belief, grid


def inputs(sigmas: tuple[float, ...], pose: float = 1e-2, diverged: bool = False) -> RewardInputs:
    """The left half of a grid of 8 m by 4 m is known, and landmarks at 1 m, 5 m, ... of these sigmas."""
    p_map = [(1.0 + 4.0 * n, 2.0) for n in range(len(sigmas))]
    known = belief(p_map=p_map, pose_cov=pose**2, covs=np.square(sigmas))
    return reward_inputs(known, grid(np.tile(np.arange(80) < 40, (40, 1))), diverged=diverged)


def reliability(sigma: float) -> float:
    return 1.0 - math.exp(-(TAU_M**2) / (2.0 * sigma**2))


def test_expected_area_is_the_mapped_area_times_the_reliability_of_the_nearest_landmark() -> None:
    assert expected_area(inputs((0.1,))) == pytest.approx(16.0 * reliability(0.1))
    split = 4.0 * (3.2 * reliability(0.05) + 0.8 * reliability(0.5))  # the second landmark is nearer from 3 m on
    assert expected_area(inputs((0.05, 0.5))) == pytest.approx(split, rel=0.05)


def test_entropy_is_that_of_cells_that_are_right_with_a_probability() -> None:
    right = 0.5 * (1.0 + reliability(0.1))
    assert entropy(inputs((0.1,))) == pytest.approx(16.0 * (math.log(2.0) - stats.bernoulli(right).entropy()))


def test_optimality_criteria_of_eigenvalues() -> None:
    now = inputs((0.1, 0.4), pose=0.2)
    now.belief.covs[1] = [[0.16, 0.07], [0.07, 0.1]]
    values = np.array([0.04, 0.04, 0.04, 0.01, 0.01, *np.linalg.eigvalsh(now.belief.covs[1])])
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
    env = started(reward={"custom": {"landmarks_seen": 2.0}})
    begin, rows = env.info()["landmarks"], drive(env, 15)
    assert sum(row[4]["reward_landmarks_seen"] for row in rows) == 2.0 * (rows[-1][4]["landmarks"] - begin)


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
