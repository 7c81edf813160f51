"""A policy that acts in several environments at once, with the memory of a recurrent one."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.policies import BasePolicy

from mecp_env.learning.compact import Observation
from mecp_env.learning.environments import GOAL_VALID
from mecp_env.learning.pointer import GoalPointerPolicy


class Player:
    """Takes the most probable action."""

    def __init__(self, policy: BasePolicy, environments: int) -> None:
        self.policy, self.memory = policy, None
        self.masked = isinstance(policy, GoalPointerPolicy)
        self.begins = np.ones(environments, np.bool_)

    def act(self, observations: Observation, mask: Any = None) -> np.ndarray:
        """Actions for compact observations (n,...); `mask` (n,32) in place of the one that follows from the goals."""
        more: dict[str, Any] = {}
        if self.masked:
            more["action_masks"] = observations["goals"][..., GOAL_VALID] > 0.5 if mask is None else mask
        actions, self.memory = self.policy.predict(
            observations, state=self.memory, episode_start=self.begins, deterministic=True, **more
        )
        self.begins = np.zeros_like(self.begins)
        return actions

    def over(self, dones: np.ndarray) -> None:
        """Note which episodes ended (n,): those environments begin a new one."""
        self.begins = np.asarray(dones, np.bool_)
