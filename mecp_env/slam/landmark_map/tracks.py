"""Tracks: a corner seen often enough is confirmed as a landmark, one that is not seen again is dropped."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn, polar_to_points, to_map
from mecp_env.slam.config import TrackConfig
from mecp_env.slam.messages import (
    FEATURE,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    Match,
    Reason,
    Sighting,
)

TRACK, LANDMARK, DEAD = int(FeatureState.TRACK), int(FeatureState.LANDMARK), int(FeatureState.DEAD)
JAMB, NEW, PROVISIONAL = int(CornerKind.JAMB), int(Decision.NEW), int(Decision.PROVISIONAL)


def track_corners(features: FeatureTable, seen: Sighting, room: int, config: TrackConfig) -> tuple[Match, Ints]:
    """The match with an id for every corner that is kept, and the corners (c,) whose track is confirmed now.

    Sightings are counted in `features`; new tracks start in `room`.
    """
    corners, match, T_map_robot = seen.corners, seen.match, seen.belief.T_map_robot
    if NEW in match.decision.tolist():
        marks = corners.z, corners.cov, corners.convex, corners.normals
        track = find_tracks(match.decision, *marks, T_map_robot, features.rows, config.record)
        match = _follow_and_start(features, corners, match, track, room)
    faces, where = (corners.kind, corners.normals), (corners.z, T_map_robot)
    return match, count_sightings(features.rows, match.ids, *faces, *where, config.record, seen.step)


def _follow_and_start(features: FeatureTable, corners: Corners, match: Match, track: Ints, room: int) -> Match:
    """The match in which each NEW corner continues its `track` (n,), or starts a new one in `room` where that is -1."""
    new = match.decision == NEW
    started, follows = np.flatnonzero(new & (track < 0)), np.flatnonzero(new & (track >= 0))
    if len(started):
        rows = np.zeros(len(started), FEATURE)
        rows["state"], rows["room"], rows["normals"] = TRACK, room, math.nan
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
    decision: Ints, z: Array, cov: Array, convex: Bools, normals: Array, T_map_robot: Array, rows: Rows, config: Rows
) -> Ints:
    """(n,) id of the nearest track with the descriptor of each NEW corner, in their order and each once; -1: none.

    The gate is `gate_m` and `gate_sigmas` of the corner's position error, for which the larger of range sigma and arc
    of bearing sigma is an upper bound. z (n,2) and cov (2n,2n) are the measurements, `normals` (n,2) rad is in the
    robot frame.
    """
    limits, heading, count = config[0], T_map_robot[2], z.shape[0]
    p_map, track = to_map(T_map_robot, polar_to_points(z)), np.full(count, -1)
    free = np.empty(rows.shape[0], np.bool_)
    for f in range(rows.shape[0]):
        free[f] = rows[f].state == TRACK
    for i in range(count):
        along, across = cov[2 * i, 2 * i], cov[2 * i + 1, 2 * i + 1] * (z[i, 0] * z[i, 0])
        best = limits.gate_m + limits.gate_sigmas * math.sqrt(max(along, across))
        for f in range(rows.shape[0]):
            if decision[i] != NEW or not free[f] or convex[i] != rows[f].convex:
                continue
            distance = math.hypot(p_map[i, 0] - rows[f].p_map[0], p_map[i, 1] - rows[f].p_map[1])
            if distance <= best and face_turn(normals[i], heading, rows[f].normals) <= limits.descriptor_rad:
                best, track[i] = distance, f
        if track[i] >= 0:
            free[track[i]] = False
    return track


@compiled
def count_sightings(
    rows: Rows, ids: Ints, kind: Ints, normals: Array, z: Array, T_map_robot: Array, config: Rows, step: int
) -> Ints:
    """(c,) the corners whose track has now been seen often enough; `rows` note one sighting of each feature.

    `ids` (n,) are the features of the corners z (n,2), < 0: none; `normals` (n,2) rad are in the robot frame.
    """
    limits, count = config[0], 0
    p_map, confirmed = to_map(T_map_robot, polar_to_points(z)), np.empty(z.shape[0], np.int64)
    for i in range(ids.shape[0]):
        f = ids[i]
        if f < 0:
            continue
        rows[f].seen += 1
        rows[f].last_step = step
        for k in range(2):
            rows[f].p_map[k] = p_map[i, k]
            if math.isnan(rows[f].normals[k]):
                rows[f].normals[k] = normals[i, k] + T_map_robot[2]
        needed = limits.jamb_sightings if kind[i] == JAMB else limits.sightings
        if rows[f].state == TRACK and rows[f].seen >= needed:
            confirmed[count] = i
            count += 1
    return confirmed[:count]


@compiled
def room_unseen_since(ids: Ints, rows: Rows, oldest: int) -> bool:
    """True when of some room among the landmarks `ids` no landmark was seen since the step `oldest`."""
    for i in ids:
        unseen = True
        for f in range(rows.shape[0]):
            if rows[f].room == rows[i].room and rows[f].state == LANDMARK and rows[f].last_step >= oldest:
                unseen = False
                break
        if unseen:
            return True
    return False
