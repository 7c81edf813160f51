"""Tracks: a corner seen often enough is confirmed as a landmark, one that is not seen again is dropped."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn, polar_to_points, to_map
from mecp_env.slam.config import SlamConfig, TrackConfig
from mecp_env.slam.messages import (
    FEATURE,
    UNKNOWN_ROOM,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    Match,
    Reason,
    RoomGraph,
    Sighting,
)

TRACK, LANDMARK, DEAD = int(FeatureState.TRACK), int(FeatureState.LANDMARK), int(FeatureState.DEAD)
JAMB = int(CornerKind.JAMB)
NEW, PROVISIONAL = int(Decision.NEW), int(Decision.PROVISIONAL)


def track_corners(
    features: FeatureTable, seen: Sighting, graph: RoomGraph, config: SlamConfig, wide: bool = False
) -> tuple[Match, Ints]:
    """The match with an id for every corner that is kept, and the corners (c,) whose track is confirmed now.

    Sightings are counted in `features`. A room that is seen through its door is mapped from there: new tracks belong to
    the room behind the door, or to an open one until they are seen from inside. One sighting is enough while few
    landmarks are in view: without any the pose is lost. With `wide` predictions jambs do not count: the next one may
    leave the door behind, and miss the tracks.
    """
    corners, match, T_map_robot = seen.corners, seen.match, seen.belief.T_map_robot
    room = graph.rooms_of(corners.beyond, seen.through)
    if NEW in match.decision.tolist():
        seen_as = corners.z, corners.cov, corners.convex, corners.normals
        gate = config.tracks.gate_m, config.sensor.noise_sigmas, config.association.face_turn_rad
        track = find_tracks(match.decision, *seen_as, T_map_robot, features.rows, gate)
        track[np.isin(track, match.ids[match.decision == PROVISIONAL])] = -1  # the associator's choice
        match = _follow_and_start(features, corners, match, track, room)
    marks = corners.kind, corners.normals, corners.z, T_map_robot
    return match, count_sightings(features.rows, match.ids, marks, room, config.tracks.record, seen.step, wide)


def _follow_and_start(features: FeatureTable, corners: Corners, match: Match, track: Ints, room: Ints) -> Match:
    """The match in which each NEW corner continues its `track` (n,) or, at -1, starts one in its `room` (n,)."""
    new = match.decision == NEW
    started, follows = np.flatnonzero(new & (track < 0)), np.flatnonzero(new & (track >= 0))
    if len(started):
        rows = np.zeros(len(started), FEATURE)
        rows["state"], rows["room"], rows["normals"] = TRACK, room[started], math.nan
        rows["kind"], rows["convex"] = corners.kind[started], corners.convex[started]
        match = match.assign(started, features.append(rows), NEW, match.reason[started])
    return match.assign(follows, track[follows], PROVISIONAL, int(Reason.TRACK)) if len(follows) else match


def drop_tracks(features: FeatureTable, step: int, config: TrackConfig) -> bool:
    """Drop the tracks that were not seen for `config.window_steps`; true when there are any."""
    return _drop_tracks(features.rows, step - config.window_steps) > 0


@compiled
def _drop_tracks(rows: Rows, oldest: int) -> int:
    """Set the tracks dead that were last seen before the step `oldest`; returns how many."""
    count = 0
    for f in range(rows.shape[0]):
        if rows[f].state == TRACK and rows[f].last_step < oldest:
            rows[f].state = DEAD
            count += 1
    return count


@compiled
def find_tracks(
    decision: Ints,
    z: Array,
    cov: Array,
    convex: Bools,
    normals: Array,
    T_map_robot: Array,
    rows: Rows,
    gate: tuple[float, float, float],
) -> Ints:
    """(n,) id of the nearest track with the descriptor of each NEW corner, in their order and each once; -1: none.

    The `gate` is in m, in sigmas of the corner's position error, for which the larger of range sigma and arc of bearing
    sigma is an upper bound, and in rad that a face may turn. z (n,2) and cov (2n,2n) are the measurements, `normals`
    (n,2) rad is in the robot frame.
    """
    (near_m, sigmas, turn), heading, count = gate, T_map_robot[2], z.shape[0]
    p_map, track = to_map(T_map_robot, polar_to_points(z)), np.full(count, -1)
    free = np.empty(rows.shape[0], np.bool_)
    for f in range(rows.shape[0]):
        free[f] = rows[f].state == TRACK
    for i in range(count):
        along, across = cov[2 * i, 2 * i], cov[2 * i + 1, 2 * i + 1] * (z[i, 0] * z[i, 0])
        best = near_m + sigmas * math.sqrt(max(along, across))
        for f in range(rows.shape[0]):
            if decision[i] != NEW or not free[f] or convex[i] != rows[f].convex:
                continue
            distance = math.hypot(p_map[i, 0] - rows[f].p_map[0], p_map[i, 1] - rows[f].p_map[1])
            if distance <= best and face_turn(normals[i], heading, rows[f].normals) <= turn:
                best, track[i] = distance, f
        if track[i] >= 0:
            free[track[i]] = False
    return track


@compiled
def count_sightings(
    rows: Rows,
    ids: Ints,
    marks: tuple[Ints, Array, Array, Array],
    room: Ints,
    config: Rows,
    step: int,
    wide: bool,
) -> Ints:
    """(c,) the corners whose track has now been seen often enough; `rows` note one sighting of each feature.

    `ids` (n,) are the features of the corners, < 0: none; `marks` are kind (n,), normals (n,2) rad and z (n,2) in the
    robot frame, and the robot's pose. A feature of an open room belongs to that of its corner, `room` (n,). With few
    landmarks in view, jambs not counted after a `wide` prediction, one sighting is enough.
    """
    limits, (kind, normals, z, T_map_robot), count, landmarks = config[0], marks, 0, 0
    p_map, confirmed = to_map(T_map_robot, polar_to_points(z)), np.empty(z.shape[0], np.int64)
    for f in ids:
        landmarks += f >= 0 and rows[f].state == LANDMARK and not (wide and rows[f].kind == JAMB)
    for i in range(ids.shape[0]):
        f = ids[i]
        if f < 0:
            continue
        rows[f].seen += 1
        rows[f].last_step = step
        rows[f].room = room[i] if rows[f].room == UNKNOWN_ROOM else rows[f].room
        for k in range(2):
            rows[f].p_map[k] = p_map[i, k]
            if math.isnan(rows[f].normals[k]):
                rows[f].normals[k] = normals[i, k] + T_map_robot[2]
        needed = limits.jamb_sightings if kind[i] == JAMB else limits.sightings
        needed = 1 if landmarks < limits.few_matches else needed
        if rows[f].state == TRACK and rows[f].seen >= needed:
            confirmed[count] = i
            count += 1
    return confirmed[:count]


@compiled
def find_unconfirmed(rows: Rows, landmarks: Ints, config: Rows, step: int) -> Ints:
    """(m,) those of the `landmarks` (N,) that one sighting made and that were not seen again as often as others are."""
    limits, found, count = config[0], np.empty(landmarks.shape[0], np.int64), 0
    for f in landmarks:
        needed = limits.jamb_sightings if rows[f].kind == JAMB else limits.sightings
        if rows[f].seen < needed and rows[f].last_step < step - limits.window_steps:
            found[count] = f
            count += 1
    return found[:count]
