"""The simple explorers: the paper's breadth-first one, nearest goal, random goals, random walk, and standing still."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.policies.registry import PATH, Mask, choices

LEAST_HELD, MOST_HELD = 3, 20  # steps for which the random walk holds a command
TURN_IN_PLACE = 0.3  # share of its commands


class BreadthFirstPolicy(BreadthFirst):
    """`BreadthFirst` as a policy: it selects goals, planner and controller of the environment drive there."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""


class Nearest:
    """Drives to the goal with the shortest path: the standard baseline (Yamauchi 1997)."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random, and no state is kept."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the nearest goal, the first of equal ones; 0 when there is none."""
        rows = choices(observation, mask)
        return int(rows[observation["goals"][rows, PATH].argmin()]) if len(rows) else 0


class RandomGoal:
    """Drives to a goal drawn uniformly from those that may be selected: the value of the planner without a policy."""

    actions = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int = 0) -> None:
        """Start an episode."""
        self.rng = np.random.default_rng(seed)

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of a goal; 0 when there is none."""
        rows = choices(observation, mask)
        return int(self.rng.choice(rows)) if len(rows) else 0


class Standing:
    """Stands still: what an episode pays for nothing."""

    actions = "velocity"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""

    def act(self, observation: Any = None, mask: Any = None) -> NDArray[np.float32]:
        """The command (2,) to stand."""
        return np.zeros(2, np.float32)


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
