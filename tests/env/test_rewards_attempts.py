"""Reward hacking, without exploring or with a wrong map, loses against honest exploration.

The attempts use the true pose, which no agent has.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mecp_env.config import METRIC_PRESETS, RewardConfig
from mecp_env.env import MecpEnv
from mecp_env.episode.rewards import TERMS
from mecp_env.evaluation.ground_truth import CELL_M
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.wrappers import GoalActions
from tests.env.helpers import episode_of, until_over, world_of

Array = NDArray[np.float64]
Drive = Iterator[tuple[float, float]]
Infos = list[dict[str, Any]]  # of each step


def paid(infos: Infos, *terms: str, until_m: float = math.inf) -> float:
    """The sum of some terms of the reward up to a distance driven."""
    return sum(info[f"reward_{name}"] for info in infos if info["metres"] <= until_m for name in terms)


def stand(env: MecpEnv, rng: np.random.Generator) -> Drive:
    while True:
        yield 0.0, 0.0


def spin(env: MecpEnv, rng: np.random.Generator) -> Drive:
    while True:
        yield 0.0, 1.0


def shuttle(env: MecpEnv, rng: np.random.Generator) -> Drive:
    """Through the door of the first room and back."""
    start = world_of(env).T_world_robot[:2]
    doors = world_of(env).outline.doors.centre
    door = doors[np.argmin(np.hypot(*(doors - start).T))]
    across = np.array([0.0, 1.0]) if abs(door[1] - start[1]) > abs(door[0] - start[0]) else np.array([1.0, 0.0])
    while True:
        yield from go(env, door - across)
        yield from go(env, door + across)


def bump(env: MecpEnv, rng: np.random.Generator) -> Drive:
    """Scrape along walls to increase uncertainty, and return home to reduce it."""
    home = world_of(env).T_world_robot[:2].copy()
    while True:
        for step in range(30):
            yield 1.0, 0.6 if step % 10 < 5 else -0.6
        yield from go(env, home)
        for _ in range(10):
            yield 0.0, 0.8


ATTEMPTS: dict[str, Callable[[MecpEnv, np.random.Generator], Drive]] = {
    attempt.__name__: attempt for attempt in (stand, spin, shuttle, bump)
}


def go(env: MecpEnv, p_world: Array) -> Drive:
    """Towards a point, until there, or for at most 40 steps."""
    for _ in range(40):
        x, y, heading = world_of(env).T_world_robot
        if math.hypot(p_world[0] - x, p_world[1] - y) < 0.25:
            return
        turn = math.remainder(math.atan2(p_world[1] - y, p_world[0] - x) - heading, 2.0 * math.pi)
        yield max(0.0, math.cos(turn)) ** 3, min(max(1.5 * turn, -1.0), 1.0)


def attempt(name: str, seed: int, **keywords: Any) -> tuple[Infos, MecpEnv]:
    """An episode of an attempt, and its environment at the end."""
    env = MecpEnv(**keywords)
    env.reset(seed=seed)
    drive = ATTEMPTS[name](env, np.random.default_rng(seed))
    return [row[4] for row in until_over(env, lambda _: np.array(next(drive), np.float32))], env


def explore(seed: int, **keywords: Any) -> Infos:
    """An episode of the breadth-first explorer."""
    infos, policy = Infos(), BreadthFirst()
    env = GoalActions(MecpEnv(actions="goal", **keywords), callback=lambda step: infos.append(step[4]))
    observation, _ = env.reset(seed=seed)
    for _ in until_over(env, lambda seen: policy.act(seen, env.action_masks()), observation):
        pass  # the callback notes each step
    return infos


STEPS = 300  # of an attempt; an exploration of `paper` takes some 500, and pays for their time
WEIGHTS, SHARES = RewardConfig(preset="terms"), {"contact_share": -0.1, "lost_share": -0.1}
TASK: dict[str, Any] = {"layout": "paper", "laser": {"sweeps": 1}, "start": "random"}
TASK["reward"] = {"preset": "terms"} | dict.fromkeys(METRIC_PRESETS, 1.0) | SHARES  # all in one episode
OWN = [name for name in TERMS if name not in (*METRIC_PRESETS, *SHARES)]


@pytest.fixture(scope="module")
def tries() -> dict[str, tuple[Infos, MecpEnv]]:
    return {name: attempt(name, 0, max_steps=STEPS, **TASK) for name in ATTEMPTS}


def test_an_attempt_loses_by_episode_and_by_metre_and_no_area_is_paid_that_there_is_not(tries) -> None:
    honest = explore(0, max_steps=4 * STEPS, **TASK)
    for infos, env in tries.values():
        assert paid(infos, *OWN) < 0.2 * paid(honest, *OWN)
        assert paid(infos, *OWN) < paid(honest, *OWN, until_m=max(infos[-1]["metres"], 5.0))  # without completion
        assert paid(infos, "completion") == 0.0
        mapped_m2, free_m2 = episode_of(env).memory.area_m2, world_of(env).truth.free_cells * CELL_M**2
        assert mapped_m2 <= 1.1 * infos[-1]["coverage"] * free_m2  # walls are mapped too
        assert paid(infos, "area") <= WEIGHTS.area * mapped_m2


def test_under_a_metric_every_attempt_earns_less_than_exploring(tries) -> None:
    honest = explore(0, max_steps=STEPS, **TASK)
    for metric in METRIC_PRESETS:
        earned = {name: paid(infos, metric, *SHARES) for name, (infos, _) in tries.items()}
        assert max(earned.values()) < 0.9 * paid(honest, metric, *SHARES)
        assert earned["stand"] <= earned["shuttle"] + 0.1  # penalties are bounded by .1 each
