"""Pockets: unknown cells inside a completed room, found by their runs along the rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Bools, Bytes, Ints
from mecp_env.core.jit import compiled
from mecp_env.slam.grid.cells import DOOR_CELL, UNKNOWN_CELL

UNKNOWN_ROOM = -1  # as in mecp_env.slam.messages
SEVERAL = -2  # more than one room, or a door


def find_pockets(label: Bytes, room: NDArray[np.int16], complete: Bools) -> Bools:
    """(H,W) the unknown cells that only the walls and the floor of one completed room surround.

    Such a component of unknown cells (4 neighbours) does not reach the border of the grid, touches no door and touches
    cells of one room only, and that room is complete (`complete` (r,) by room id).
    """
    runs, _, part = runs_of(label == UNKNOWN_CELL)
    pockets: Bools = paint_runs(runs, are_pockets(runs, part, label, room, complete)[part], label.shape)
    return pockets


def apart_from(pockets: Bools, stood: Ints) -> Bools:
    """The pockets (H,W) without those of which a cell is one of `stood` (n,2), column and row, or beside one."""
    runs, begin, part = runs_of(pockets)
    near = (stood[:, None, None, :] + np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1)).reshape(-1, 2)
    inside = near[((near >= 0) & (near < pockets.shape[::-1])).all(axis=1)]
    columns, rows = inside[pockets[inside[:, 1], inside[:, 0]]].T
    dropped = np.zeros(len(part), np.bool_)
    for column, row in zip(columns.tolist(), rows.tolist(), strict=True):
        own = slice(begin[row], begin[row + 1])
        dropped[part[own][np.searchsorted(runs[own, 1], column, "right") - 1]] = True
    kept: Bools = paint_runs(runs, ~dropped[part], pockets.shape)
    return kept


@compiled
def runs_of(mask: Bools) -> tuple[Ints, Ints, Ints]:
    """The runs (n,3) of set cells along the rows of a mask (H,W): row, first column and the one behind the last.

    Then the first run of each row (H+1,), and of each run (n,) the first one of its component (4 neighbours).
    """
    height, width = mask.shape
    most = height * ((width + 1) // 2)
    runs, begin, part, n = np.empty((most, 3), np.int64), np.empty(height + 1, np.int64), np.empty(most, np.int64), 0
    for row in range(height):
        begin[row], cells, before = n, mask[row], False
        for column in range(width):
            if cells[column] and not before:
                runs[n, 0], runs[n, 1], part[n] = row, column, n
            if before and not cells[column]:
                runs[n, 2] = column
                n += 1
            before = cells[column]
        if before:
            runs[n, 2] = width
            n += 1
    begin[height], above = n, 0
    for i in range(n):
        row = runs[i, 0]
        above = max(above, begin[row - 1] if row > 0 else 0)
        while above < begin[row] and runs[above, 2] <= runs[i, 1]:
            above += 1
        k = above
        while k < begin[row] and runs[k, 1] < runs[i, 2]:
            a, b = first_of(part, i), first_of(part, k)
            part[max(a, b)] = min(a, b)
            k += 1
    for i in range(n):
        part[i] = first_of(part, i)
    return runs[:n].copy(), begin, part[:n].copy()


@compiled
def first_of(part: Ints, i: int) -> int:
    """The first run of the component of run i, so far."""
    while part[i] != i:
        part[i] = part[part[i]]
        i = part[i]
    return i


@compiled
def are_pockets(runs: Ints, part: Ints, label: Bytes, room: NDArray[np.int16], complete: Bools) -> Bools:
    """(n,) for the first run of each component of unknown cells whether it is a pocket; see `find_pockets`."""
    (height, width), pocket = label.shape, np.ones(runs.shape[0], np.bool_)
    owner = np.full(runs.shape[0], UNKNOWN_ROOM, np.int64)  # the room beside each component
    for i in range(runs.shape[0]):
        row, first, end = runs[i, 0], runs[i, 1], runs[i, 2]
        pocket[part[i]] &= 0 < row < height - 1 and first > 0 and end < width
    for i in range(runs.shape[0]):
        row, first, end, own = runs[i, 0], runs[i, 1], runs[i, 2], part[i]
        for k in range(2 * (end - first) + 2 if pocket[own] else 0):
            r = row if k < 2 else (row - 1 if k % 2 == 0 else row + 1)
            c = (first - 1 if k == 0 else end) if k < 2 else first + (k - 2) // 2
            other = SEVERAL if label[r, c] == DOOR_CELL else int(room[r, c])
            if label[r, c] != UNKNOWN_CELL and other != UNKNOWN_ROOM:
                owner[own] = other if owner[own] in (UNKNOWN_ROOM, other) else SEVERAL
    for i in range(runs.shape[0]):
        pocket[i] &= 0 <= owner[i] < complete.shape[0] and complete[owner[i]]
    return pocket


@compiled
def paint_runs(runs: Ints, chosen: Bools, shape: tuple[int, int]) -> Bools:
    """(H,W) the cells of the chosen (n,) runs."""
    mask = np.zeros(shape, np.bool_)
    for i in range(runs.shape[0]):
        if chosen[i]:
            mask[runs[i, 0], runs[i, 1] : runs[i, 2]] = True
    return mask
