"""What a beam without a return means for a laser: nothing within its range, or a wall that it does not see."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mecp_env.core.array_types import Array

NEAR_SHARE = 0.8  # of the range: gaps between nearer hits are mostly walls, those between farther ones open space
LOST_SHARE = 0.13  # of all beams, in such gaps, and
NARROW_SHARE = 0.01  # as a share of the hits, in gaps narrower than
NARROW_M = 1.0  # this between their two hits: from both on, the laser is weak
SWEEPS = 300  # that are looked at, spread over the log


def no_return_of(ranges: Array, step_rad: float, max_range_m: float) -> Literal["free", "unknown"]:
    """`unknown` for a weak laser, whose beams (n,B) m often do not return (nan) between two near hits."""
    some = ranges[:: max(1, len(ranges) // SWEEPS)]
    gaps = np.array([_gaps(sweep, step_rad, NEAR_SHARE * max_range_m) for sweep in some]).reshape(-1, 3).sum(axis=0)
    lost, narrow, hits = gaps.tolist()
    weak = lost > LOST_SHARE * some.size and narrow > NARROW_SHARE * hits
    return "unknown" if weak else "free"


def _gaps(ranges: Array, step_rad: float, near_m: float) -> tuple[int, int, int]:
    """Beams (B,) without a return between two near hits; those of them in narrow gaps; and hits."""
    hits = np.flatnonzero(np.isfinite(ranges))
    empty = np.diff(hits) - 1
    first, last = ranges[hits[:-1]], ranges[hits[1:]]
    angle = np.minimum((empty + 1) * step_rad, np.pi)
    width = np.sqrt(np.maximum(first**2 + last**2 - 2.0 * first * last * np.cos(angle), 0.0))
    near = np.maximum(first, last) < near_m
    return int(empty[near].sum()), int(empty[near & (width < NARROW_M)].sum()), len(hits)
