"""When the estimate of an episode or drive counts as lost: one definition for every table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mecp_env.core.array_types import Array

LOST_M = 1.0
LOST_DEG = 10.0
LOST_STEPS = 20


def is_off(error_m: Any, error_rad: Any) -> Any:
    """True when the pose is more than 1 m or 10 degrees off, in one step or in each of many (n,)."""
    return (error_m > LOST_M) | (abs(error_rad) > math.radians(LOST_DEG))


def is_lost(error_m: Array, error_rad: Array, diverged: bool) -> bool:
    """True when the pose is more than 1 m or 10 degrees off for 20 steps in a row or at the end, or has diverged.

    The errors (n,) are those of position and heading after each control step.
    """
    off = is_off(error_m, error_rad)
    if diverged or off[-1:].any():
        return True
    runs = np.lib.stride_tricks.sliding_window_view(off, LOST_STEPS) if len(off) >= LOST_STEPS else off[:0, None]
    return bool(runs.all(axis=1).any())


@dataclass(slots=True, eq=False)
class LostWatch:
    """`is_lost` of an episode that is still going on; plain state."""

    off_steps: int = 0  # in a row, up to now
    longest: int = 0  # of all such rows

    def look(self, error_m: float, error_rad: float) -> None:
        """Count one step."""
        self.off_steps = self.off_steps + 1 if is_off(error_m, error_rad) else 0
        self.longest = max(self.longest, self.off_steps)

    def is_lost(self, diverged: bool) -> bool:
        """True when the episode counts as lost if it ends now."""
        return diverged or self.off_steps > 0 or self.longest >= LOST_STEPS
