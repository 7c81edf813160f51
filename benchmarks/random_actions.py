"""One environment driven with random actions, for measurements of time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

LEAST, MOST = (0.3, -0.4), (1.0, 0.4)  # of a velocity: forwards, with some turning


def velocity(env: Any, rng: Generator) -> Any:
    """Forward, with some turning."""
    return rng.uniform(LEAST, MOST).astype(np.float32)


def goal(env: Any, rng: Generator) -> int:
    """One of the goals that are offered."""
    rows = np.flatnonzero(env.get_wrapper_attr("action_masks")())
    return int(rng.choice(rows)) if len(rows) else 0


def sample(env: Any, rng: Generator) -> Any:
    """Any action of the space."""
    return env.action_space.sample()


class RandomDriver:
    """An environment, and the random actions that drive it; a new episode follows where one ends."""

    def __init__(self, env: Any, choose: Callable[[Any, Generator], Any]) -> None:
        self.env, self.choose, self.rng = env, choose, np.random.default_rng(0)
        self.processor_s = 0.0  # in `env.step`
        self.episodes = 0  # that ended
        env.action_space.seed(0)
        self.observation = env.reset(seed=0)[0]

    def step(self) -> int:
        """One action: its control steps."""
        action, start = self.choose(self.env, self.rng), time.process_time()
        self.observation, _, terminated, truncated, info = self.env.step(action)
        self.processor_s += time.process_time() - start
        if terminated or truncated:
            self.episodes += 1
            self.observation = self.env.reset()[0]
        return int(info.get("periods", 1))
