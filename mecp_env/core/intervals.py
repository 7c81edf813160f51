"""95 % intervals of means, ratios and shares; nothing is missing without being counted."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Figures = dict[str, Any]

RESAMPLES = 2000
NORMAL_95 = 1.959964


def estimate(values: ArrayLike) -> Figures:
    """Mean of a sample with a bootstrap 95 % interval: {value, low, high, n}; a nan counts as missing."""
    sample = np.asarray(values, float).ravel()
    sample = sample[np.isfinite(sample)]
    return ratio(sample, np.ones(len(sample)))


def ratio(parts: ArrayLike, wholes: ArrayLike) -> Figures:
    """sum(parts) / sum(wholes) with a bootstrap 95 % interval over the runs that each entry stands for."""
    part, whole = np.asarray(parts, float), np.asarray(wholes, float)
    if not whole.sum() > 0.0:
        return {"value": None, "low": None, "high": None, "n": 0}
    draws = np.random.default_rng(0).integers(0, len(part), (RESAMPLES, len(part)))
    sums = whole[draws].sum(axis=1)
    low, high = np.percentile(part[draws].sum(axis=1)[sums > 0] / sums[sums > 0], [2.5, 97.5])
    return {"value": float(part.sum() / whole.sum()), "low": float(low), "high": float(high), "n": len(part)}


def share(successes: Iterable[bool]) -> Figures:
    """Share of successes with its Wilson 95 % interval: {value, low, high, n} (it has a width at 0 and 1 too)."""
    outcomes = [bool(success) for success in successes]
    n = len(outcomes)
    if not n:
        return {"value": None, "low": None, "high": None, "n": 0}
    p, z2 = sum(outcomes) / n, NORMAL_95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = NORMAL_95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return {"value": p, "low": max(0.0, middle - half), "high": min(1.0, middle + half), "n": n}
