"""How long the rows of goals take: waiting has a time too, so that the shortest row is not always to wait."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.planning.config import PlanningConfig
from mecp_env.planning.goal_list import PLACE, WAIT, Goals


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Seconds that a drive to a goal takes at least: its path at full speed; of waiting, all its steps."""

    speed_m_s: float = 0.75
    wait_s: float = 0.0

    @classmethod
    def of(cls, config: PlanningConfig) -> RowTimes:
        """Those of a configuration."""
        return cls(config.control.speed_m_s, config.known_ground.wait_steps * config.control.period_s)

    def seconds(self, goals: Goals) -> Array:
        """(g,) s of each goal."""
        seconds: Array = np.where(goals.kind == WAIT, self.wait_s, goals.path_m / self.speed_m_s)
        return seconds

    def nearest_first(self, goals: Goals) -> Goals:
        """The goals in the order of their times."""
        return goals.in_order(np.argsort(self.seconds(goals), kind="stable"))

    def best(self, goals: Goals, most: int) -> int | None:
        """The row, of the first `most`, that takes the least time of those that explore; None without a goal.

        Without one that explores: of open floor and places on known ground; waiting is the last resort.
        """
        kind = goals.kind[:most]
        if not len(kind):
            return None
        return int(np.lexsort((self.seconds(goals)[:most], kind >= PLACE, kind == WAIT))[0])
