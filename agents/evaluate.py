"""Evaluate a policy on generated buildings, with a plain loop.

    python agents/evaluate.py --policy maskable_ppo --episodes 5

`mecp-env evaluate` adds processes, paired differences with intervals, tables, curves and a film.
"""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.policies import make_policy


@dataclass
class Args:
    """Options of this script."""

    policy: str = "nearest"  # bfs, nearest, gain, random_goal, random_walk, maskable_ppo, a run folder, or module:Class
    difficulty: str = "medium"  # easy, medium, hard or huge
    split: str = "test"  # of the buildings: train, validation or test
    episodes: int = 10  # buildings, one episode in each
    max_steps: int = 3000  # control steps per episode, at most


def main(args: Args) -> None:
    """Print one line per building, and the means."""
    policy = make_policy(args.policy)
    env = gym.make(
        "mecp_env/Rooms-v0",
        difficulty=args.difficulty,
        split=args.split,
        actions=policy.actions,
        start="random",
        max_steps=args.max_steps,
    )
    summaries = []
    for building in range(args.episodes):
        observation, _ = env.reset(seed=building, options={"building": building})
        policy.reset(building)
        terminated = truncated = False
        while not (terminated or truncated):
            mask = env.get_wrapper_attr("action_masks")() if policy.actions == "goal" else None
            observation, _, terminated, truncated, _ = env.step(policy.act(observation, mask))
        summaries.append(env.get_wrapper_attr("summary")())
        print("building {:3d}: coverage {coverage:.1%} in {metres:.1f} m".format(building, **summaries[-1]))
    for name in ("coverage", "metres", "pose_rmse_m"):
        print(f"mean {name:12s}{np.mean([summary[name] for summary in summaries]):10.4g}")
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
