"""Kernels that look integers up in short columns, where numpy's own functions cost more than the search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled

Ints = NDArray[np.int64]


@compiled
def find_equal(values: Ints, wanted: int, found: Ints) -> int:
    """Write the places in `values` (n,) where `wanted` stands; returns how many there are."""
    count = 0
    for i in range(values.shape[0]):
        if values[i] == wanted:
            found[count] = i
            count += 1
    return count


@compiled
def find_rows(ids: Ints, wanted: Ints, rows: Ints) -> None:
    """Write the row in `ids` (N,) of each of `wanted` (m,), -1 where it is missing."""
    for k in range(wanted.shape[0]):
        rows[k] = row_of(ids, wanted[k])


@compiled
def row_of(ids: Ints, wanted: int) -> int:
    """The row in `ids` (N,) where `wanted` stands, or -1."""
    for i in range(ids.shape[0]):
        if ids[i] == wanted:
            return i
    return -1
