"""Pairing of single corners: who may be paired at all, and what becomes of a corner without a pairing (III-B.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.association.base import signature_compatible
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.data import (
    UNKNOWN_ROOM,
    CornerKind,
    Corners,
    Decision,
    MapView,
    Match,
    Reason,
)
from mecp_env.slam.filters import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class PairingTable:
    """Every corner of the scan against every landmark."""

    nis: Array  # (n,N) inf where the signature says no
    allowed: Bools  # (n,N) the room says yes as well


def pairing_table(corners: Corners, view: MapView, belief: Filter, config: AssociationConfig) -> PairingTable:
    """NIS of each pair, struck out by signature; rooms are kept apart, since a corner may be known from elsewhere."""
    ids = view.belief.ids
    nis = belief.individual_nis(corners.z, np.ascontiguousarray(corners.R), ids)
    if config.use_signature:
        nis = np.where(_signature_mask(corners, view, ids, config), nis, np.inf)
    allowed = _room_mask(corners, view, ids) if config.use_rooms else np.ones(nis.shape, np.bool_)
    return PairingTable(nis, allowed)


def _signature_mask(corners: Corners, view: MapView, ids: Ints, config: AssociationConfig) -> Bools:
    return signature_compatible(
        view.belief.T_map_robot[2],
        corners.convex,
        corners.normals,
        view.features.convex[ids],
        view.features.normals[ids],
        math.radians(config.signature_deg),
    )


def _room_mask(corners: Corners, view: MapView, ids: Ints) -> Bools:
    """(n,N) True where corner and landmark lie in the same room, or either's room is open (jambs belong to both)."""
    graph = view.graph
    room_seen = np.full(len(corners), UNKNOWN_ROOM if graph.in_doorway else graph.current, np.int64)
    beyond = {door.id: _room_beyond(door.rooms, graph.current) for door in graph.doors}
    for i in np.flatnonzero(view.through >= 0):
        room_seen[i] = beyond.get(int(view.through[i]), UNKNOWN_ROOM)
    room_seen[(corners.beyond >= 0) & (view.through < 0)] = UNKNOWN_ROOM
    room_known = resolved_rooms(view, ids)
    shared = view.features.kind[ids] == int(CornerKind.JAMB)
    return (room_seen[:, None] == room_known[None, :]) | (room_seen[:, None] == UNKNOWN_ROOM) | shared[None, :]


def _room_beyond(rooms: tuple[int, int], current: int) -> int:
    return rooms[1] if rooms[0] == current else rooms[0]


def resolved_rooms(view: MapView, ids: Ints) -> Ints:
    """(N,) the room of each landmark after all merges."""
    rooms = view.features.room[ids]
    for old in view.graph.merged:
        rooms = np.where(rooms == old, view.graph.resolve(old), rooms)
    return rooms


def open_rooms(table: PairingTable, gate: float) -> Array:
    """(n,N) NIS of the pairs allowed: within the room, or anywhere for a corner that its room does not know."""
    in_room = np.where(table.allowed, table.nis, np.inf)
    known_here = (in_room <= gate).any(axis=1)
    return np.where(known_here[:, None], in_room, table.nis)


def settle(match: Match, corners: Corners, view: MapView, nearest: Array, ignore_gate: float) -> None:
    """Say of each corner without a landmark whether it may be new; in place.

    `nearest` (n,) is the smallest NIS to any landmark of the same signature. A corner neither clearly old nor clearly
    new is ignored, so is one beyond a door, and every one while the robot stands in a doorway.
    """
    rules = (
        (nearest <= ignore_gate, Reason.AMBIGUOUS),
        (np.full(len(corners), view.graph.in_doorway), Reason.IN_DOORWAY),
        ((corners.beyond >= 0) | (view.through >= 0), Reason.BEYOND_DOOR),
    )
    unpaired = match.decision == int(Decision.NEW)
    for applies, reason in rules:
        match.decision[unpaired & applies] = int(Decision.IGNORED)
        match.reason[unpaired & applies] = int(reason)
