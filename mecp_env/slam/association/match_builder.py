"""A match while it is made: every corner starts as new, an associator pairs corners and classifies the others."""

from __future__ import annotations

from functools import lru_cache
from typing import Self

import numpy as np

from mecp_env.core.carriers import Array, Ints, Rows, row_type
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import NO_ID, Decision, Match, Reason

ROW = row_type([("id", np.int64), ("decision", np.int64), ("reason", np.int64), ("nis", np.float64)])
INITIAL = np.repeat(np.array([(NO_ID, Decision.NEW, Reason.UNSEEN, np.nan)], ROW), 256)
INITIAL_BYTES = INITIAL.view(np.uint8)  # copied, faster than filled, and faster than as rows


class MatchBuilder:
    """The rows (n,) of a match: id, `Decision`, `Reason` and NIS of each corner; at first every corner is new."""

    def __init__(self, n: int) -> None:
        few = n <= len(INITIAL)
        self.rows: Rows = INITIAL_BYTES[: n * ROW.itemsize].copy().view(ROW) if few else np.repeat(INITIAL[:1], n)
        self.polygon = -1  # index of the matched polygon of the scan
        self.map_polygon = -1  # index of the map polygon matched

    def assign(
        self,
        corners: Ints | slice | int,
        decision: Decision,
        reason: Reason,
        ids: Ints | int = NO_ID,
        nis: Array | float = np.nan,
    ) -> None:
        """Decide for some corners (c,), or one; ids and NIS are (c,) or one value."""
        for name, values in (("id", ids), ("decision", decision), ("reason", reason), ("nis", nis)):
            self.rows[name][corners] = values

    @property
    def paired(self) -> int:
        """How many corners are paired."""
        return int(np.count_nonzero(self.rows["id"] != NO_ID))

    def classify_unmatched(self, nis: Array, ignore_gate: float) -> Self:
        """Decide which of the corners that are not paired may be new; the others are ignored.

        `nis` (n,N) is that of every corner against every landmark of the same descriptor. A corner neither clearly old
        nor clearly new is ignored.
        """
        classify_unmatched(self.rows, nis, ignore_gate)
        return self

    def match(self) -> Match:
        """The match, as it is now."""
        rows = self.rows
        columns = rows["id"].copy(), rows["decision"].copy(), rows["reason"].copy(), rows["nis"].copy()
        return Match(*columns, self.polygon, self.map_polygon)


@lru_cache(64)
def ignored(n: int, reason: Reason = Reason.AMBIGUOUS) -> Match:
    """The match in which each of n corners is ignored: nothing is known about them."""
    builder = MatchBuilder(n)
    builder.assign(slice(None), Decision.IGNORED, reason)
    return builder.match()


@compiled
def classify_unmatched(rows: Rows, nis: Array, ignore_gate: float) -> None:
    """The decision of each corner that is still new; in place. Shapes as in `MatchBuilder`."""
    for i in range(rows.shape[0]):
        if rows[i].decision != Decision.NEW:
            continue
        near = False
        for j in range(nis.shape[1]):
            near |= nis[i, j] <= ignore_gate
        if near:
            rows[i].decision, rows[i].reason = Decision.IGNORED, Reason.AMBIGUOUS
