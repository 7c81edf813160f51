"""The paper's explorer, as a complete example of a custom policy.

    python agents/bfs.py --layout office
    mecp-env evaluate agents.bfs:RoomByRoom nearest --episodes 20

A policy has `actions` (the action mode that it needs), `reset(seed)` and `act(observation, mask)`. The observation's
`goals` (32,9) has the columns x, y, path length (m), size, kind, room, level, visits, valid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import tyro

import mecp_env  # noqa: F401  (registers the environments)

PATH, KIND, ROOM, LEVEL, VALID = 2, 4, 5, 6, 8
DOOR = 3


@dataclass
class Args:
    """Options of this script."""

    layout: str = "paper"  # a layout name or the path of a layout file
    seed: int = 0  # of start and noise; the same seed gives the same episode
    max_steps: int = 3000  # control steps of 0.4 s, at most
    render: bool = False  # open a window: ground truth on the left, the robot's estimate on the right


class RoomByRoom:
    """Completes the room of the robot, then rooms that were left early, then goes through the next door."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Nothing here is random, and no state is kept."""

    def act(self, observation: dict[str, Any], mask: Any = None) -> int:
        """Row of the goal to drive to; `mask` (32,) excludes rows."""
        goals = observation["goals"].astype(float)
        valid = (goals[:, VALID] > 0.5) & (True if mask is None else mask)
        inside = np.flatnonzero((goals[:, VALID] > 0.5) & (goals[:, KIND] != DOOR))
        room = goals[inside[0], ROOM] if len(inside) else -1.0  # goals of the robot's own room come first

        def order(row: int) -> tuple[float, ...]:
            if goals[row, KIND] == DOOR:
                return 2.0, goals[row, LEVEL], goals[row, PATH]
            if goals[row, ROOM] == room:
                return 0.0, goals[row, LEVEL], goals[row, PATH]
            return 1.0, goals[row, PATH], goals[row, LEVEL]

        return int(min(np.flatnonzero(valid), key=order, default=0))


def main(args: Args) -> None:
    """Run one episode, and print its metrics."""
    env = gym.make(
        "mecp_env/Layout-v0",
        layout=args.layout,
        actions="goal",
        max_steps=args.max_steps,
        render_mode="human" if args.render else None,
    )
    policy = RoomByRoom()
    observation, info = env.reset(seed=args.seed)
    policy.reset(args.seed)
    terminated = truncated = False
    while not (terminated or truncated):
        action = policy.act(observation, env.get_wrapper_attr("action_masks")())
        observation, _, terminated, truncated, info = env.step(action)
        print(f"goal {action:2d} {info['event']:8s} coverage {info['coverage']:.1%} after {info['metres']:.1f} m")
    for name, value in env.get_wrapper_attr("summary")().items():
        print(f"{name:26s}{value:10.4g}")
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
