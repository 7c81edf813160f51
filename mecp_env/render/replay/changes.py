"""What changed from one frame to the next: a map that stays as it is takes no room in the page."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mecp_env.core.array_types import Array, Bytes

Row = list[int]  # x, y, xx, xy, yy of a landmark
ENOUGH = 0.1  # share by which a covariance must change to be written again


@dataclass(slots=True, eq=False)
class Versions:
    """Things that seldom change, each written once."""

    all: list[Any] = field(default_factory=list)
    numbers: dict[str, int] = field(default_factory=dict)

    def number(self, thing: Any) -> int:
        """The place of `thing` in `all`."""
        name = json.dumps(thing)
        if name not in self.numbers:
            self.numbers[name] = len(self.all)
            self.all.append(thing)
        return self.numbers[name]


def changed_rows(frames: Iterable[dict[int, Row]]) -> Iterator[list[Row]]:
    """For each frame the rows [id, x, y, xx, xy, yy] that are new or changed, and [id] of what is gone."""
    written: dict[int, Row] = {}
    for rows in frames:
        gone = [[name] for name in written if name not in rows]
        news = {name: row for name, row in rows.items() if _differs(written.get(name), row)}
        written = {name: row for name, row in written.items() if name in rows} | news
        yield gone + [[name, *row] for name, row in news.items()]


def _differs(old: Row | None, new: Row) -> bool:
    if old is None or old[:2] != new[:2]:
        return True
    spread = max(old[2] + old[4], 1)
    return max(abs(a - b) for a, b in zip(old[2:], new[2:], strict=True)) > ENOUGH * spread


def changed_cells(grids: Sequence[tuple[Bytes, Array]], cell_m: float) -> tuple[Array, list[int], list[Row]]:
    """The lower left corner (2,) m of all grids together, their width and height in cells, and the changes.

    `grids`: codes (H,W) and the lower left corner (2,) of each frame, the same object while nothing changed. The
    changes of a frame are runs of cells: the first one, counted row by row, how many, their code; and so on.
    """
    low = np.min([place for _, place in grids], axis=0)
    high = np.max([place + cell_m * np.array(codes.shape[::-1]) for codes, place in grids], axis=0)
    width, height = np.round((high - low) / cell_m).astype(int).tolist()
    shown, changes, last = np.zeros((height, width), np.uint8), list[Row](), None
    for grid in grids:
        changes.append([] if grid is last else _runs(shown, _laid(grid, low, cell_m, (height, width))))
        last = grid
    return low, [width, height], changes


def _laid(grid: tuple[Bytes, Array], low: Array, cell_m: float, shape: tuple[int, int]) -> Bytes:
    codes, place = grid
    column, row = np.round((place - low) / cell_m).astype(int).tolist()
    whole = np.zeros(shape, np.uint8)
    whole[row : row + codes.shape[0], column : column + codes.shape[1]] = codes
    return whole


def _runs(shown: Bytes, now: Bytes) -> Row:
    """Runs of the cells that differ, which are then `shown`."""
    differ = np.flatnonzero(shown != now)
    codes = now.ravel()[differ]
    begins = np.flatnonzero((np.diff(differ, prepend=-2) > 1) | (np.diff(codes.astype(int), prepend=-1) != 0))
    lengths = np.diff(np.append(begins, len(differ)))
    shown[:] = now
    return np.column_stack([differ[begins], lengths, codes[begins]]).ravel().tolist()
