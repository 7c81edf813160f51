"""Options (the drive to a goal) of different durations in a rollout: each has a discount of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from sb3_contrib.common.maskable.buffers import MaskableDictRolloutBuffer
from stable_baselines3.common.policies import BasePolicy
from torch import Tensor


class OptionBuffer(MaskableDictRolloutBuffer):
    """Advantages of options (macro-actions) of different durations: each is followed by its own discount.

    GAE (Schulman et al. 2016) with gamma replaced by the discount of the option; set `next_discounts` before `add`.
    """

    discounts: np.ndarray
    next_discounts: np.ndarray  # (n_envs,) of the options that are added next

    def reset(self) -> None:
        self.discounts = np.ones((self.buffer_size, self.n_envs), np.float32)
        self.next_discounts = np.full(self.n_envs, self.gamma, np.float32)
        super().reset()

    def add(self, *args: Any, **kwargs: Any) -> None:
        """As of the base class."""
        self.discounts[self.pos] = self.next_discounts
        super().add(*args, **kwargs)

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
        """Write `advantages` and `returns` (steps, n_envs)."""
        values = np.concatenate([self.values, last_values.cpu().numpy().reshape(1, -1)])
        ended = np.concatenate([self.episode_starts[1:], dones.astype(np.float32).reshape(1, -1)])
        discounts = self.discounts * (1.0 - ended)
        advantage = np.zeros(self.n_envs, np.float32)
        for step in reversed(range(self.buffer_size)):
            error = self.rewards[step] + discounts[step] * values[step + 1] - values[step]
            advantage = error + discounts[step] * self.gae_lambda * advantage
            self.advantages[step] = advantage
        self.returns = self.advantages + self.values


def bootstrap_truncated(policy: BasePolicy, rewards: np.ndarray, infos: list[dict[str, Any]]) -> None:
    """Add to `rewards` (n_envs,) the value after options that a step limit truncated, by their own discount.

    sb3-contrib would use the constant discount, that of an option without metres.
    """
    for row, info in [(row, info) for row, info in enumerate(infos) if info["TimeLimit.truncated"]]:
        info["TimeLimit.truncated"] = False  # it is added here
        with torch.no_grad():
            value = policy.predict_values(policy.obs_to_tensor(info["terminal_observation"])[0])
        rewards[row] += info["discount"] * float(value)
