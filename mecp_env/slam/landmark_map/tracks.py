"""From corners to landmarks: a corner seen often enough joins the filter, one that is not seen again is forgotten."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_map, wrap_angle
from mecp_env.slam.config import TrackConfig
from mecp_env.slam.messages import (
    Belief,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    Match,
    Reason,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TRACK, LANDMARK, DEAD = int(FeatureState.TRACK), int(FeatureState.LANDMARK), int(FeatureState.DEAD)
JAMB, NEW, PROVISIONAL = int(CornerKind.JAMB), int(Decision.NEW), int(Decision.PROVISIONAL)
ON_TRACK = int(Reason.TRACK)
RECOGNISED = int(Decision.LANDMARK)
LONE_NIS = 9.21  # chi-square, 2 degrees of freedom, 99 %
BODY_M = (0.2, 0.5)  # how wide somebody is; a wall is thinner


def record_sightings(
    features: FeatureTable, corners: Corners, match: Match, belief: Belief, room: int, config: TrackConfig
) -> tuple[Match, Ints]:
    """The match with an id for every corner that is kept, and the corners (c,) that become landmarks now.

    `features` is written to: sightings are counted, new tracks are born in `room`; tracks not seen for
    `config.window_steps` were dropped by `forget` before.
    """
    p_map, ripe = np.empty_like(corners.z), np.empty(len(corners), np.int64)
    if NEW in match.decision.tolist():
        polar_to_map(belief.T_map_robot, corners.z, p_map)
        _follow_tracks(features, corners, match, belief.T_map_robot[2], p_map, config)
        _start_tracks(features, corners, match, p_map, room)
    count = _count(
        match.ids,
        corners.kind,
        corners.normals,
        belief.T_map_robot,
        corners.z,
        p_map,
        config.sightings,
        config.jamb_sightings,
        features.state,
        features.seen,
        features.p_map,
        features.normals,
        ripe,
    )
    return match, ripe[:count]


def forget(features: FeatureTable, step: int, config: TrackConfig) -> int:
    """How many tracks die now because they were not seen lately."""
    return _let_die(features.state, features.last_step, step - config.window_steps)


@compiled
def _let_die(state: Ints, last_step: Ints, oldest: int) -> int:
    """Set the tracks dead that were last seen before the step `oldest`; returns how many."""
    count = 0
    for i in range(state.shape[0]):
        if state[i] == TRACK and last_step[i] < oldest:
            state[i] = DEAD
            count += 1
    return count


def _follow_tracks(
    features: FeatureTable, corners: Corners, match: Match, heading: float, p_map: Array, config: TrackConfig
) -> None:
    """Corners still NEW that fall on a track of the same signature become PROVISIONAL, in their order; in place."""
    gate = np.empty(len(corners))
    position_gates(corners.z, corners.cov, config.gate_m, config.gate_sigmas, gate)
    _join_tracks(
        match.ids,
        match.decision,
        match.reason,
        p_map,
        gate,
        corners.convex,
        corners.normals,
        heading,
        features.state,
        features.p_map,
        features.convex,
        features.normals,
        math.radians(config.signature_deg),
    )


def _start_tracks(features: FeatureTable, corners: Corners, match: Match, p_map: Array, room: int) -> None:
    new = np.flatnonzero(match.decision == NEW)
    if len(new):
        match.ids[new] = len(features.state) + np.arange(len(new))
        _extend(features, len(new), room, corners.kind[new], corners.convex[new], p_map[new])


def _extend(features: FeatureTable, count: int, room: int, kind: Ints, convex: Bools, p_map: Array) -> None:
    new = {
        "state": TRACK,
        "room": room,
        "kind": kind,
        "convex": convex,
        "normals": math.nan,
        "seen": 0,
        "last_step": 0,
        "p_map": p_map,
        "doubts": 0,
    }
    for column, values in new.items():
        old = getattr(features, column)
        grown = np.empty((len(old) + count, *old.shape[1:]), old.dtype)
        grown[: len(old)] = old
        grown[len(old) :] = values
        setattr(features, column, grown)


@compiled
def _count(
    ids: Ints,
    kind: Ints,
    normals: Array,
    T_map_robot: Array,
    z: Array,
    p_map: Array,
    needed: int,
    needed_of_jamb: int,
    state: Ints,
    seen: Ints,
    known_p_map: Array,
    known_normals: Array,
    ripe: Ints,
) -> int:
    """Write one sighting of each feature (ids < 0 left out), where, and faces not seen before, into the table.

    Writes to `p_map` (n,2) where the corners z (n,2) lie, and to `ripe` those whose track has now been seen often
    enough; returns how many there are.
    """
    polar_to_map(T_map_robot, z, p_map)
    count = 0
    for i in range(ids.shape[0]):
        f = ids[i]
        if f < 0:
            continue
        seen[f] += 1
        for k in range(2):
            known_p_map[f, k] = p_map[i, k]
            if math.isnan(known_normals[f, k]):
                known_normals[f, k] = normals[i, k] + T_map_robot[2]
        if state[f] == TRACK and seen[f] >= (needed_of_jamb if kind[i] == JAMB else needed):
            ripe[count] = i
            count += 1
    return count


def mark_seen(features: FeatureTable, ids: Ints, step: int) -> None:
    """Note that the features `ids` (n,) were seen in `step`; those < 0 are none."""
    _mark(features.last_step, ids, step)


@compiled
def _mark(last_step: Ints, ids: Ints, step: int) -> None:
    for i in range(ids.shape[0]):
        if ids[i] >= 0:
            last_step[ids[i]] = step


@compiled
def position_gates(z: Array, cov: Array, least: float, sigmas: float, gate: Array) -> None:
    """Write how far (m) from each corner (n,) its track may lie: `least` and `sigmas` of the corner's position error.

    Its upper bound is the larger of range sigma and arc of bearing sigma.
    """
    for i in range(z.shape[0]):
        along, across = cov[2 * i, 2 * i], cov[2 * i + 1, 2 * i + 1] * (z[i, 0] * z[i, 0])
        gate[i] = least + sigmas * math.sqrt(max(along, across))


@compiled
def _join_tracks(
    ids: Ints,
    decision: Ints,
    reason: Ints,
    p_map: Array,
    gate: Array,
    convex: Bools,
    normals: Array,
    heading: float,
    state: Ints,
    known_p_map: Array,
    known_convex: Bools,
    known_normals: Array,
    tolerance: float,
) -> None:
    """Write the nearest track of the same signature inside `gate` (n,) to each NEW corner; each track once."""
    free = np.empty(state.shape[0], np.bool_)
    for f in range(state.shape[0]):
        free[f] = state[f] == TRACK
    for i in range(p_map.shape[0]):
        best, chosen = gate[i], -1
        for f in range(state.shape[0]):
            if decision[i] != NEW or not free[f] or convex[i] != known_convex[f]:
                continue
            distance = math.hypot(p_map[i, 0] - known_p_map[f, 0], p_map[i, 1] - known_p_map[f, 1])
            if distance <= best and not _turned(normals[i], heading, known_normals[f], tolerance):
                best, chosen = distance, f
        if chosen >= 0:
            ids[i], decision[i], reason[i], free[chosen] = chosen, PROVISIONAL, ON_TRACK, False


@compiled
def _turned(normals: Array, heading: float, known: Array, tolerance: float) -> bool:
    """True when a face (of two) seen in both is turned by more than `tolerance`."""
    turned = False
    for side in range(2):
        turned |= abs(wrap_angle(normals[side] + heading - known[side])) > tolerance
    return turned


@compiled
def room_unseen_since(ids: Ints, room: Ints, state: Ints, last_step: Ints, oldest: int) -> bool:
    """True when of some room among the landmarks `ids` no landmark was seen since the step `oldest`."""
    for i in ids:
        unseen = True
        for f in range(room.shape[0]):
            if room[f] == room[i] and state[f] == LANDMARK and last_step[f] >= oldest:
                unseen = False
                break
        if unseen:
            return True
    return False


@compiled
def ends_of_bodies(
    match: tuple[Ints, Ints, Array], z: Array, room: Ints, state: Ints, last_step: Ints, oldest: int, doubtful: Ints
) -> int:
    """Write the corners (n,) to doubt: alone of a room unseen since `oldest`, and beside one that is no landmark.

    Such two corners, as far apart as somebody is wide, may be the two sides of somebody; so may be one that fits its
    landmark badly. `match`: ids, decision and NIS (n,), z (n,2); the rest as in `room_unseen_since`. Returns how many.
    """
    (ids, decision, nis), count = match, 0
    for c in range(z.shape[0]):
        alone, beside = decision[c] == RECOGNISED, nis[c] > LONE_NIS
        for k in range(z.shape[0] if alone else 0):
            if decision[k] == RECOGNISED:
                alone &= k == c or room[ids[k]] != room[ids[c]]
                continue
            square = z[c, 0] ** 2 + z[k, 0] ** 2 - 2.0 * z[c, 0] * z[k, 0] * math.cos(z[c, 1] - z[k, 1])
            beside |= BODY_M[0] ** 2 < square < BODY_M[1] ** 2
        if alone and beside and room_unseen_since(ids[c : c + 1], room, state, last_step, oldest):
            doubtful[count] = c
            count += 1
    return count


def with_closure(match: Match, closure: bool) -> Match:
    """The match with its closure flag set."""
    return match if match.closure == closure else replace(match, closure=closure)
