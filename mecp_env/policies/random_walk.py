"""The lower bound: a random walk without planning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAST_HELD, MOST_HELD = 3, 20  # steps for which a command is held
TURN_IN_PLACE = 0.3  # share of the commands


class RandomWalk:
    """Holds a random command for a random number of steps: usually forward along an arc, sometimes a turn in place."""

    actions = "velocity"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int = 0) -> None:
        """Start an episode."""
        self.rng = np.random.default_rng(seed)
        self.command = np.zeros(2, np.float32)
        self.left = 0

    def act(self, observation: Any = None, mask: Any = None) -> NDArray[np.float32]:
        """Normalised command (2,), shares of the largest speed and turn rate; the observation is not used."""
        if self.left == 0:
            self.left = int(self.rng.integers(LEAST_HELD, MOST_HELD + 1))
            self.command = self._draw()
        self.left -= 1
        return self.command.copy()

    def _draw(self) -> NDArray[np.float32]:
        if self.rng.random() < TURN_IN_PLACE:
            return np.array([0.0, self.rng.uniform(-1.0, 1.0)], np.float32)
        return np.array([self.rng.uniform(0.5, 1.0), self.rng.uniform(-0.25, 0.25)], np.float32)
