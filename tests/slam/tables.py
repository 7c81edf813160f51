"""Feature tables with given columns."""

from __future__ import annotations

from typing import Any

import numpy as np

from mecp_env.slam.messages import FEATURE, FeatureTable


def table_of(n: int, **columns: Any) -> FeatureTable:
    """`n` features; what is not given is 0."""
    table = FeatureTable(np.zeros(n, FEATURE))
    for name, values in columns.items():
        table.rows[name] = values
    return table
