"""From corners to landmarks: a corner seen often enough joins the filter, one that is not seen again is forgotten."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import TrackConfig
from mecp_env.slam.data import (
    Belief,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    Match,
    Reason,
)
from mecp_env.slam.geometry import polar_to_points, to_map, wrap_angle

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TRACK, LANDMARK, DEAD = int(FeatureState.TRACK), int(FeatureState.LANDMARK), int(FeatureState.DEAD)
JAMB = int(CornerKind.JAMB)


def record_sightings(
    features: FeatureTable, corners: Corners, match: Match, belief: Belief, room: int, config: TrackConfig
) -> tuple[Match, Ints]:
    """The match with an id for every corner that is kept, and the corners (c,) that become landmarks now.

    `features` is written to: sightings are counted, new tracks are born in `room`; tracks not seen for
    `config.window_periods` were dropped by `forget` before.
    """
    p_map = to_map(belief.T_map_robot, polar_to_points(corners.z))
    if (match.decision == int(Decision.NEW)).any():
        match = _follow_tracks(features, corners, match, belief, p_map, config)
        match = _start_tracks(features, corners, match, p_map, room)
    needed = (config.sightings, config.jamb_sightings)
    known = (features.state, features.seen, features.p_map, features.normals)
    return match, _count(match.ids, corners.kind, corners.normals, p_map, belief.T_map_robot[2], needed, known)


def forget(features: FeatureTable, period: int, config: TrackConfig) -> Ints:
    """Ids (d,) of the tracks that die now because they were not seen lately."""
    return _let_die(features.state, features.last_period, period - config.window_periods)


@kernel
def _let_die(state: Ints, last_period: Ints, oldest: int) -> Ints:
    """Ids of the tracks last seen before the period `oldest`, which are set dead."""
    dead = np.empty(state.shape[0], np.int64)
    count = 0
    for i in range(state.shape[0]):
        if state[i] == TRACK and last_period[i] < oldest:
            state[i] = DEAD
            dead[count] = i
            count += 1
    return dead[:count]


def _follow_tracks(
    features: FeatureTable, corners: Corners, match: Match, belief: Belief, p_map: Array, config: TrackConfig
) -> Match:
    """Corners still NEW that fall on a track of the same signature become PROVISIONAL, nearest first."""
    new = np.flatnonzero(match.decision == int(Decision.NEW))
    tracks = np.flatnonzero(features.state == int(FeatureState.TRACK))
    if not len(new) or not len(tracks):
        return match
    row = _nearest_tracks(
        p_map[new],
        config.gate_m + config.gate_sigmas * position_sigma(corners)[new],
        corners.convex[new],
        corners.normals[new] + belief.T_map_robot[2],
        features.p_map[tracks],
        features.convex[tracks],
        features.normals[tracks],
        math.radians(config.signature_deg),
    )
    found = row >= 0
    match.ids[new[found]] = tracks[row[found]]
    match.decision[new[found]] = int(Decision.PROVISIONAL)
    match.reason[new[found]] = int(Reason.TRACK)
    return match


def _start_tracks(features: FeatureTable, corners: Corners, match: Match, p_map: Array, room: int) -> Match:
    new = np.flatnonzero(match.decision == int(Decision.NEW))
    if len(new):
        match.ids[new] = len(features.state) + np.arange(len(new))
        _extend(features, len(new), room, corners.kind[new], corners.convex[new], p_map[new])
    return match


def _extend(features: FeatureTable, count: int, room: int, kind: Ints, convex: Bools, p_map: Array) -> None:
    grown = {
        "state": np.full(count, int(FeatureState.TRACK), np.int64),
        "room": np.full(count, room, np.int64),
        "kind": kind,
        "convex": convex,
        "normals": np.full((count, 2), np.nan),
        "seen": np.zeros(count, np.int64),
        "last_period": np.zeros(count, np.int64),
        "p_map": p_map,
    }
    for column in fields(features):
        setattr(features, column.name, np.concatenate((getattr(features, column.name), grown[column.name])))


@kernel
def _count(
    ids: Ints,
    kind: Ints,
    normals: Array,
    p_map: Array,
    heading: float,
    needed: tuple[int, int],
    known: tuple[Ints, Ints, Array, Array],
) -> Ints:
    """Write one sighting of each feature (ids < 0 left out), where, and faces not seen before.

    Returns the corners whose track has now been seen often enough (`needed`, of jambs the second); `known` are the
    columns state, seen, p_map and normals of the table.
    """
    state, seen, known_p_map, known_normals = known
    ripe = np.empty(ids.shape[0], np.int64)
    count = 0
    for i in range(ids.shape[0]):
        f = ids[i]
        if f < 0:
            continue
        seen[f] += 1
        for k in range(2):
            known_p_map[f, k] = p_map[i, k]
            if math.isnan(known_normals[f, k]):
                known_normals[f, k] = normals[i, k] + heading
        if state[f] == TRACK and seen[f] >= needed[1 if kind[i] == JAMB else 0]:
            ripe[count] = i
            count += 1
    return ripe[:count]


def mark_seen(features: FeatureTable, ids: Ints, period: int) -> None:
    """Note that the features `ids` were seen in `period`."""
    features.last_period[ids] = period


def position_sigma(corners: Corners) -> Array:
    """(n,) m, an upper bound of each corner's position error: the larger of range sigma and arc of bearing sigma."""
    variance = corners.cov.diagonal()
    along, across = variance[0::2], variance[1::2] * corners.z[:, 0] ** 2
    return np.sqrt(np.maximum(along, across))


@kernel
def _nearest_tracks(
    p_map: Array,
    gate: Array,
    convex: Bools,
    normals: Array,
    track_p_map: Array,
    track_convex: Bools,
    track_normals: Array,
    tolerance: float,
) -> Ints:
    """(n,) track of each corner or -1: the nearest of the same signature inside `gate` (n,), each track once."""
    n, m = p_map.shape[0], track_p_map.shape[0]
    row = np.full(n, -1)
    taken = np.zeros(m, np.bool_)
    for i in range(n):
        best = gate[i]
        for j in range(m):
            distance = math.hypot(p_map[i, 0] - track_p_map[j, 0], p_map[i, 1] - track_p_map[j, 1])
            if taken[j] or distance > best or convex[i] != track_convex[j]:
                continue
            turned = False
            for side in range(2):
                turned |= abs(wrap_angle(normals[i, side] - track_normals[j, side])) > tolerance
            if not turned:
                best = distance
                row[i] = j
        if row[i] >= 0:
            taken[row[i]] = True
    return row


@kernel
def room_unseen_since(ids: Ints, room: Ints, state: Ints, last_period: Ints, oldest: int) -> bool:
    """True when of some room among the landmarks `ids` no landmark was seen since the period `oldest`."""
    for i in ids:
        unseen = True
        for f in range(room.shape[0]):
            if room[f] == room[i] and state[f] == LANDMARK and last_period[f] >= oldest:
                unseen = False
                break
        if unseen:
            return True
    return False


def with_closure(match: Match, closure: bool) -> Match:
    """The match with its closure flag set."""
    return replace(match, closure=closure)
