"""The map at the time when a submap was taken from it, and what its landmarks are in terms of the probes.

The probes stand for the numbers in work, whitened: with P = L L^T their covariance then, probe k has column k of L as
its covariance with them, and a variance of 1. Bare numbers in their place gave the same but for rounding; yet the
inverse of P is large, as landmarks that were seen together move together, and with it the changes to carry over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.arrays import find_rows
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import block_of, factor_lower, forward_rows, product
from mecp_env.slam.messages import Belief
from mecp_env.slam.protocols import FilterError

ROUNDING = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """The whole map as it was when the submap was taken from it; nothing here is written to."""

    slot_ids: Ints  # (N,)
    state: Array  # (4+2N,3+2N) as in `LandmarkFilter`
    at_work: Ints  # (A,) rows of `slot_ids` that are in the submap, in the order of their probes
    factor: Array  # (3+2A,3+2A) L, L L^T is the covariance of the numbers in work then; its columns are the probes'
    belief: Belief
    is_at_rest: Bools  # (M,) landmarks of the belief that are not in the submap
    variance: Array  # (M,) m^2, of the place of each

    def with_more(self, rows: Ints) -> Rest:
        """The same with more landmarks, rows (m,), in the submap."""
        resting, at_work = self.is_at_rest.copy(), np.concatenate((self.at_work, rows))
        shown = rows_of(self.belief.ids, self.slot_ids[rows])
        resting[shown[shown >= 0]] = False  # marks are not in the belief
        numbers, size = numbers_of(rows), len(self.factor)
        factor = np.zeros((size + len(numbers), size + len(numbers)))
        across, block = self.whitened(rows), block_of(self.state[1:], numbers, numbers)
        own = block - product(across, np.ascontiguousarray(across.T))
        own += np.diag(4096.0 * ROUNDING * np.diagonal(block))  # more than rounding; any L is exact
        factor[:size, :size], factor[size:, :size], factor[size:, size:] = self.factor, across, factored(own)
        return replace(self, at_work=at_work, factor=factor, is_at_rest=resting)

    def whitened(self, rows: Ints) -> Array:
        """V (2m,3+2a), V L^T is the covariance of the landmarks of some rows (m,) with the numbers in work."""
        work = np.concatenate((np.arange(3), numbers_of(self.at_work)))
        cross = block_of(self.state[1:], work, numbers_of(rows))
        forward_rows(self.factor, cross)
        return cross.T

    def coordinates(self, rows: Ints) -> Array:
        """(2m,2(1+3+2a)) the landmarks of some rows (m,) in terms of the probes."""
        known = np.concatenate((self.state[0, numbers_of(rows), None], self.whitened(rows)), axis=1)
        found = np.empty((2 * len(rows), 2 * known.shape[1]))
        found[0::2, 0::2], found[0::2, 1::2] = known[0::2], -known[1::2]
        found[1::2, 0::2], found[1::2, 1::2] = known[1::2], known[0::2]
        return found

    def landmarks_with(self, own: Belief) -> tuple[Ints, Array, Array]:
        """Ids, places and covariances of all landmarks: those of the submap as in its `own` belief, new ones last."""
        shown = self.belief
        return overlaid(shown.ids, shown.p_map, shown.covs, self.is_at_rest, own.ids, own.p_map, own.covs)

    def near(self, p_map: Array, variance: Array) -> Ints:
        """Ids of landmarks at rest that may be inside a gate for a measurement at p_map (k,2), variance (k,)."""
        ids: Ints = self.belief.ids[near_any(self.belief.p_map, self.variance, self.is_at_rest, p_map, variance)]
        return ids


@compiled
def near_any(p_map: Array, variance: Array, asked: Bools, seen: Array, seen_variance: Array) -> Bools:
    """(M,) which of the landmarks p_map (M,2) that are `asked` for may be inside the gate of one of `seen` (k,2)."""
    near = np.empty(asked.shape[0], np.bool_)
    for i in range(near.shape[0]):
        x, y, found = p_map[i, 0], p_map[i, 1], False
        for k in range(seen.shape[0] if asked[i] else 0):
            square = (seen[k, 0] - x) ** 2 + (seen[k, 1] - y) ** 2
            bound = 2.0 * (seen_variance[k] + variance[i])  # of the innovation, in any direction, whatever joins them
            found |= square < 25.0 * bound  # else the NIS is above every gate
        near[i] = found
    return near


@compiled
def overlaid(
    ids: Ints, p_map: Array, covs: Array, at_rest: Bools, own_ids: Ints, own_p_map: Array, own_covs: Array
) -> tuple[Ints, Array, Array]:
    """Ids, places and covariances of landmarks (N,): those `at_rest`, and those of `own_ids` (m,) as they are there.

    Landmarks that are neither are left out; own ones that are not among the N come last.
    """
    most, n = ids.shape[0] + own_ids.shape[0], 0
    rows, own_row = np.empty(own_ids.shape[0], np.int64), np.full(most, -1)
    find_rows(ids, own_ids, rows)
    for k in range(rows.shape[0]):  # of the whole: first the known landmarks, then the new ones
        own_row[rows[k] if rows[k] >= 0 else ids.shape[0] + k] = k
    all_ids, places, spreads = np.empty(most, np.int64), np.empty((most, 2)), np.empty((most, 2, 2))
    for i in range(most):
        k = own_row[i]
        if k < 0 and (i >= ids.shape[0] or not at_rest[i]):
            continue
        row = i if k < 0 else k
        place, spread = (p_map, covs) if k < 0 else (own_p_map, own_covs)
        all_ids[n] = ids[i] if k < 0 else own_ids[k]
        for u in range(2):
            places[n, u], spreads[n, u, 0], spreads[n, u, 1] = place[row, u], spread[row, u, 0], spread[row, u, 1]
        n += 1
    return all_ids[:n], places[:n], spreads[:n]


def factored(cov: Array) -> Array:
    """Lower triangular L (n,n) of a covariance L L^T; raises `FilterError` when it is not positive."""
    L = cov.copy()
    if not factor_lower(L):
        raise FilterError("submap: covariance is not positive")
    lower: Array = np.tril(L)
    return lower


def rows_of(of: Ints, ids: Ints) -> Ints:
    """(m,) where each of the `ids` (m,) is in `of` (n,), or -1."""
    rows = np.empty(len(ids), np.int64)
    find_rows(of, ids, rows)
    return rows


def numbers_of(slots: Ints) -> Ints:
    """(2m,) the numbers of a state that belong to slots (m,)."""
    numbers: Ints = np.repeat(3 + 2 * slots, 2)
    numbers[1::2] += 1
    return numbers
