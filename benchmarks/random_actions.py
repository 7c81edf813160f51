"""One environment driven with random actions, for measurements of time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from benchmarks.in_tree import random_commands

Choose = Callable[[Any, Generator], Any]  # the action in an environment


def velocity(env: Any, rng: Generator) -> Any:
    """Forward, with some turning."""
    return rng.uniform((0.3, -0.4), (1.0, 0.4)).astype(np.float32)


def goal(env: Any, rng: Generator) -> int:
    """One of the goals that are offered."""
    rows = np.flatnonzero(env.get_wrapper_attr("action_masks")())
    return int(rng.choice(rows)) if len(rows) else 0


def sample(env: Any, rng: Generator) -> Any:
    """Any action of the space."""
    return env.action_space.sample()


class RandomDriver:
    """An environment, and the random actions that drive it; a new episode follows where one ends."""

    def __init__(self, env: Any, choose: Choose, seed: int = 0) -> None:
        self.env, self.choose, self.rng = env, choose, np.random.default_rng(0)
        self.processor_s = 0.0  # in `env.step`
        self.episodes = 0  # that ended
        env.action_space.seed(seed)
        self.observation = env.reset(seed=seed)[0]

    def step(self) -> int:
        """One action: its control steps."""
        action, start = self.choose(self.env, self.rng), time.process_time()
        self.observation, _, terminated, truncated, info = self.env.step(action)
        self.processor_s += time.process_time() - start
        if terminated or truncated:
            self.episodes += 1
            self.observation = self.env.reset()[0]
        return int(info.get("periods", 1))

    def seconds_per_step(self, actions: int) -> float:
        """CPU time per control step of so many actions, resets left out."""
        before = self.processor_s
        steps = sum(self.step() for _ in range(actions))
        return (self.processor_s - before) / steps


def wander(env: Any, steps: int, seed: int = 0) -> None:
    """Drive with random velocities that are each held for ten control steps."""
    commands = random_commands(seed)
    driver = RandomDriver(env, lambda env, rng: next(commands), seed)
    for _ in range(steps):
        driver.step()
