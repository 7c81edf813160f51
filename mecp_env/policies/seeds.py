"""Trainings that differ in their seed only, taken together: their mean, and what they differ by from other policies."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from mecp_env.core.intervals import Figures, over_runs
from mecp_env.policies.comparison import COMPARED, Row

NUMBERED = re.compile(r"(.+)-\d+")
Runs = dict[str, list[Row]]


def seeds_of(rows: Sequence[Row]) -> list[Figures]:
    """A part for each group of runs `NAME-0`, `NAME-1`, ...: `policy` (`NAME-*`), `seeds`, `figures`, `differences`.

    `differences`, by the name of another group or policy, are means of the runs minus that, in the same buildings, with
    intervals over runs and buildings. Only rows of one estimator, which the caller selects, can be compared.
    """
    together = by_name(rows)
    groups = {name: runs for name, runs in together.items() if len(runs) > 1}
    return [
        {
            "policy": name,
            "estimator": runs[0].estimator,
            "seeds": len(runs),
            "figures": differences(runs, []),
            "differences": {other: differences(runs, row) for other, row in together.items() if other != name},
        }
        for name, runs in groups.items()
    ]


def by_name(rows: Sequence[Row]) -> Runs:
    """The rows under `NAME-*` where two or more are called `NAME-NUMBER`, the others under their own names."""
    found: Runs = {}
    for row in rows:
        numbered = NUMBERED.fullmatch(row.policy)
        found.setdefault(f"{numbered[1]}-*" if numbered else row.policy, []).append(row)
    return {name if len(runs) > 1 else runs[0].policy: runs for name, runs in found.items()}


def differences(runs: Sequence[Row], others: Sequence[Row]) -> Figures:
    """The compared metrics: mean of the runs, minus that of the others where there are any."""
    return {
        name: over_runs(
            np.stack([row.values(name) for row in runs]),
            np.stack([row.values(name) for row in others]) if others else None,
        )
        for name in COMPARED
    }
