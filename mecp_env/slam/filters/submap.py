"""Local submaps (III): among some landmarks the filter works on these alone, and carries the rest over later, exactly.

Whatever the invariant filter does to the pose and some landmarks, it does alike to every landmark that it does not
measure. With places and covariances as complex numbers, x + iy, each of those is a vector: its place, and its
covariances with the numbers in work. A step multiplies all these vectors by one matrix, and changes the covariance of
two landmarks by a form of both vectors. So a few probes, of which every vector is a sum (`resting`), are carried along
like landmarks in place of all landmarks at rest, and tell later what has become of each: but for rounding, what `riekf`
has. Only what was measured changes a probe, which is less than there are probes: the change that is carried over to all
landmarks has a low rank.

The idea to compress the filter is that of Guivant and Nebot, "Optimization of the simultaneous localization and
map-building algorithm for real-time implementation", 2001.

The probes stand for the numbers in work, whitened: with P = L L^T their covariance then, probe k has column k of L as
its covariance with them, and a variance of 1. Bare numbers in their place gave the same but for rounding; yet the
inverse of P is large, as landmarks that were seen together move together, and with it the changes to carry over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import (
    block_of,
    changed_part,
    factor_lower,
    forward_rows,
    low_rank,
    own_blocks,
    product,
    product_of,
)
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters.core import RightInvariantEkf
from mecp_env.slam.filters.update import FIRST_PROBE
from mecp_env.slam.filters.window import Window, belief_of, integers, slots_of
from mecp_env.slam.messages import NO_ID, NO_IDS, Belief, find_rows
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


class Expanded(NamedTuple):
    """Landmarks that were at rest, as they are now: two numbers each, written for those of `pairs` alone."""

    mean: Array  # (2m,) m
    cross: Array  # (2m,o) covariance with some numbers in work
    change: tuple[Array, Array]  # two A, B (2m,k), A B^T is the change of the covariance among themselves
    pairs: Ints  # (n,) the first number of each landmark that is written

    def write_among(self, whole: Array, numbers: Ints, cov: Array, first: int) -> None:
        """Write the covariance among themselves to `cov`, from row and column `first` on; what lies before is spoilt.

        `numbers` (2m,) are where they are in that of the whole map when the submap was taken.
        """
        A, B = self.change
        changed_part(whole, numbers, A, np.ascontiguousarray(B.T), cov, first, self.pairs)


class SubmapEkf(RightInvariantEkf):
    """The right-invariant EKF at a cost per step that hardly grows with the map.

    A submap begins with the landmarks nearby that were measured lately; others join it when they are measured, and with
    more than `config.submap` of them the next one is taken. The state is that of the submap, behind whose landmarks
    probes have slots. The belief shows landmarks at rest as they were when the submap was taken; what is asked of them
    otherwise is exact at any time. A map of up to six times as many landmarks is not divided, as that would save
    nothing: there the result is that of `riekf` to the bit.
    """

    def __init__(self, config: FilterConfig) -> None:
        super().__init__(config)
        self.divided: tuple[Rest, ...] = ()  # one, or none while the map is whole
        self.most = config.submap
        self.updates = 0
        self.measured: dict[int, int] = {}  # id -> number of the last update that it was part of

    @property
    def rest(self) -> Rest | None:
        """The map at the time when the submap was taken; None while it is whole."""
        return self.divided[0] if self.divided else None

    @property
    def ids(self) -> Ints:
        own = self._all_ids()
        return own[own > NO_ID]

    @property
    def held(self) -> int:
        return len(self._all_ids())

    def has(self, landmark: int) -> bool:
        return bool((self._all_ids() == landmark).any())

    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        if self.divided or self.count > 6 * self.most:
            self._bring_to_work(integers(ids))
        super().update(z, R, ids, iterate)

    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        super().augment(z, R, ids)
        if self.rest is not None and len(self._at_work()) > self.most:
            self.synchronise()

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        ids = integers(ids)
        if self.rest is None or not len(z):
            return super().individual_nis(z, R, ids)
        nis, pose = np.full((len(z), len(ids)), math.inf), belief_of(Window(self.state, NO_IDS, self.invariant))
        variance = np.trace(pose.pose_cov[:2, :2]) + R[:, 0, 0] + z[:, 0] ** 2 * (pose.pose_cov[2, 2] + R[:, 1, 1])
        near = self.rest.near(to_map(pose.T_map_robot, polar_to_points(z)), variance)
        if len(self._at_work()) + len(near) <= self.most:
            self._wake(near)  # the next scans ask for them again
            near = near[:0]
        for some in (self._at_work(), near):
            columns = rows_of(ids, some)
            columns = columns[columns >= 0]
            if len(columns):
                nis[:, columns] = super().individual_nis(z, R, ids[columns])
        return nis

    def fuse(self, keep: int, drop: int) -> None:
        self._wake(np.unique([keep, drop]))
        super().fuse(keep, drop)

    def remove(self, ids: Ints) -> None:
        if self.divided:
            self._wake(np.unique(integers(ids)))
        super().remove(ids)

    def belief(self) -> Belief:
        own = super().belief()
        if self.rest is None:
            return own
        return Belief(own.T_map_robot, own.pose_cov, *self.rest.landmarks_with(own))

    def copy(self) -> Self:
        other = super().copy()
        other.measured = self.measured.copy()
        return other

    def synchronise(self) -> None:
        """Carry over what happened in the submap to all landmarks."""
        if self.rest is None:
            return
        work, own, ids = self._at_work(), self._numbers_at_work(), self._all_ids()
        rows = rows_of(self.rest.slot_ids, ids)
        rows = rows[rows >= 0]  # those that joined since the submap was taken are the last ones of `ids`
        known, size = 3 + 2 * len(rows), 3 + 2 * len(ids)
        state = np.empty((1 + size, size))
        numbers, cov = np.concatenate((np.arange(3), numbers_of(rows_of(ids, work)))), state[1:]
        expanded = self._expanded(rows, own, 2 * np.flatnonzero(rows_of(work, ids[: len(rows)]) < 0))
        expanded.write_among(self._whole_cov, numbers_of(rows), cov, 3)  # of those in work nothing that is right
        state[0, 3:known], cov[3:known, numbers], cov[numbers, 3:known] = (
            expanded.mean,
            expanded.cross,
            expanded.cross.T,
        )
        state[0, numbers], cov[np.ix_(numbers, numbers)] = self.mean[own], block_of(self.cov, own, own)
        self.state, self.slot_ids, self.divided = state, ids, ()

    def window(self, ids: Ints, apart: bool = False) -> Window:
        if not self.divided or self._is_at_work(integers(ids)):
            return super().window(ids)
        ids = integers(ids)
        slots = rows_of(self.slot_ids, ids)
        own = np.concatenate((np.arange(3), numbers_of(slots[slots >= 0])))
        rows = self._rows_of_rest(ids[slots < 0])
        state = self._joined(own, rows, apart)
        return Window(state, np.concatenate((ids[slots >= 0], ids[slots < 0])), self.invariant)

    def _bring_to_work(self, ids: Ints) -> None:
        """Make sure that landmarks are in the submap, which is a new one where there is none or it grew too large."""
        wanted = ids[rows_of(self.slot_ids, ids) < 0]
        if self.rest is not None and len(self._at_work()) + len(wanted) > self.most:
            self.synchronise()
        if self.rest is None:
            self._take_submap(ids)
        self._wake(ids)
        self.updates += 1
        self.measured.update(dict.fromkeys(ids.tolist(), self.updates))

    def _take_submap(self, ids: Ints) -> None:
        """Work on the landmarks `ids` (m,), on the marks, and on the nearest ones that were measured lately."""
        self._refuse_unknown(ids)
        size, mean = self.size, self.mean
        self.measured = {i: last for i, last in self.measured.items() if last > self.updates - self.most}
        nearest = np.argsort(np.hypot(mean[3:size:2] - mean[1], mean[4:size:2] - mean[2]), kind="stable")
        lately = nearest[np.isin(self.slot_ids[nearest], list(self.measured))][: self.most // 4]
        rows = np.union1d(lately, np.flatnonzero(np.isin(self.slot_ids, ids) | (self.slot_ids < NO_ID)))
        shown, whole, numbers = super().belief(), self.state[: 1 + size, :size], np.arange(3)
        variance, resting = shown.covs.trace(axis1=1, axis2=2), np.ones(len(shown.ids), np.bool_)
        rest = Rest(self.slot_ids, whole, np.empty(0, np.int64), factored(whole[1:4, :3]), shown, resting, variance)
        self.divided = (rest,)
        self.state, self.slot_ids = np.zeros((12, 11)), FIRST_PROBE - np.arange(4)
        self.mean[:3], self.mean[3] = whole[0, :3], 1.0
        self.cov[:3, :3] = whole[1:4, :3]
        self._begin_probes(numbers, 5 + 2 * numbers, rest.factor)
        self._wake(rest.slot_ids[rows])

    def _wake(self, ids: Ints) -> None:
        """Take landmarks (m,) that are at rest into the submap, each with a probe per coordinate."""
        if self._is_at_work(ids):
            return
        assert self.rest is not None
        ids = ids[rows_of(self.slot_ids, ids) < 0]
        size, count, rows = self.size, 2 * len(ids), self._rows_of_rest(ids)
        before, expanded = self.state, self._expanded(rows, np.arange(size), np.arange(0, count, 2))
        whole, rest = self._whole_cov, self.rest.with_more(rows)
        self.divided = (rest,)
        woken = np.arange(size, size + count)
        probes, last = size + count + 2 * np.arange(count), size + 3 * count
        self.state = np.zeros((1 + last, last))
        self.state[: 1 + size, :size], self.mean[woken] = before[: 1 + size, :size], expanded.mean
        expanded.write_among(whole, numbers_of(rows), self.cov, size)
        self.cov[size : size + count, :size], self.cov[:size, size : size + count] = expanded.cross, expanded.cross.T
        self._begin_probes(woken, probes, rest.factor[-count:, -count:])
        new = FIRST_PROBE - (self.slot_ids <= FIRST_PROBE).sum() - np.arange(count)
        self.slot_ids = np.concatenate((self.slot_ids, ids, new))

    def _begin_probes(self, numbers: Ints, probes: Ints, factor: Array) -> None:
        """Give the probes (m,) their first covariance with the numbers (m,) in work, and among themselves."""
        self.cov[np.ix_(numbers, probes)], self.cov[np.ix_(probes, numbers)] = factor, factor.T
        self.cov[probes, probes] = 1.0

    def _joined(self, own: Ints, rows: Ints, apart: bool = False) -> Array:
        """The state (1+s,s) of some numbers (o,) of the own one, and of landmarks at rest, rows (m,) of the whole.

        `apart`: the covariance of one landmark at rest with another is not written.
        """
        first, size, numbers = len(own), len(own) + 2 * len(rows), numbers_of(rows)
        state = np.empty((1 + size, size))
        cov, expanded = state[1:], self._expanded(rows, own, np.arange(0, 2 * len(rows), 2))
        if apart:
            own_blocks(self._whole_cov, numbers, *expanded.change, cov, first)
        else:
            expanded.write_among(self._whole_cov, numbers, cov, first)
        state[0, :first], state[0, first:] = self.mean[own], expanded.mean
        cov[:first, :first], cov[first:, :first] = block_of(self.cov, own, own), expanded.cross
        cov[:first, first:] = expanded.cross.T
        return state

    def _expanded(self, rows: Ints, own: Ints, pairs: Ints) -> Expanded:
        """Landmarks, rows (m,) of the whole map, as they are now; `own` (o,): numbers of the state; see `Expanded`."""
        assert self.rest is not None
        probes = numbers_of(np.flatnonzero(self.slot_ids <= FIRST_PROBE))
        vectors, among = self.rest.coordinates(rows), block_of(self.cov, probes, probes)
        among[np.arange(2, len(among), 2), np.arange(2, len(among), 2)] -= 1.0  # what they had at first
        mean = product_of(vectors, self.mean[probes, None].copy(), pairs)[:, 0]
        cross = product_of(vectors, block_of(self.cov, probes, own), pairs)
        if len(pairs) < len(probes):  # few landmarks: not worth it
            return Expanded(mean, cross, (product_of(vectors, among, pairs), vectors), pairs)
        scale = np.abs(vectors).max(axis=0)  # so that no probe of which little is in any landmark counts for much
        scale[scale == 0.0] = 1.0
        Q, R = low_rank(scale[:, None] * among * scale, 512.0 * ROUNDING)
        left, right = Q / scale[:, None], np.ascontiguousarray((R / scale).T)
        return Expanded(mean, cross, (product_of(vectors, left, pairs), product_of(vectors, right, pairs)), pairs)

    @property
    def _whole_cov(self) -> Array:
        """The covariance of the whole map when the submap was taken."""
        assert self.rest is not None
        return self.rest.state[1:]

    def _is_at_work(self, ids: Ints) -> bool:
        return self.rest is None or bool((rows_of(self.slot_ids, ids) >= 0).all())

    def _at_work(self) -> Ints:
        """Ids of the submap, without the probes."""
        return self.slot_ids[self.slot_ids > FIRST_PROBE]

    def _numbers_at_work(self) -> Ints:
        """Where pose and submap are in the state."""
        return np.concatenate((np.arange(3), numbers_of(np.flatnonzero(self.slot_ids > FIRST_PROBE))))

    def _rows_of_rest(self, ids: Ints) -> Ints:
        """(m,) rows of the whole map; raises `FilterError` for ids that are not at rest there."""
        assert self.rest is not None
        self._refuse_unknown(ids)
        return rows_of(self.rest.slot_ids, ids)

    def _refuse_unknown(self, ids: Ints) -> None:
        slots_of(self._all_ids(), ids)

    def _all_ids(self) -> Ints:
        """Ids of all landmarks and marks, in the order of their initialisation."""
        if self.rest is None:
            return self.slot_ids
        work = self._at_work()
        kept = np.ones(len(self.rest.slot_ids), np.bool_)
        kept[self.rest.at_work] = rows_of(work, self.rest.slot_ids[self.rest.at_work]) >= 0
        return np.concatenate((self.rest.slot_ids[kept], work[rows_of(self.rest.slot_ids, work) < 0]))
