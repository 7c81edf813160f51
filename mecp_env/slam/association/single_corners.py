"""Pairing of single corners: who may be paired at all, and what becomes of a corner without a pairing (III-B.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import UNKNOWN_ROOM, CornerKind, Corners, Decision, MapView, Match, Reason
from mecp_env.slam.protocols import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

HERE = -2  # not seen through a door
NOWHERE = np.empty(0, np.int64)
JAMB, NEW, IGNORED = int(CornerKind.JAMB), int(Decision.NEW), int(Decision.IGNORED)
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
    ids, features = view.belief.ids, view.features
    nis = belief.individual_nis(corners.z, corners.R, ids)
    costs, nearest = np.empty(nis.shape), np.empty(nis.shape[0])
    home = UNKNOWN_ROOM if view.graph.in_doorway or not config.use_rooms else view.graph.current
    strike_out(
        nis,
        costs,
        nearest,
        view.belief.T_map_robot[2],
        corners.convex,
        corners.normals,
        home,
        corners.beyond,
        _rooms_behind(view) if config.use_rooms else NOWHERE,
        ids,
        features.convex,
        features.normals,
        features.room,
        features.kind,
        math.radians(config.signature_deg) if config.use_signature else math.nan,
        gate,
        elsewhere,
    )
    return PairingTable(nis, costs, nearest)


@compiled
def strike_out(
    nis: Array,
    costs: Array,
    nearest: Array,
    heading: float,
    convex: Bools,
    normals: Array,
    home: int,
    beyond: Ints,
    behind: Ints,
    ids: Ints,
    known_convex: Bools,
    known_normals: Array,
    known_room: Ints,
    known_kind: Ints,
    tolerance: float,
    gate: float,
    elsewhere: bool,
) -> None:
    """Both strikes, one after the other; a `tolerance` of nan leaves the signature out. Shapes as there."""
    seen = rooms_seen(home, beyond, behind)
    if not math.isnan(tolerance):
        strike_by_signature(nis, heading, convex, normals, ids, known_convex, known_normals, tolerance)
    strike_by_room(nis, costs, nearest, seen, ids, known_room, known_kind, gate, elsewhere)


def _rooms_behind(view: MapView) -> Ints:
    """(n,) the room behind the door that each corner is seen through, HERE without one; empty when there are none."""
    through = view.through.tolist()
    if max(through) < 0:
        return NOWHERE
    here = view.graph.current
    behind = {
        door.id: door.rooms[1] if door.rooms[0] == here else door.rooms[0]
        for door in view.graph.doors
        if door.id in through
    }
    return np.array([behind.get(door, HERE) for door in through])


@compiled
def rooms_seen(home: int, beyond: Ints, behind: Ints) -> Ints:
    """(n,) the room each corner lies in: `home`, open beyond a gap that is no door yet, or what is `behind` a door."""
    seen = np.empty(beyond.shape[0], np.int64)
    for i in range(seen.shape[0]):
        seen[i] = home if beyond[i] < 0 else UNKNOWN_ROOM
        if behind.shape[0] > 0 and behind[i] != HERE:
            seen[i] = behind[i]
    return seen


@compiled
def strike_by_signature(
    nis: Array,
    heading: float,
    convex: Bools,
    normals: Array,
    ids: Ints,
    known_convex: Bools,
    known_normals: Array,
    tolerance: float,
) -> None:
    """Set nis (n,N) to inf where corner and landmark cannot be one; in place.

    Both are outer or both inner corners, at least one face is seen in both, and none is turned by more than
    `tolerance`. `normals` (n,2) are in the robot frame, those known (F,2) in the map frame; `ids` (N,) are the rows of
    the landmarks among the F features.
    """
    for i in range(nis.shape[0]):
        for j in range(nis.shape[1]):
            f = ids[j]
            if nis[i, j] == math.inf:
                continue
            if convex[i] != known_convex[f] or not _faces_fit(normals[i], heading, known_normals[f], tolerance):
                nis[i, j] = math.inf


@compiled
def _faces_fit(normals: Array, heading: float, known: Array, tolerance: float) -> bool:
    """True when at least one face (of two) is seen in both and none is turned by more than `tolerance`."""
    shared, turned = False, False
    for side in range(2):
        difference = wrap_angle(normals[side] + heading - known[side])
        shared |= not math.isnan(difference)
        turned |= abs(difference) > tolerance
    return shared and not turned


@compiled
def strike_by_room(
    nis: Array,
    costs: Array,
    nearest: Array,
    seen: Ints,
    ids: Ints,
    known_room: Ints,
    known_kind: Ints,
    gate: float,
    elsewhere: bool,
) -> None:
    """Write nis (n,N) to `costs`, inf where the rooms differ unless one of them is open, and its least to `nearest`.

    `seen` (n,) is the room of each corner, open < 0; `ids` (N,) are the rows of the landmarks among the F features.
    Jambs belong to both rooms. With `elsewhere`, the row of a corner that has nothing inside `gate` in its room stays
    as it was.
    """
    room = np.empty(ids.shape[0], np.int64)
    for j in range(ids.shape[0]):
        room[j] = UNKNOWN_ROOM if known_kind[ids[j]] == JAMB else known_room[ids[j]]
    for i in range(nis.shape[0]):
        at_home, nearest[i] = False, math.inf
        for j in range(nis.shape[1]):
            costs[i, j] = math.inf if seen[i] >= 0 and room[j] >= 0 and seen[i] != room[j] else nis[i, j]
            at_home |= costs[i, j] <= gate
            nearest[i] = min(nearest[i], nis[i, j])
        if elsewhere and not at_home:
            for j in range(nis.shape[1]):
                costs[i, j] = nis[i, j]


@compiled
def pairs_beside_ring(
    costs: Array,
    gate: float,
    most: int,
    landmarks: Ints,
    ring_corners: Ints,
    ring_ids: Ints,
    fixed: Ints,
    corner: Ints,
    row: Ints,
) -> int:
    """As `possible_pairs`, once the corners (v,) of a recognised polygon and their ids (v,) are written to `fixed`."""
    fix_rows(ring_corners, ring_ids, landmarks, fixed)
    return possible_pairs(costs, gate, fixed, most, corner, row)


@compiled
def possible_pairs(costs: Array, gate: float, fixed: Ints, most: int, corner: Ints, row: Ints) -> int:
    """Write corner and landmark row (P,) of each pair inside the gate; of too many, the `most` that cost least.

    A corner with a `fixed` (n,) landmark row (-1: none) has that pair alone, whatever it costs. Returns P.
    """
    n, m = costs.shape
    price = np.empty(n * m)
    count = 0
    for i in range(n):
        for j in range(m):
            if fixed[i] == j or (fixed[i] < 0 and costs[i, j] <= gate):
                corner[count], row[count] = i, j
                price[count] = -1.0 if fixed[i] == j else costs[i, j]
                count += 1
    while count > most:
        count = _drop_dearest(corner, row, price, count)
    return count


@compiled
def _drop_dearest(corner: Ints, row: Ints, price: Array, count: int) -> int:
    """Take the dearest of `count` pairs out, of equal ones the last; returns how many are left."""
    dearest = 0
    for p in range(1, count):
        if price[p] >= price[dearest]:
            dearest = p
    for p in range(dearest, count - 1):
        corner[p], row[p], price[p] = corner[p + 1], row[p + 1], price[p + 1]
    return count - 1


@compiled
def fix_rows(corners: Ints, ids: Ints, landmarks: Ints, fixed: Ints) -> None:
    """Write to `fixed` (n,) the row among `landmarks` (N,) of the `ids` (v,) that `corners` (v,) are, -1 elsewhere."""
    for i in range(fixed.shape[0]):
        fixed[i] = -1
    for v in range(corners.shape[0]):
        for j in range(landmarks.shape[0]):
            if landmarks[j] == ids[v]:
                fixed[corners[v]] = j


def settle(match: Match, corners: Corners, view: MapView, nearest: Array, ignore_gate: float) -> None:
    """Say of each corner without a landmark whether it may be new; in place.

    `nearest` (n,) is the smallest NIS to any landmark of the same signature. A corner neither clearly old nor clearly
    new is ignored, so is one beyond a door, and every one while the robot stands in a doorway.
    """
    doorway = view.graph.in_doorway
    _settle(match.decision, match.reason, nearest, ignore_gate, doorway, corners.beyond, view.through)


@compiled
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
