"""Uniformly random goals."""

from __future__ import annotations

from typing import Any

import numpy as np

from mecp_env.policies.policy import Mask, choices


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
