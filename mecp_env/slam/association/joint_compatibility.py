"""Greedy joint compatibility: pairings are accepted one by one in innovation space.

Each pairing that is accepted conditions all others (a Schur complement), so that after two or three of them the common
error of the pose is gone and what is left must fit as a rigid whole. This is the greedy relative of JCBB (Neira, Tardos
2001), with the full cross-covariance.

Pairings (P,) have a row of the corner and a landmark; nu (2P,) and S (2P,2P) are their joint innovation.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled


@compiled
def pair_nis(nu: Array, S: Array, p: int) -> float:
    """NIS of pairing p alone, from its 2x2 block of S."""
    a, b, c = S[2 * p, 2 * p], S[2 * p, 2 * p + 1], S[2 * p + 1, 2 * p + 1]
    determinant = a * c - b * b
    if determinant <= 0.0:
        return math.inf
    x, y = nu[2 * p], nu[2 * p + 1]
    return float((c * x * x - 2.0 * b * x * y + a * y * y) / determinant)


@compiled
def condition(nu: Array, S: Array, p: int, alive: Bools) -> None:
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
def next_pairing(nis: Array, corner: Ints, alive: Bools, rival_gap: float) -> tuple[int, float]:
    """The pairing to accept next, and by how much NIS the second choice of its corner is worse; -1: none is left.

    A corner with few choices comes first, then the smallest NIS: every further choice counts as `rival_gap`.
    """
    best, chosen, gap = math.inf, -1, math.inf
    for p in range(alive.shape[0]):
        if alive[p]:
            rivals = 0
            for q in range(alive.shape[0]):
                rivals += alive[q] and corner[q] == corner[p]
            key = nis[p] + rival_gap * (rivals - 1)
            if key < best:
                best, chosen = key, p
    for q in range(alive.shape[0]):
        if alive[q] and q != chosen and corner[q] == corner[chosen]:
            gap = min(gap, nis[q] - nis[chosen])
    return chosen, gap


@compiled
def greedy_joint_compatibility(
    nu: Array, S: Array, corner: Ints, landmark: Ints, first: Ints, gate: float, rival_gap: float
) -> tuple[Array, Bools]:
    """NIS (P,) of each accepted pairing given those before it, nan where not accepted, and (P,) ambiguous ones.

    `first` (s,) are accepted first, in order, if they pass. A corner whose two best choices differ by less than
    `rival_gap` when its turn comes is ambiguous: neither is accepted.
    """
    count = corner.shape[0]
    nu, S = nu.copy(), S.copy()
    alive, ambiguous = np.ones(count, np.bool_), np.zeros(count, np.bool_)
    accepted, nis = np.full(count, math.nan), np.empty(count)
    turn = 0
    while True:
        for p in range(count):
            if alive[p]:
                nis[p] = pair_nis(nu, S, p)
                alive[p] = nis[p] <= gate
        gap = math.inf
        if turn < first.shape[0]:
            p = first[turn]
        else:
            p, gap = next_pairing(nis, corner, alive, rival_gap)
        turn += 1
        if p < 0:
            break
        if not alive[p]:
            continue
        if gap < rival_gap:
            ambiguous[p] = True
            for q in range(count):
                alive[q] = alive[q] and corner[q] != corner[p]
            continue
        accepted[p] = nis[p]
        for q in range(count):
            alive[q] = alive[q] and corner[q] != corner[p] and landmark[q] != landmark[p]
        condition(nu, S, p, alive)
    return accepted, ambiguous
