"""Compiled look-ups in short arrays of integers, where NumPy's own functions cost more than the search."""

from __future__ import annotations

from mecp_env.core.array_types import Ints
from mecp_env.core.jit import compiled


@compiled
def find_rows(ids: Ints, wanted: Ints, rows: Ints) -> bool:
    """Write the row in `ids` (N,), which differ, of each of `wanted` (m,), -1 where missing; True: none is missing."""
    complete = True
    for k in range(wanted.shape[0]):
        in_order = k < ids.shape[0] and ids[k] == wanted[k]  # often, and the search is saved
        rows[k] = k if in_order else row_of(ids, wanted[k])
        complete = complete and rows[k] >= 0
    return complete


@compiled
def row_of(ids: Ints, wanted: int) -> int:
    """The row of `wanted` in `ids` (N,), or -1."""
    for i in range(ids.shape[0]):
        if ids[i] == wanted:
            return i
    return -1
