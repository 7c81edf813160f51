"""Pairing of single corners: who may be paired at all, and what becomes of a corner without a pairing (III-B.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.data import UNKNOWN_ROOM, CornerKind, Corners, Decision, MapView, Match, Reason
from mecp_env.slam.geometry import wrap_angle
from mecp_env.slam.protocols import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NEW, IGNORED = int(Decision.NEW), int(Decision.IGNORED)
AMBIGUOUS, IN_DOORWAY, BEYOND_DOOR = int(Reason.AMBIGUOUS), int(Reason.IN_DOORWAY), int(Reason.BEYOND_DOOR)


@dataclass(frozen=True, slots=True, eq=False)
class PairingTable:
    """Every corner of the scan against every landmark."""

    nis: Array  # (n,N) inf where the signature says no
    costs: Array  # (n,N) the same, inf where the room says no as well
    nearest: Array  # (n,) smallest of nis


def pairing_table(
    corners: Corners, view: MapView, belief: Filter, config: AssociationConfig, gate: float, elsewhere: bool = True
) -> PairingTable:
    """NIS of each pair, struck out by signature and room.

    With `elsewhere`, a corner that no landmark of its room lies near may be one of any room.
    """
    ids = view.belief.ids
    nis = belief.individual_nis(corners.z, corners.R, ids)
    if config.use_signature:
        strike_by_signature(
            nis,
            view.belief.T_map_robot[2],
            corners.convex,
            corners.normals,
            view.features.convex[ids],
            view.features.normals[ids],
            math.radians(config.signature_deg),
        )
    costs = strike_by_room(nis, _rooms_seen(corners, view, config), _rooms_known(view), gate, elsewhere)
    return PairingTable(nis, costs, nis.min(axis=1))


def _rooms_seen(corners: Corners, view: MapView, config: AssociationConfig) -> Ints:
    """(n,) the room each corner lies in, UNKNOWN_ROOM where that is open."""
    graph = view.graph
    everywhere = graph.in_doorway or not config.use_rooms
    rooms = np.full(len(corners), UNKNOWN_ROOM if everywhere else graph.current, np.int64)
    if not config.use_rooms:
        return rooms
    rooms[corners.beyond >= 0] = UNKNOWN_ROOM
    beyond = {door.id: door.rooms[1] if door.rooms[0] == graph.current else door.rooms[0] for door in graph.doors}
    for i in np.flatnonzero(view.through >= 0).tolist():
        rooms[i] = beyond[int(view.through[i])]
    return rooms


def _rooms_known(view: MapView) -> Ints:
    """(N,) the room of each landmark, UNKNOWN_ROOM for jambs: they belong to both rooms."""
    ids = view.belief.ids
    return np.where(view.features.kind[ids] == int(CornerKind.JAMB), UNKNOWN_ROOM, view.features.room[ids])


@kernel
def strike_by_signature(
    nis: Array,
    heading: float,
    convex: Bools,
    normals: Array,
    known_convex: Bools,
    known_normals: Array,
    tolerance: float,
) -> None:
    """Set nis (n,N) to inf where corner and landmark cannot be one; in place.

    Both are outer or both inner corners, at least one face is seen in both, and none is turned by more than
    `tolerance`. `normals` (n,2) are in the robot frame, `known_normals` (N,2) in the map frame.
    """
    n, m = nis.shape
    for pair in range(n * m):
        i, j = pair // m, pair % m
        shared, turned = 0, 0
        for side in range(2):
            difference = wrap_angle(normals[i, side] + heading - known_normals[j, side])
            shared += not math.isnan(difference)
            turned += abs(difference) > tolerance
        if convex[i] != known_convex[j] or shared == 0 or turned > 0:
            nis[i, j] = math.inf


@kernel
def strike_by_room(nis: Array, seen: Ints, known: Ints, gate: float, elsewhere: bool) -> Array:
    """nis (n,N) with inf where the rooms `seen` (n,) and `known` (N,) differ, unless one of them is open (< 0).

    With `elsewhere`, the row of a corner that has nothing inside `gate` in its room is left as it was.
    """
    costs = nis.copy()
    for i in range(nis.shape[0]):
        at_home = False
        for j in range(nis.shape[1]):
            if seen[i] >= 0 and known[j] >= 0 and seen[i] != known[j]:
                costs[i, j] = math.inf
            at_home |= costs[i, j] <= gate
        if elsewhere and not at_home:
            costs[i] = nis[i]
    return costs


@kernel
def possible_pairs(costs: Array, gate: float, fixed: Ints, most: int) -> tuple[Ints, Ints]:
    """Corner and landmark row (P,) of each pair inside the gate; of too many, those that cost least, `most` of them.

    A corner with a `fixed` (n,) landmark row (-1: none) has that pair alone, whatever it costs.
    """
    n, m = costs.shape
    corner, row, price = np.empty(n * m, np.int64), np.empty(n * m, np.int64), np.empty(n * m)
    count = 0
    for i in range(n):
        for j in range(m):
            if fixed[i] == j or (fixed[i] < 0 and costs[i, j] <= gate):
                corner[count], row[count] = i, j
                price[count] = -1.0 if fixed[i] == j else costs[i, j]
                count += 1
    if count > most:
        keep = np.sort(np.argsort(price[:count])[:most])
        return corner[keep], row[keep]
    return corner[:count], row[:count]


def settle(match: Match, corners: Corners, view: MapView, nearest: Array, ignore_gate: float) -> None:
    """Say of each corner without a landmark whether it may be new; in place.

    `nearest` (n,) is the smallest NIS to any landmark of the same signature. A corner neither clearly old nor clearly
    new is ignored, so is one beyond a door, and every one while the robot stands in a doorway.
    """
    doorway = view.graph.in_doorway
    _settle(match.decision, match.reason, nearest, ignore_gate, doorway, corners.beyond, view.through)


@kernel
def _settle(
    decision: Ints, reason: Ints, nearest: Array, ignore_gate: float, in_doorway: bool, beyond: Ints, through: Ints
) -> None:
    for i in range(decision.shape[0]):
        if decision[i] != NEW:
            continue
        if nearest[i] <= ignore_gate:
            decision[i], reason[i] = IGNORED, AMBIGUOUS
        elif in_doorway:
            decision[i], reason[i] = IGNORED, IN_DOORWAY
        elif beyond[i] >= 0 or through[i] >= 0:
            decision[i], reason[i] = IGNORED, BEYOND_DOOR
