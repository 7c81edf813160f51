"""Gating (III-B.2) by NIS, corner descriptor and room; joint compatibility; and a match while it is made.

Each pairing that is accepted conditions all others (a Schur complement), so that after two or three of them the common
error of the pose is gone and what is left must fit as a rigid whole. This is the greedy relative of JCBB (Neira, Tardos
2001), with the full cross-covariance.

Pairings (P,) have a row of the corner and a landmark; nu (2P,) and S (2P,2P) are their joint innovation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Ints, Rows, carrier, row_type
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import (
    HERE,
    NO_ID,
    NO_IDS,
    UNKNOWN_ROOM,
    CornerKind,
    Corners,
    Decision,
    MapView,
    Match,
    Reason,
)
from mecp_env.slam.protocols import Associator, Filter

FIXED = -math.inf  # cost of a pair that a polygon match has fixed: below every NIS
ROW = row_type([("id", np.int64), ("decision", np.int64), ("reason", np.int64), ("nis", np.float64)])
INITIAL = np.repeat(np.array([(NO_ID, Decision.NEW, Reason.UNSEEN, np.nan)], ROW), 256)
INITIAL_BYTES = INITIAL.view(np.uint8)  # copied, faster than filled, and faster than as rows


@lru_cache
def chi2_gate(dof: int, probability: float) -> float:
    """The value that a chi-square variable of `dof` degrees of freedom stays under with `probability`."""
    return float(chdtri(dof, 1.0 - probability))


@dataclass(slots=True, eq=False)
class GatedAssociator(Associator):
    """An associator with a configuration and the gate of a single pair that it implies."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)


@carrier
class PairingTable:
    """Every corner of the scan against every landmark."""

    nis: Array  # (n,N) inf where the descriptors differ
    costs: Array  # (n,N) the same, inf where the rooms differ as well


def pairing_table(
    corners: Corners, view: MapView, belief: Filter, config: AssociationConfig, home_gate: float, turn_rad: float = 0.0
) -> PairingTable:
    """NIS of each pair, inf where descriptor or room differ.

    Faces may be turned by `turn_rad` more than `descriptor_deg`: by what the heading may be wrong. A corner that has no
    landmark of its room inside `home_gate` may be one of any room; inf: of the same room only.
    """
    ids, features, graph = view.belief.ids, view.features.rows, view.graph
    nis = belief.individual_nis(corners.z, corners.R, ids)
    if config.use_descriptor:
        heading, tolerance = view.belief.T_map_robot[2], math.radians(config.descriptor_deg) + turn_rad
        mask_by_descriptor(nis, corners.convex, corners.normals, heading, ids, features, tolerance)
    home = UNKNOWN_ROOM if graph.in_doorway or not config.use_rooms else graph.current
    behind = graph.rooms_behind(view.through) if config.use_rooms else NO_IDS
    costs = np.empty(nis.shape)
    mask_by_room(nis, costs, home, corners.beyond, behind, ids, features, home_gate)
    if view.past is not None:
        costs[view.past] = math.inf
    return PairingTable(nis, costs)


@compiled
def mask_by_descriptor(
    nis: Array, convex: Bools, normals: Array, heading: float, ids: Ints, features: Rows, tolerance: float
) -> None:
    """Set nis (n,N) to inf where corner and landmark cannot be one; in place.

    Both are outer or both inner corners, at least one face is seen in both, and none is turned by more than
    `tolerance`. `normals` (n,2) are in the robot frame, those of `features` (F,) FEATURE in the map frame; `ids` (N,)
    are the rows of the landmarks among the features.
    """
    for i in range(nis.shape[0]):
        for j in range(nis.shape[1]):
            if nis[i, j] == math.inf:
                continue
            feature = features[ids[j]]
            if convex[i] != feature.convex or not 0.0 <= face_turn(normals[i], heading, feature.normals) <= tolerance:
                nis[i, j] = math.inf


@compiled
def mask_by_room(
    nis: Array, costs: Array, home: int, beyond: Ints, behind: Ints, ids: Ints, features: Rows, home_gate: float
) -> None:
    """Write nis (n,N) to `costs` (n,N), inf where the rooms differ, unless one of the two rooms is unknown.

    A corner is in `home`, in an unknown room when it is `beyond` (n,) an unconfirmed gap, or in the room
    `behind` (n,) a door. Jambs belong to both rooms. The row of a corner that has nothing inside `home_gate` in its
    room stays as it was. `features` and `ids` are as in `mask_by_descriptor`.
    """
    room = np.empty(ids.shape[0], np.int64)
    for j in range(ids.shape[0]):
        feature = features[ids[j]]
        room[j] = UNKNOWN_ROOM if feature.kind == CornerKind.JAMB else feature.room
    for i in range(nis.shape[0]):
        seen, at_home = home if beyond[i] < 0 else UNKNOWN_ROOM, False
        if behind.shape[0] > 0 and behind[i] != HERE:
            seen = behind[i]
        for j in range(nis.shape[1]):
            costs[i, j] = math.inf if seen >= 0 and room[j] >= 0 and seen != room[j] else nis[i, j]
            at_home |= costs[i, j] <= home_gate
        for j in range(0 if at_home else nis.shape[1]):
            costs[i, j] = nis[i, j]


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


@compiled
def possible_pairs(
    costs: Array,
    landmarks: Ints,
    fixed_corners: Ints,
    fixed_ids: Ints,
    gate: float,
    pairs: Ints,
    cost: Array,
) -> int:
    """Write corner and landmark id (2,P) and cost (P,) of each pair inside the gate.

    `fixed_corners` (v,) are the landmarks `fixed_ids` (v,) and no others, whatever these pairs cost: they are FIXED.
    `costs` (n,N) is overwritten. Returns P.
    """
    for v in range(fixed_corners.shape[0]):
        for j in range(landmarks.shape[0]):
            costs[fixed_corners[v], j] = FIXED if landmarks[j] == fixed_ids[v] else math.inf
    count = 0
    for i in range(costs.shape[0]):
        for j in range(costs.shape[1]):
            if costs[i, j] <= gate:
                pairs[0, count], pairs[1, count], cost[count] = i, landmarks[j], costs[i, j]
                count += 1
    return count


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
        decision: Decision | Ints,
        reason: Reason | Ints,
        ids: Ints | int = NO_ID,
        nis: Array | float = np.nan,
    ) -> None:
        """Decide for some corners (c,), or one; every column is (c,) or one value."""
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
