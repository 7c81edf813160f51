"""When the estimate of an episode or drive counts as lost: one definition for every table."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array

LOST_M = 1.0
LOST_DEG = 10.0
LOST_STEPS = 20


def is_lost(error_m: Array, error_rad: Array, diverged: bool) -> bool:
    """True when the pose is more than 1 m or 10 degrees off for 20 steps in a row or at the end, or has diverged.

    The errors (n,) are those of position and heading after each control step.
    """
    off = (error_m > LOST_M) | (np.abs(error_rad) > math.radians(LOST_DEG))
    if diverged or off[-1:].any():
        return True
    runs = np.lib.stride_tricks.sliding_window_view(off, LOST_STEPS) if len(off) >= LOST_STEPS else off[:0, None]
    return bool(runs.all(axis=1).any())
