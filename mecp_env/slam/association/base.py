"""What all associators share: gates, the corner signature, one-to-one pairing (III-B)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from mecp_env.core.jit import compiled
from mecp_env.slam.messages import NO_ID, Decision, Match, Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NEW, IGNORED = int(Decision.NEW), int(Decision.IGNORED)
UNSEEN, AMBIGUOUS = int(Reason.UNSEEN), int(Reason.AMBIGUOUS)


@lru_cache
def chi2_gate(dof: int, probability: float) -> float:
    """The value that a chi-square variable of `dof` degrees of freedom stays under with `probability`."""
    return float(chdtri(dof, 1.0 - probability))


@compiled
def one_to_one(cost: Array, gate: float) -> Ints:
    """(n,) column paired with each row, or -1: smallest cost (n,N) first, each column once, none above `gate`."""
    n, m = cost.shape
    paired = np.full(n, -1)
    taken = np.zeros(m, np.bool_)
    for _ in range(min(n, m)):
        best, row, column = gate, -1, -1
        for pair in range(n * m):
            i, j = pair // m, pair % m
            if paired[i] < 0 and not taken[j] and cost[i, j] < best:
                best, row, column = cost[i, j], i, j
        if row < 0:
            break
        paired[row] = column
        taken[column] = True
    return paired


def undecided(n: int) -> Match:
    """A match in which each of n corners is still NEW and nothing was recognised; to be filled in by its maker."""
    return _match(n, NEW, UNSEEN)


def ignored(n: int) -> Match:
    """A match in which each of n corners is ignored: nothing can be said of them."""
    return _match(n, IGNORED, AMBIGUOUS)


def _match(n: int, decision: int, reason: int) -> Match:
    columns = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n)
    _fill(*columns, decision, reason)
    return Match(*columns, -1, -1, False)


@compiled
def _fill(ids: Ints, decision: Ints, reason: Ints, nis: Array, one_decision: int, one_reason: int) -> None:
    for i in range(ids.shape[0]):
        ids[i], decision[i], reason[i], nis[i] = NO_ID, one_decision, one_reason, math.nan
