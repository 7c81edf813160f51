"""Rewards whose sum is a metric: they equal it, for any policy, building and end; shaping sums to nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy.special import erf

from mecp_env.config import EnvConfig, RewardConfig
from mecp_env.core.errors import ConfigError
from mecp_env.episode.potentials import (
    BLOCK_CELLS,
    NEAR_M,
    MetricMemory,
    RewardInputs,
    coverage,
    expected_correct_m2,
    metric_terms,
    nearness,
    start_metrics,
)
from mecp_env.slam.messages import Cell
from tests.env.helpers import make
from tests.env.make import reward_inputs
from tests.slam.make import belief, grid

FREE_M2 = 50.0
TRUTH = {"source": "truth", "contact_share": 0.0, "lost_share": 0.0}


def run(
    env: gymnasium.Env, seed: int = 0, steps: int = 10**6, speed: float = 1.0
) -> tuple[list[float], dict[str, Any]]:
    """Rewards of a random walk, and the last info."""
    env.reset(seed=seed)
    rng, rewards, over = np.random.default_rng(seed), [], False
    while not over and len(rewards) < steps:
        action = rng.uniform(-speed, speed, 2).astype(np.float32)
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        over = terminated or truncated
    return rewards, info


@pytest.mark.parametrize("metric", ["coverage", "correct_coverage"])
@pytest.mark.parametrize(("shaping", "end"), [(0.0, {}), (0.3, {"coverage": 0.6})])
def test_with_the_source_truth_the_return_is_the_metric(metric: str, shaping: float, end: dict[str, float]) -> None:
    keywords = {"layout": "two_rooms", "max_steps": 60, "end": end}
    env = make(**keywords, reward={"preset": metric, "shaping": shaping, **TRUTH})
    paced, moved = make(**keywords, reward={"preset": metric, "pace": 1.0, **TRUTH}), []
    for seed, speed in enumerate((0.5, 1.0)):
        rewards, info = run(env, seed, speed=speed)
        assert sum(rewards) == pytest.approx(info[f"{metric}_over_steps"], abs=1e-9)
        assert 0.0 < sum(rewards) <= 1.0
        rewards, info = run(paced, speed=speed)
        moved.append(sum(rewards) - info[f"{metric}_over_steps"])
    assert moved == pytest.approx([moved[0]] * 2, abs=1e-9)  # pace moves the return by what no action changes
    assert -1.0 < moved[0] < 0.0


def test_rewards_are_those_of_the_formula_and_at_pace_1_a_step_costs_what_is_missing() -> None:
    shares, limit, paid = [0.1, 0.3, 0.2, 0.5], 3, []
    for pace in (0.0, 1.0):
        config, memory = RewardConfig(preset="coverage", pace=pace), MetricMemory()
        start_metrics(memory, inputs_of(shares[0], 1.0), config)
        memory.owed.clear()
        for step, (before, share) in enumerate(pairwise(shares), start=1):
            terms = metric_terms(memory, inputs_of(share, 1.0 - step / limit), config)
            paid += [terms["coverage"]] if pace == 0.0 else []
            assert pace == 0.0 or terms["coverage"] + terms["pace"] == pytest.approx(-(1.0 - before) / limit)
    assert paid == pytest.approx([0.2 * 2 / 3, -0.1 * 1 / 3, 0.0])
    assert 0.1 + sum(paid) == pytest.approx(np.mean(shares[:limit]))


def test_after_the_end_nothing_can_be_earned() -> None:
    config = RewardConfig(preset="coverage", pace=1.0)
    memory = MetricMemory()
    start_metrics(memory, inputs_of(0.5, 1.0), config)
    terms = metric_terms(memory, inputs_of(0.5, 0.9)._replace(over=True), config)
    assert terms["pace"] == pytest.approx(-0.5)


def test_the_belief_pays_nearly_what_the_truth_pays() -> None:
    by_belief, by_truth = (
        run(make(layout="paper", max_steps=150, reward={"preset": "coverage", **TRUTH, "source": source}))[0]
        for source in ("belief", "truth")
    )
    assert sum(by_belief) == pytest.approx(sum(by_truth), rel=0.1)


def test_floor_beyond_the_building_counts_once_and_the_nearest_goal() -> None:
    memory = MetricMemory(floor_m2=2.0 * FREE_M2)
    inputs = inputs_of(None, 1.0)
    assert coverage(memory, inputs) == 1.0
    assert coverage(memory, inputs._replace(diverged=True)) == 0.0
    assert nearness(inputs) == 0.0
    near = inputs._replace(p_goals=np.array([[3.0, 4.0], [30.0, 0.0]]))
    assert nearness(near) == pytest.approx(np.exp(-5.0 / NEAR_M))


@pytest.mark.parametrize("seed", range(5))
def test_expected_correct_area_against_a_plain_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, (21, 37)).astype(np.uint8)
    origin, side = rng.uniform(-5, 5, 2), 0.1
    p_map, spread = rng.uniform(-5, 5, (6, 2)), rng.uniform(0.001, 0.3, 6)
    inputs = reward_inputs(belief(p_map=p_map, covs=spread), grid(label, origin=origin))
    expected = 0.0
    for i, j in np.argwhere((label == Cell.FREE) | (label == Cell.DOOR)):
        block = np.array([j // BLOCK_CELLS, i // BLOCK_CELLS]) + 0.5
        nearest = np.argmin(np.hypot(*(p_map - origin - block * BLOCK_CELLS * side).T))
        expected += side**2 * erf(0.25 / np.sqrt(2.0 * spread[nearest]))
    assert expected_correct_m2(inputs) == pytest.approx(expected)
    assert expected_correct_m2(inputs._replace(diverged=True)) == 0.0


def test_presets_and_what_contradicts_them() -> None:
    assert EnvConfig().reward == EnvConfig(reward="coverage").reward
    assert EnvConfig.build(reward={"area": 0.2}).reward.preset == "terms"  # weights alone
    assert EnvConfig.build(reward={"contact_share": -0.2}).reward.preset == "coverage"
    assert EnvConfig.build({"reward": "correct_coverage"}, reward="terms").reward.completion == 10.0
    for name, value in (("area", 0.2), ("contact", -1.0), ("correct_coverage", 0.5)):
        with pytest.raises(ConfigError, match=rf"(?s){name}.*'coverage'"):
            EnvConfig(reward={"preset": "coverage", name: value})
    with pytest.raises(ConfigError, match="did you mean 'coverage'"):
        EnvConfig(reward="covrage")
    for preset in ("coverage", "correct_coverage", "terms", "active_terms"):
        assert EnvConfig.build(EnvConfig(reward=preset).to_dict()) == EnvConfig(reward=preset)


def inputs_of(share: float | None, budget: float) -> RewardInputs:
    """Inputs with a true coverage, or the belief's."""
    shares = None if share is None else (share, share)
    empty = grid(np.zeros((8, 8)), resolution_m=0.5)
    return reward_inputs(belief(), empty, true_shares=shares, free_area_m2=FREE_M2, budget=budget)
