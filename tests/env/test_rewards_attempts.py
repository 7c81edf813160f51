"""Reward hacking, without exploring or with a wrong map, loses against honest exploration."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from mecp_env.config import REWARD_PRESETS, RewardConfig
from tests.env.attempts import ATTEMPTS, Episode, attempt, explore

STEPS = 300  # of an attempt; an exploration of `paper` takes some 500, and pays for their time
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
WEIGHTS = RewardConfig(preset="terms")
PAPER: dict[str, Any] = {"layout": "paper", "laser": {"sweeps": 1}, "start": "random"}


@cache
def honest(seed: int) -> Episode:
    return explore(seed, max_steps=4 * STEPS, reward="terms", **PAPER)


@cache
def tried(name: str, seed: int) -> Episode:
    return attempt(name, seed, max_steps=STEPS, reward="terms", **PAPER)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ATTEMPTS)
def test_an_attempt_loses_by_episode_and_by_metre(name: str, seed: int) -> None:
    given, other = tried(name, seed), honest(seed)
    as_far = max(given.metres[-1], 5.0)
    assert given.paid() < 0.2 * other.paid()
    assert given.paid() < other.paid(until_m=as_far)  # without the completion reward
    assert given.paid("completion") == 0.0


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", ATTEMPTS)
def test_no_area_is_paid_that_there_is_not(name: str, seed: int) -> None:
    given = tried(name, seed)
    assert given.mapped_m2 <= 1.1 * given.seen_m2  # walls are mapped too
    assert given.paid("area") <= WEIGHTS.area * given.mapped_m2


@pytest.mark.parametrize("reward", ["terms", "coverage", "correct_coverage"])
def test_driving_blind_until_the_filter_diverges_loses_all(reward: str) -> None:
    keywords = {"layout": "paper", "laser": {"sweeps": 1, "max_range_m": 2.5}, "odometry": {"scale": 8.0}}
    keywords |= {"start": "random", "max_steps": STEPS, "slam": {"filter": {"diverged_sigma_m": 0.4}}}
    lost, idle = attempt("blind", 0, reward=reward, **keywords), attempt("stand", 0, reward=reward, **keywords)
    assert lost.last["diverged"]
    if reward == "terms":
        assert lost.paid("area") < 0.0  # the map of the start as well
        assert lost.paid() < WEIGHTS.time * 3000 < idle.paid()  # worse than standing still for a whole episode
    else:
        assert lost.paid(reward) < idle.paid(reward)
        assert lost.rewards[-1][reward] < 0.0


def test_breadth_first_earns_most_and_time_counts() -> None:
    """Totals with default weights: exploring earns most, standing still costs time, a random walk costs contacts."""
    stand, walk, other = tried("stand", 0), tried("walk", 0), honest(0)
    assert other.paid() > 30.0
    assert other.paid("area") + other.paid("completion") > 10.0 * abs(other.paid("time", "contact"))
    assert walk.paid() < stand.paid() < 0.0
    assert walk.paid("area") > 5.0 * stand.paid("area")


def test_to_complete_earlier_earns_more() -> None:
    keywords = {"layout": "two_rooms", "laser": {"sweeps": 1}, "reward": "terms"}
    for seed in range(2):
        soon, late = explore(seed, **keywords), explore(seed, waits=40, **keywords)
        assert soon.paid("completion") == pytest.approx(late.paid("completion"), rel=0.05)
        assert soon.paid("completion") > 3.0  # 10 for 100 m^2, of 45
        assert soon.paid("time") == pytest.approx(late.paid("time") - 40 * WEIGHTS.time, abs=0.03)
        assert soon.paid() > late.paid()


POTENTIALS = ("expected_area", "entropy", "d_optimality", "a_optimality", "t_optimality")
IN_TASK = {
    "layout": "paper",
    "laser": {"sweeps": 1, "max_range_m": 4.0},
    "reward": {"preset": "active_terms"} | dict.fromkeys(POTENTIALS, 1.0),
}
OPTIMALITY_NAT = 4.0  # by which an episode changes a criterion at most; ln(3) / 2 as all of the start pose is exact


def paid_by_task(episode: Episode) -> float:
    """The return with the reward of the tasks of active SLAM."""
    area = REWARD_PRESETS["active_terms"]["expected_area"] * episode.paid("expected_area")
    return episode.paid() - episode.paid(*POTENTIALS) + area


def test_a_map_pays_more_than_any_attempt_and_optimality_pays_little() -> None:
    """Criteria of optimality alone favour a robot that stays: standing earns most, but only once."""
    explored = explore(0, **IN_TASK)
    for name in ("stand", "shuttle", "bump"):
        given = attempt(name, 0, max_steps=150, **IN_TASK)
        assert paid_by_task(given) < 0.3 * paid_by_task(explored)
        for term in ("expected_area", "entropy"):
            assert given.paid(term) < 0.5 * explored.paid(term)
        for term in ("d_optimality", "a_optimality", "t_optimality"):
            assert max(abs(given.paid(term)), abs(explored.paid(term))) < OPTIMALITY_NAT


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("metric", ["coverage", pytest.param("correct_coverage", marks=pytest.mark.slow)])
def test_under_a_metric_every_attempt_earns_less_than_exploring(metric: str, seed: int) -> None:
    keywords = {"max_steps": 2 * STEPS, "reward": metric, **PAPER}
    tries = {name: attempt(name, seed, **keywords).paid() for name in ("stand", "spin", "shuttle", "bump")}
    assert max(tries.values()) < 0.9 * explore(seed, **keywords).paid()
    assert tries["stand"] <= tries["shuttle"] + 0.1  # penalties are bounded by .1 each
