"""Tracks become landmarks when a corner is seen often enough; what the laser sees through is pruned.

Differs from the paper: its world is static. A corner of a pedestrian who stood still becomes a landmark like any other;
once the pedestrian has left, beams pass well beyond its place, or the wall behind is seen whole. A landmark with enough
such negative evidence, and not seen again in between, is removed.

Landmark merging: finds two landmarks that are one corner.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn, polar_to_points, to_map, wrap_angle
from mecp_env.slam.config import SlamConfig, TrackConfig, chi2_of_point
from mecp_env.slam.messages import (
    FEATURE,
    LANDMARK,
    UNKNOWN_ROOM,
    Belief,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    Match,
    MergedScan,
    Reason,
    RoomGraph,
    Segments,
    Sighting,
    row_of,
)

TRACK, MAPPED, DEAD = int(FeatureState.TRACK), int(FeatureState.LANDMARK), int(FeatureState.DEAD)
JAMB = int(CornerKind.JAMB)
NEW, PROVISIONAL = int(Decision.NEW), int(Decision.PROVISIONAL)
SAME_NIS = chi2_of_point(0.95)  # 95 % of the landmarks that are one corner lie inside


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
    rows = features.rows
    lost = (rows["state"] == TRACK) & (rows["last_step"] < step - config.window_steps)
    if not lost.any():
        return False
    rows["state"][lost] = DEAD
    return True


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
        landmarks += f >= 0 and rows[f].state == MAPPED and not (wide and rows[f].kind == JAMB)
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


def find_duplicate(features: FeatureTable, belief: Belief, match: Match, config: SlamConfig) -> tuple[int, int] | None:
    """Ids (older, younger) of a landmark matched in this scan and another that is the same corner, or None.

    They have one descriptor, are not both seen in this scan, are nearer than two corners of a scan and within the 95 %
    gate of the sum of their covariances: correlated errors only make the true gate narrower, so nothing apart is
    merged.
    """
    landmarks = belief.ids, belief.p_map, belief.covs
    gate = config.corners.detail_m, SAME_NIS, config.association.face_turn_rad
    older, younger = find_same_corner(match.ids, match.decision, *landmarks, features.rows, gate)
    return None if older < 0 else (older, younger)


@compiled
def find_same_corner(
    matched: Ints,
    decision: Ints,
    ids: Ints,
    p_map: Array,
    covs: Array,
    rows: Rows,
    gate: tuple[float, float, float],
) -> tuple[int, int]:
    """Ids, in order, of the first landmark seen and another not seen that are one corner, or (-1, -1).

    `matched` (n,) and `decision` (n,) are of the corners of the scan, `ids` (N,), `p_map` (N,2) and `covs` (N,2,2) of
    the landmarks; `gate` is in m, NIS and rad that a face may turn.
    """
    (near_m, nis, turn), seen = gate, np.zeros(ids.shape[0], np.bool_)
    for c in range(matched.shape[0]):
        row = row_of(ids, matched[c]) if decision[c] == LANDMARK else -1
        if row >= 0:
            seen[row] = True
    for i in range(seen.shape[0]):
        for j in range(seen.shape[0] if seen[i] else 0):
            x, y = p_map[i, 0] - p_map[j, 0], p_map[i, 1] - p_map[j, 1]
            if seen[j] or abs(x) > near_m or abs(y) > near_m or math.hypot(x, y) > near_m:
                continue
            a, b, c_yy = covs[i, 0, 0] + covs[j, 0, 0], covs[i, 0, 1] + covs[j, 0, 1], covs[i, 1, 1] + covs[j, 1, 1]
            if not (c_yy * x * x - 2.0 * b * x * y + a * y * y) < nis * (a * c_yy - b * b):
                continue
            one, two = rows[ids[i]], rows[ids[j]]
            if one.convex == two.convex and 0.0 <= face_turn(one.normals, 0.0, two.normals) <= turn:
                return min(ids[i], ids[j]), max(ids[i], ids[j])
    return -1, -1


class PruneLimits(NamedTuple):
    """When a scan speaks against a landmark, and how many do."""

    scans: int  # that speak against it, as many as make a landmark
    range_m: float  # of the landmark, at most
    sigmas: float  # of its place in the scan, by which all distances grow
    beside_m: float  # beams this near to its place, and a wall, pass it
    beyond_m: float  # this far
    facing: float  # rad, by which the wall may be turned from a face of it

    @classmethod
    def of(cls, config: SlamConfig) -> Self:
        """The limits that a configuration implies."""
        of_beams = config.tracks.sightings, config.grid.paint_range_m, config.sensor.noise_sigmas
        return cls(*of_beams, config.corners.line_m, config.dynamic_objects.beyond_m, config.association.face_turn_rad)


def find_pruned(
    beams: MergedScan,
    segments: Segments,
    belief: Belief,
    features: FeatureTable,
    step: int,
    limits: PruneLimits,
) -> Ints:
    """(m,) ids of the landmarks with enough negative evidence; that of this scan is counted in `features`."""
    scan = beams.ranges, beams.bearings, beams.blind, segments.points, segments.line
    landmarks = belief.ids, belief.p_map, belief.covs
    pose = belief.T_map_robot, np.ascontiguousarray(belief.pose_cov)
    return count_doubts(scan, pose, landmarks, features.rows, limits, step)


@compiled
def count_doubts(
    scan: tuple[Array, Array, bool, Array, Array],
    pose: tuple[Array, Array],
    landmarks: tuple[Ints, Array, Array],
    rows: Rows,
    limits: PruneLimits,
    step: int,
) -> Ints:
    """(m,) ids of the landmarks with enough doubts, after one more for each that this scan speaks against.

    `scan` is range and bearing of the beams, whether they have a blind side, points (L,2,2) and lines (L,2) of the
    segments; `pose` is the robot's with its covariance, `landmarks` are ids, means and covariances.
    """
    (ranges, bearings, blind, points, line), (T_map_robot, pose_cov), (ids, p_map, covs) = scan, pose, landmarks
    gone = np.empty(ids.shape[0], np.int64)
    c, s, count = math.cos(T_map_robot[2]), math.sin(T_map_robot[2]), 0
    place_var, turn_var = pose_cov[0, 0] + pose_cov[1, 1], pose_cov[2, 2]
    across = np.empty((2, line.shape[0]))  # unit normals of the walls
    for k in range(line.shape[0]):
        across[0, k], across[1, k] = math.cos(line[k, 0]), math.sin(line[k, 0])
    walls = points, line, across
    for k in range(ids.shape[0]):
        dx, dy = p_map[k, 0] - T_map_robot[0], p_map[k, 1] - T_map_robot[1]
        r, f = math.hypot(dx, dy), ids[k]
        sigma = math.sqrt(max(place_var + r * r * turn_var + covs[k, 0, 0] + covs[k, 1, 1], 0.0))
        if rows[f].last_step == step:
            rows[f].doubts = 0
        if rows[f].last_step == step or not 0.0 < r < limits.range_m:
            continue
        x, y = c * dx + s * dy, c * dy - s * dx
        slack, heading = limits.sigmas * sigma, T_map_robot[2]
        absent = is_seen_through((ranges, bearings, blind), r, math.atan2(y, x), slack, limits)
        if not absent and not is_inside_wall(walls, x, y, rows[f].normals, heading, slack, limits):
            continue
        rows[f].doubts += 1
        if rows[f].doubts >= limits.scans:
            gone[count] = f
            count += 1
    return gone[:count]


@compiled
def is_seen_through(
    beams: tuple[Array, Array, bool], r: float, bearing: float, slack: float, limits: PruneLimits
) -> bool:
    """True when all beams near a bearing go well beyond the range r; False where some of them would be out of view."""
    (ranges, bearings, blind), size = beams, beams[0].shape[0]
    step = (bearings[size - 1] - bearings[0]) / (size - 1)
    middle = round((bearing - bearings[0]) / step)
    half = int((limits.beside_m + slack) / (r * step)) + 1
    if 2 * half >= size:
        return False
    if blind and not half <= middle < size - half:
        return False
    nearest, k = math.inf, (middle - half) % size
    for _ in range(2 * half + 1):
        nearest, k = min(nearest, ranges[k]), k + 1 if k + 1 < size else 0
    return bool(nearest > r + limits.beyond_m + slack)


@compiled
def is_inside_wall(
    walls: tuple[Array, Array, Array],
    x: float,
    y: float,
    normals: Array,
    heading: float,
    slack: float,
    limits: PruneLimits,
) -> bool:
    """True when a straight wall is seen on both sides of a corner's place x, y, robot frame, and is one of its faces.

    `walls` are points (L,2,2), lines (L,2) and normals (2,L) of the segments; `normals` (2,) those of the corner's
    faces, map frame: a wall that faces the other way is that of the room behind it.
    """
    points, line, across = walls
    for k in range(line.shape[0]):
        if abs(x * across[0, k] + y * across[1, k] - line[k, 1]) > 0.5 * limits.beside_m:
            continue
        towards = line[k, 0] + math.pi + heading
        first, second = abs(wrap_angle(normals[0] - towards)), abs(wrap_angle(normals[1] - towards))  # nan: unseen
        if not (first < limits.facing or second < limits.facing):
            continue
        ux, uy = points[k, 1, 0] - points[k, 0, 0], points[k, 1, 1] - points[k, 0, 1]
        length = math.hypot(ux, uy)
        along = ((x - points[k, 0, 0]) * ux + (y - points[k, 0, 1]) * uy) / length
        if limits.beyond_m + slack < along < length - limits.beyond_m - slack:
            return True
    return False
