"""Joint compatibility of many pairings, selected one by one in innovation space.

Each pairing that is accepted conditions all others (a Schur complement), so that after two or three of them the common
error of the pose is gone and what is left must fit as a rigid whole. Several first pairings are tried where the choice
is not clear. This is the greedy relative of JCBB (Neira, Tardos 2001), with the full cross-covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairings that are possible one by one, with their joint innovation."""

    corner: Ints  # (P,) row of the corner
    landmark: Ints  # (P,) row of the landmark
    nu: Array  # (2P,) m, rad
    S: Array  # (2P,2P) joint innovation covariance


@compiled
def _nis_2(nu: Array, S: Array, p: int) -> float:
    """NIS of pairing p alone, from its 2x2 block of S."""
    a, b, c = S[2 * p, 2 * p], S[2 * p, 2 * p + 1], S[2 * p + 1, 2 * p + 1]
    determinant = a * c - b * b
    if determinant <= 0.0:
        return math.inf
    x, y = nu[2 * p], nu[2 * p + 1]
    return float((c * x * x - 2.0 * b * x * y + a * y * y) / determinant)


@compiled
def _condition(nu: Array, S: Array, p: int, alive: Bools) -> None:
    """nu and S of the pairings still alive, given that pairing p is true; in place."""
    a, b, c = S[2 * p, 2 * p], S[2 * p, 2 * p + 1], S[2 * p + 1, 2 * p + 1]
    determinant = a * c - b * b
    first, second = S[2 * p], S[2 * p + 1]
    for u in range(nu.shape[0]):
        if not alive[u >> 1]:
            continue
        s0, s1 = S[u, 2 * p], S[u, 2 * p + 1]
        g0, g1 = (c * s0 - b * s1) / determinant, (a * s1 - b * s0) / determinant
        nu[u] -= g0 * nu[2 * p] + g1 * nu[2 * p + 1]
        for q in range(alive.shape[0]):
            if alive[q]:
                v = 2 * q
                S[u, v] -= g0 * first[v] + g1 * second[v]
                S[u, v + 1] -= g0 * first[v + 1] + g1 * second[v + 1]


@compiled
def _select(p: int, corner: Ints, landmark: Ints, alive: Bools) -> None:
    """Strike out every pairing that shares the corner or the landmark of p."""
    for q in range(alive.shape[0]):
        if corner[q] == corner[p] or landmark[q] == landmark[p]:
            alive[q] = False


@compiled
def _next(nis: Array, corner: Ints, alive: Bools) -> int:
    """The pairing to accept next: of a corner with few choices first, then the smallest NIS; -1 when none is left."""
    best, chosen = math.inf, -1
    for p in range(alive.shape[0]):
        if alive[p]:
            rivals = 0
            for q in range(alive.shape[0]):
                rivals += alive[q] and corner[q] == corner[p]
            key = nis[p] + 9.21 * (rivals - 1)
            if key < best:
                best, chosen = key, p
    return chosen


@compiled
def _rival_gap(p: int, nis: Array, corner: Ints, alive: Bools) -> float:
    """How much worse the second choice of p's corner is."""
    gap = math.inf
    for q in range(alive.shape[0]):
        if alive[q] and q != p and corner[q] == corner[p]:
            gap = min(gap, nis[q] - nis[p])
    return gap


@compiled
def grow(nu: Array, S: Array, corner: Ints, landmark: Ints, seed: Ints, gate: float, gap: float) -> tuple[Array, Bools]:
    """NIS (P,) of each accepted pairing given those before it, nan where not accepted, and (P,) ambiguous ones.

    `seed` (s,) are accepted first, in order, if they pass. A corner whose two best choices differ by less than `gap`
    when its turn comes is ambiguous: neither is accepted.
    """
    count = corner.shape[0]
    nu, S = nu.copy(), S.copy()
    alive, ambiguous = np.ones(count, np.bool_), np.zeros(count, np.bool_)
    accepted, nis = np.full(count, math.nan), np.empty(count)
    turn = 0
    while True:
        for p in range(count):
            if alive[p]:
                nis[p] = _nis_2(nu, S, p)
                alive[p] = nis[p] <= gate
        p = seed[turn] if turn < seed.shape[0] else _next(nis, corner, alive)
        turn += 1
        if p < 0:
            break
        if not alive[p]:
            continue
        if turn > seed.shape[0] and _rival_gap(p, nis, corner, alive) < gap:
            ambiguous[p] = True
            for q in range(count):
                alive[q] = alive[q] and corner[q] != corner[p]
            continue
        accepted[p] = nis[p]
        _select(p, corner, landmark, alive)
        _condition(nu, S, p, alive)
    return accepted, ambiguous


@compiled
def likeliest(costs: Array, corner: Ints, landmark: Ints, most: int) -> Ints:
    """The first pairings to try: -1 for a free choice, then the `most` pairings that cost least; `costs` (n,N)."""
    count = corner.shape[0]
    tried, seeds = np.zeros(count, np.bool_), np.empty(1 + min(most, count), np.int64)
    seeds[0] = -1
    for s in range(1, seeds.shape[0]):
        best, seeds[s] = math.inf, -1
        for p in range(count):
            if not tried[p] and costs[corner[p], landmark[p]] < best:
                best, seeds[s] = costs[corner[p], landmark[p]], p
        tried[seeds[s]] = True
    return seeds


@compiled
def best_growth(
    nu: Array, S: Array, corner: Ints, landmark: Ints, seeds: Ints, gate: float, gap: float
) -> tuple[Array, Bools]:
    """The growth with most pairings, then least total NIS, over the first pairings `seeds` (s,) (-1: free choice)."""
    best_count, best_total = -1, math.inf
    best_accepted, best_ambiguous = np.full(corner.shape[0], math.nan), np.zeros(corner.shape[0], np.bool_)
    for s in range(seeds.shape[0]):
        first = seeds[s : s + 1] if seeds[s] >= 0 else seeds[:0]
        accepted, ambiguous = grow(nu, S, corner, landmark, first, gate, gap)
        count, total = 0, 0.0
        for p in range(accepted.shape[0]):
            if not math.isnan(accepted[p]):
                count += 1
                total += accepted[p]
        if count > best_count or (count == best_count and total < best_total):
            best_count, best_total, best_accepted, best_ambiguous = count, total, accepted, ambiguous
    return best_accepted, best_ambiguous
