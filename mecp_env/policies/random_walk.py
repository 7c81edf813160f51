"""The lower bound: a random walk without planning."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.policies.one_episode import main

LEAST_HELD, MOST_HELD = 3, 20  # steps for which a command is held
TURN_ON_THE_SPOT = 0.3  # share of the commands


class RandomWalk:
    """Holds a random command for a random while: mostly forward along an arc, sometimes a turn on the spot."""

    actions = "velocity"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.rng = np.random.default_rng(seed)
        self.command = np.zeros(2, np.float32)
        self.left = 0

    def act(self, observation: Any = None, mask: Any = None) -> NDArray[np.float32]:
        """Shares (2,) of the largest speed and turn rate; the observation is not looked at."""
        if self.left == 0:
            self.left = int(self.rng.integers(LEAST_HELD, MOST_HELD + 1))
            self.command = self._draw()
        self.left -= 1
        return self.command.copy()

    def _draw(self) -> NDArray[np.float32]:
        if self.rng.random() < TURN_ON_THE_SPOT:
            return np.array([0.0, self.rng.uniform(-1.0, 1.0)], np.float32)
        return np.array([self.rng.uniform(0.5, 1.0), self.rng.uniform(-0.25, 0.25)], np.float32)


if __name__ == "__main__":
    sys.exit(main("random_walk"))
