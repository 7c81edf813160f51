"""The nearest goal, by the length of the way there. `python -m mecp_env.policies.nearest --layout medium:test:3`."""

from __future__ import annotations

import sys
from typing import Any

from mecp_env.policies.one_episode import main
from mecp_env.policies.policy import PATH, Mask, choices


class Nearest:
    """Drives to the goal with the shortest way: what most robots do, and hard to beat (Yamauchi 1997)."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; nothing here is random and nothing is kept."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the nearest goal, of equal ones the first; 0 when there is none."""
        rows = choices(observation, mask)
        return int(rows[observation["goals"][rows, PATH].argmin()]) if len(rows) else 0


if __name__ == "__main__":
    sys.exit(main("nearest"))
