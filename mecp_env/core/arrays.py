"""Compiled look-ups in short arrays of integers, where NumPy's own functions cost more than the search."""

from __future__ import annotations

import numpy as np

from mecp_env.core.carriers import Ints
from mecp_env.core.jit import compiled


@compiled
def find_rows(ids: Ints, wanted: Ints, rows: Ints) -> bool:
    """Write the row in `ids` (N,), which differ, of each of `wanted` (m,), -1 where missing; True: none is missing."""
    complete, last = True, -1
    for k in range(wanted.shape[0]):
        rows[k] = row_of(ids, wanted[k], last + 1)
        complete, last = complete and rows[k] >= 0, rows[k]
    return complete


@compiled
def row_of(ids: Ints, wanted: int, first: int = 0) -> int:
    """The row of `wanted` in `ids` (N,), which differ, or -1; looked for from the row `first` on, then before it."""
    for i in range(first, ids.shape[0]):
        if ids[i] == wanted:
            return i
    for i in range(min(first, ids.shape[0])):
        if ids[i] == wanted:
            return i
    return -1


@compiled
def rows_by_id(ids: Ints, asked: Ints) -> Ints:
    """The row in `ids` (N,), which differ, of each id from 0 to the largest of `asked`, -1 where missing."""
    largest, wanted = 0, asked.reshape(-1)
    for i in range(wanted.shape[0]):
        largest = max(largest, wanted[i])
    rows = np.full(largest + 1, -1, np.int64)
    for i in range(ids.shape[0]):
        if 0 <= ids[i] <= largest:
            rows[ids[i]] = i
    return rows
