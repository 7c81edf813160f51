"""Landmarks that are not there: the laser sees through their place, or a straight wall goes on past it.

Not in the paper, whose world is static: there nothing stands for a while and then goes. A corner of somebody who stood
still becomes a landmark like any other; when he has left, beams pass well beyond its place, or the wall that he stood
against is seen whole. A landmark refuted often enough, and not seen again in between, is forgotten.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import TransientConfig
from mecp_env.slam.messages import Belief, FeatureTable, MergedScan, Segments

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SIGMAS = 2.0
NEAREST_M = 0.4  # what is nearer is looked at too steeply
BESIDE_M, BEYOND_M = 0.12, 0.3  # all beams so near to the landmark's place must pass so far beyond it
LEAST_BEAMS = 4
FACING_RAD = math.radians(30.0)
ON_WALL_M, INSIDE_M = 0.06, 0.35  # a landmark so near to a line, and so far inside it, is none


def refuted(
    beams: MergedScan, segments: Segments, belief: Belief, features: FeatureTable, step: int, config: TransientConfig
) -> Ints:
    """(m,) ids of the landmarks that are refuted often enough in this step; doubts are counted in `features`."""
    if not config.refutations:
        return np.empty(0, np.int64)
    doubtful = np.empty(len(belief.ids), np.int64)
    count = count_doubts(
        (beams.ranges, beams.bearings),
        (segments.points, segments.line),
        (belief.T_map_robot, np.ascontiguousarray(belief.pose_cov), belief.ids, belief.p_map, belief.covs),
        (features.doubts, features.last_step, features.normals),
        (config.most_sigma_m, config.refute_range_m, config.refutations, step),
        doubtful,
    )
    return doubtful[:count]


@compiled
def count_doubts(
    beams: tuple[Array, Array],
    segments: tuple[Array, Array],
    belief: tuple[Array, Array, Ints, Array, Array],
    columns: tuple[Ints, Ints, Array],
    limits: tuple[float, float, int, int],
    doubtful: Ints,
) -> int:
    """Counts one doubt for each landmark refuted by this scan; writes those that have enough to `doubtful` (N,).

    Given are range and bearing of the beams; points (L,2,2) and lines (L,2) of the segments; pose, its covariance, ids,
    means and covariances of the landmarks; doubts, step of the last sighting and normals of the faces, by feature;
    largest sigma (m) and range (m) at which a landmark is judged, how many doubts are enough, and the step.
    """
    pose, pose_cov, ids, p_map, covs = belief
    doubts, last_step, normals = columns
    c, s, count = math.cos(pose[2]), math.sin(pose[2]), 0
    place_var, turn_var = pose_cov[0, 0] + pose_cov[1, 1], pose_cov[2, 2]
    for k in range(ids.shape[0]):
        dx, dy = p_map[k, 0] - pose[0], p_map[k, 1] - pose[1]
        r, f = math.hypot(dx, dy), ids[k]
        sigma = math.sqrt(max(place_var + r * r * turn_var + covs[k, 0, 0] + covs[k, 1, 1], 0.0))
        if last_step[f] == limits[3]:
            doubts[f] = 0
        if last_step[f] == limits[3] or not NEAREST_M < r < limits[1] or sigma > limits[0]:
            continue
        x, y = c * dx + s * dy, c * dy - s * dx
        gone = is_seen_through(beams, r, math.atan2(y, x), SIGMAS * sigma)
        if not gone and not is_inside_wall(segments, (x, y), normals[f], pose[2], SIGMAS * sigma):
            continue
        doubts[f] += 1
        if doubts[f] >= limits[2]:
            doubtful[count] = f
            count += 1
    return count


@compiled
def is_seen_through(beams: tuple[Array, Array], r: float, bearing: float, slack: float) -> bool:
    """True when all beams near a bearing go well beyond the range r."""
    ranges, bearings = beams
    size = ranges.shape[0]
    step = (bearings[size - 1] - bearings[0]) / (size - 1)
    middle = round((bearing - bearings[0]) / step)
    half = int((BESIDE_M + slack) / (r * step)) + 1
    if 2 * half + 1 < LEAST_BEAMS or 2 * half >= size:
        return False
    nearest = math.inf
    for k in range(middle - half, middle + half + 1):
        nearest = min(nearest, ranges[k % size])
    return bool(nearest > r + BEYOND_M + slack)


@compiled
def is_inside_wall(
    segments: tuple[Array, Array], p_robot: tuple[float, float], normals: Array, heading: float, slack: float
) -> bool:
    """True when a straight wall is seen on both sides of a corner's place, robot frame, and is one of its faces.

    `normals` (2,) of its faces, map frame: a wall that looks the other way is that of the room behind it.
    """
    points, line = segments
    x, y = p_robot
    for k in range(line.shape[0]):
        off = x * math.cos(line[k, 0]) + y * math.sin(line[k, 0]) - line[k, 1]
        towards = line[k, 0] + math.pi + heading
        first, second = abs(wrap_angle(normals[0] - towards)), abs(wrap_angle(normals[1] - towards))  # nan: unseen
        if abs(off) > ON_WALL_M or not (first < FACING_RAD or second < FACING_RAD):
            continue
        ux, uy = points[k, 1, 0] - points[k, 0, 0], points[k, 1, 1] - points[k, 0, 1]
        length = math.hypot(ux, uy)
        along = ((x - points[k, 0, 0]) * ux + (y - points[k, 0, 1]) * uy) / length
        if INSIDE_M + slack < along < length - INSIDE_M - slack:
            return True
    return False
