"""95 % intervals of means, ratios and shares; nothing is missing without being counted.

And the metres over which a curve of coverage is normalised.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


def over_runs(runs: ArrayLike, others: ArrayLike | None = None) -> Figures:
    """Mean of r runs in n cases (r,n), minus that of others (k,n) in the same cases: {value, low, high, n}.

    A draw of the bootstrap takes runs, others and cases with replacement, so that the 95 % interval is about another
    training, too. A case with a nan counts as missing.
    """
    ours = np.atleast_2d(np.asarray(runs, float))
    theirs = np.zeros((1, ours.shape[1])) if others is None else np.atleast_2d(np.asarray(others, float))
    known = np.isfinite(ours).all(axis=0) & np.isfinite(theirs).all(axis=0)
    n, rng = int(known.sum()), np.random.default_rng(0)
    if not n:
        return {"value": None, "low": None, "high": None, "n": 0}
    cases, drawn = rng.integers(0, n, (RESAMPLES, n)), np.zeros((RESAMPLES, n))
    for sign, sample in ((1.0, ours[:, known]), (-1.0, theirs[:, known])):
        picked = rng.integers(0, len(sample), (RESAMPLES, len(sample)))
        drawn += sign * np.take_along_axis(sample[picked].mean(axis=1), cases, axis=1)
    low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
    value = float(ours[:, known].mean() - theirs[:, known].mean())
    return {"value": value, "low": float(low), "high": float(high), "n": n}


def correlation(first: ArrayLike, second: ArrayLike) -> Figures:
    """Pearson's correlation of two measures (p,n) of n runs, with a bootstrap 95 % interval over the runs.

    A draw takes all p values of a run. Without a spread in both measures: no value.
    """
    x, y = (np.atleast_2d(np.asarray(values, float)) for values in (first, second))
    n = x.shape[1]
    if n < 2 or not (np.ptp(x) > 0.0 and np.ptp(y) > 0.0):
        return {"value": None, "low": None, "high": None, "n": 0}
    draws = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    with np.errstate(invalid="ignore"):  # a draw of one run only, n times
        low, high = np.nanpercentile([pearson(x[:, draw], y[:, draw]) for draw in draws], [2.5, 97.5])
    return {"value": pearson(x, y), "low": float(low), "high": float(high), "n": x.size}


def pearson(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """The correlation of two samples of any equal shape; nan without a spread."""
    x, y = x - x.mean(), y - y.mean()
    return float((x * y).sum() / np.sqrt((x * x).sum() * (y * y).sum()))


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


BUDGET_M_PER_M2 = 0.5  # metres of an exploration per m2 of floor


def budget_m(free_area_m2: float) -> float:
    """The metres by which a curve is normalised: a function of the building alone, the same for every policy."""
    return BUDGET_M_PER_M2 * free_area_m2
