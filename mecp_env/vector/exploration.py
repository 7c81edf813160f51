"""One exploration, by which compiled functions are loaded before workers are forked."""

from __future__ import annotations

import functools

from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.wrappers import GoalActions


def explore(layout: str) -> None:
    """One exploration, and its scores."""
    env, policy = MecpEnv(layout=layout), BreadthFirst()
    goals = GoalActions(env)
    observation, _ = goals.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = goals.step(policy.act(observation, goals.action_masks()))
        over = terminated or truncated
    env.summary()


@functools.cache
def load() -> None:
    """Have the functions of an episode loaded, once per process: those that are forked later share their memory."""
    explore("two_rooms")
