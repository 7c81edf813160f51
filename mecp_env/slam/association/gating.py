"""Gating: which corner may be which landmark, by NIS, corner descriptor and room (III-B.2)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Ints, Rows, carrier
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import HERE, UNKNOWN_ROOM, CornerKind, Corners, MapView
from mecp_env.slam.protocols import Filter

NOWHERE = np.empty(0, np.int64)
FIXED = -math.inf  # cost of a pair that a polygon match has fixed: below every NIS


@lru_cache
def chi2_gate(dof: int, probability: float) -> float:
    """The value that a chi-square variable of `dof` degrees of freedom stays under with `probability`."""
    return float(chdtri(dof, 1.0 - probability))


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
    behind = graph.rooms_behind(view.through) if config.use_rooms else NOWHERE
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
