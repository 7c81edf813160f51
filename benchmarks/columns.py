"""Figures of several runs as columns, and means and ratios of them with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.intervals import Figures, estimate, ratio


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
    """(n,) the values of each figure of n runs."""
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def means(columns: Mapping[str, Array], *names: str) -> Figures:
    """Means of some columns, each with its 95 % interval."""
    return {name: estimate(columns[name]) for name in names}


def ratios(columns: Mapping[str, Array], **pairs: str) -> Figures:
    """Ratios of sums of two columns with their 95 % intervals; each is given as `part/whole`."""
    return {name: ratio(*(columns[column] for column in pair.split("/"))) for name, pair in pairs.items()}


def precision_and_recall(columns: Mapping[str, Array]) -> Figures:
    """Both of the pairs that are right, wrong and missed, `tp`, `fp` and `fn`, with their 95 % intervals."""
    tp = columns["tp"]
    return {"precision": ratio(tp, tp + columns["fp"]), "recall": ratio(tp, tp + columns["fn"])}
