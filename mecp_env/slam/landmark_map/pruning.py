"""Landmark pruning: the laser sees through the place of a landmark, or a straight wall goes on past it.

Differs from the paper: its world is static. A corner of a pedestrian who stood still becomes a landmark like any other;
once the pedestrian has left, beams pass well beyond its place, or the wall behind is seen whole. A landmark with enough
such negative evidence, and not seen again in between, is removed.

Landmark merging: finds two landmarks that are one corner.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from mecp_env.core.arrays import row_of
from mecp_env.core.carriers import Array, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn, wrap_angle
from mecp_env.slam.config import SlamConfig, chi2_of_point
from mecp_env.slam.messages import LANDMARK, Belief, FeatureTable, Match, MergedScan, Segments

SAME_NIS = chi2_of_point(0.95)  # 95 % of the landmarks that are one corner lie inside


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
        if not absent and not is_inside_wall(points, line, x, y, rows[f].normals, heading, slack, limits):
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
    nearest = math.inf
    for k in range(middle - half, middle + half + 1):
        nearest = min(nearest, ranges[k % size])
    return bool(nearest > r + limits.beyond_m + slack)


@compiled
def is_inside_wall(
    points: Array, line: Array, x: float, y: float, normals: Array, heading: float, slack: float, limits: PruneLimits
) -> bool:
    """True when a straight wall is seen on both sides of a corner's place x, y, robot frame, and is one of its faces.

    `normals` (2,) of its faces, map frame: a wall that faces the other way is that of the room behind it.
    """
    for k in range(line.shape[0]):
        off = x * math.cos(line[k, 0]) + y * math.sin(line[k, 0]) - line[k, 1]
        towards = line[k, 0] + math.pi + heading
        first, second = abs(wrap_angle(normals[0] - towards)), abs(wrap_angle(normals[1] - towards))  # nan: unseen
        if abs(off) > 0.5 * limits.beside_m or not (first < limits.facing or second < limits.facing):
            continue
        ux, uy = points[k, 1, 0] - points[k, 0, 0], points[k, 1, 1] - points[k, 0, 1]
        length = math.hypot(ux, uy)
        along = ((x - points[k, 0, 0]) * ux + (y - points[k, 0, 1]) * uy) / length
        if limits.beyond_m + slack < along < length - limits.beyond_m - slack:
            return True
    return False
