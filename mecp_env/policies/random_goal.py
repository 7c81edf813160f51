"""Any goal, all as likely. `python -m mecp_env.policies.random_goal --layout two_rooms`."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from mecp_env.policies.one_episode import main
from mecp_env.policies.policy import Mask, choices


class RandomGoal:
    """Drives to a goal drawn evenly from those that may be chosen: what the planner is worth without a policy."""

    actions = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.rng = np.random.default_rng(seed)

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of a goal; 0 when there is none."""
        rows = choices(observation, mask)
        return int(self.rng.choice(rows)) if len(rows) else 0


if __name__ == "__main__":
    sys.exit(main("random_goal"))
