"""What a return says of the map: lost episodes against the others of the same building, and correct coverage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mecp_env.core.array_types import Array, Bools
from mecp_env.core.intervals import Figures, correlation, estimate, ratio
from mecp_env.policies.comparison import Row


def returns_of(rows: Sequence[Row]) -> Figures:
    """The returns of the lost episodes and of the others, and what returns say of correct coverage.

    `lost`, `others`, `difference` and `ratio` (lost over others) are over the buildings in which some policy was lost
    and another one was not, the mean of each kind in each building; `correlation` is Pearson's, of the return with
    correct coverage at the end, over all episodes. Each is {value, low, high, n}, intervals over buildings.
    """
    returns, correct, lost = (of_all(rows, name) for name in ("reward", "correct_coverage", "lost"))
    mixed = (lost > 0.5).any(axis=0) & (lost < 0.5).any(axis=0)
    of_lost, of_others = (mean_where(which[:, mixed], returns[:, mixed]) for which in (lost > 0.5, lost < 0.5))
    return {
        "lost": estimate(of_lost),
        "others": estimate(of_others),
        "difference": estimate(of_lost - of_others),
        "ratio": ratio(of_lost, of_others),
        "correlation": correlation(returns, correct),
    }


def of_all(rows: Sequence[Row], name: str) -> Array:
    """(p,n) a metric of each row in each building."""
    return np.stack([row.values(name) for row in rows]) if rows else np.zeros((0, 0))


def mean_where(which: Bools, values: Array) -> Array:
    """(n,) the mean of each column over the rows of `which` (p,n) bool, at least one."""
    return np.array(np.where(which, values, 0.0).sum(axis=0) / which.sum(axis=0))
