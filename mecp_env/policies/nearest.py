"""The nearest goal, by path length."""

from __future__ import annotations

from typing import Any

from mecp_env.policies.policy import PATH, Mask, choices


class Nearest:
    """Drives to the goal with the shortest path: the standard baseline (Yamauchi 1997)."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random, and no state is kept."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the nearest goal, the first of equal ones; 0 when there is none."""
        rows = choices(observation, mask)
        return int(rows[observation["goals"][rows, PATH].argmin()]) if len(rows) else 0
