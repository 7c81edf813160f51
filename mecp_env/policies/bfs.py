"""The paper's explorer: breadth first through rooms and doors, over the goals of the observation."""

from __future__ import annotations

from mecp_env.planning.breadth_first import BreadthFirst


class BreadthFirstPolicy(BreadthFirst):
    """`BreadthFirst` as a policy: it selects goals, planner and controller of the environment drive there."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""
