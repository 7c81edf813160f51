"""Attempts at reward hacking, against honest exploration; each uses the true pose, which no agent has."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.env import MecpEnv
from mecp_env.episode.rewards import TERMS
from mecp_env.evaluation.ground_truth import CELL_M
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.wrappers import GoalActions
from tests.env.helpers import episode_of, world_of

Array = NDArray[np.float64]
Drive = Iterator[tuple[float, float]]


@dataclass
class Episode:
    """The rewards of an episode, step by step."""

    free_m2: float = 0.0  # of the building
    mapped_m2: float = 0.0  # what counted as mapped at the end
    rewards: list[dict[str, float]] = field(default_factory=list)  # of each term
    metres: list[float] = field(default_factory=list)
    last: dict[str, Any] = field(default_factory=dict)

    def note(self, info: dict[str, Any]) -> None:
        self.rewards.append({name: info[f"reward_{name}"] for name in TERMS})
        self.metres.append(info["metres"])
        self.last = info

    def weigh_up(self, env: MecpEnv) -> None:
        """Record the state at the end."""
        self.free_m2, self.mapped_m2 = world_of(env).truth.free_cells * CELL_M**2, episode_of(env).memory.area_m2

    @property
    def seen_m2(self) -> float:
        """The true free area that was seen."""
        return float(self.last["coverage"]) * self.free_m2

    def paid(self, *terms: str, until_m: float = math.inf) -> float:
        """The sum of some terms (all by default) up to a distance driven."""
        rows = zip(self.rewards, self.metres, strict=True)
        return sum(row[name] for row, metres in rows if metres <= until_m for name in terms or TERMS)


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


def blind(env: MecpEnv, rng: np.random.Generator) -> Drive:
    """Full speed, ignoring obstacles."""
    while True:
        turn = rng.uniform(-0.3, 0.3)
        for _ in range(20):
            yield 1.0, turn


def bump(env: MecpEnv, rng: np.random.Generator) -> Drive:
    """Scrape along walls to increase uncertainty, and return home to reduce it."""
    home = world_of(env).T_world_robot[:2].copy()
    while True:
        for step in range(30):
            yield 1.0, 0.6 if step % 10 < 5 else -0.6
        yield from go(env, home)
        for _ in range(10):
            yield 0.0, 0.8


def walk(env: MecpEnv, rng: np.random.Generator) -> Drive:
    """A random walk."""
    while True:
        held = int(rng.integers(3, 21))
        command = (0.0, rng.uniform(-1, 1)) if rng.random() < 0.3 else (rng.uniform(0.5, 1), rng.uniform(-0.25, 0.25))
        for _ in range(held):
            yield command


ATTEMPTS: dict[str, Callable[[MecpEnv, np.random.Generator], Drive]] = {
    attempt.__name__: attempt for attempt in (stand, spin, shuttle, blind, bump, walk)
}


def go(env: MecpEnv, p_world: Array) -> Drive:
    """Towards a point, until there, or for at most 40 steps."""
    for _ in range(40):
        x, y, heading = world_of(env).T_world_robot
        if math.hypot(p_world[0] - x, p_world[1] - y) < 0.25:
            return
        turn = math.remainder(math.atan2(p_world[1] - y, p_world[0] - x) - heading, 2.0 * math.pi)
        yield max(0.0, math.cos(turn)) ** 3, min(max(1.5 * turn, -1.0), 1.0)


def attempt(name: str, seed: int, **keywords: Any) -> Episode:
    """An episode of an attempt."""
    env, episode = MecpEnv(**keywords), Episode()
    env.reset(seed=seed)
    drive = ATTEMPTS[name](env, np.random.default_rng(seed))
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(np.array(next(drive), np.float32))
        episode.note(info)
        over = terminated or truncated
    episode.weigh_up(env)
    return episode


def explore(seed: int, waits: int = 0, **keywords: Any) -> Episode:
    """An episode of the breadth-first explorer, which may wait some steps before it starts."""
    episode, policy = Episode(), BreadthFirst()
    base = MecpEnv(actions="goal", **keywords)
    env = GoalActions(base, callback=lambda step: episode.note(step[4]))
    observation, _ = env.reset(seed=seed)
    for _ in range(waits):
        observation, *_, info = base.step(np.zeros(2, np.float32))
        episode.note(info)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation, env.action_masks()))
        over = terminated or truncated
    episode.weigh_up(env.base)
    return episode
