"""The floor: a random walk that neither plans nor looks. `python -m agents.random_walk --layout two_rooms`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.errors import MecpError

WRONG_INPUT = 2
LEAST_HELD, MOST_HELD = 3, 20  # periods for which a command is held
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


@dataclass(frozen=True)
class Args:
    """Walk at random and say how far that came."""

    layout: str = "paper"  # a shipped layout, or the path of a layout file
    seed: int = 0  # of the environment and of the walk
    periods: int = 3000  # control periods of 0.4 s


def main(args: Args) -> int:
    """One episode; prints its figures. Exit code 0, or 2 for wrong input."""
    try:
        return walk(args)
    except (MecpError, gym.error.Error) as error:
        print(f"random_walk: {error}", file=sys.stderr)
        return WRONG_INPUT


def walk(args: Args) -> int:
    """One episode; prints its figures."""
    agent = RandomWalk()
    env = gym.make("mecp_env/Layout-v0", layout=args.layout, actions=agent.actions, max_periods=args.periods)
    observation, _ = env.reset(seed=args.seed)
    agent.reset(args.seed)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(agent.act(observation))
        over = terminated or truncated
    for name, value in env.get_wrapper_attr("summary")().items():
        print(f"{name:26s}{value:10.4g}")
    env.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Args)))
