"""A past pose of the laser in the state of a filter: two points fixed to it, ahead of it and behind it.

To the filter, the points are landmarks that no corner is ever matched to. Their ids are below `NO_ID`, and a belief
leaves them out. By its two marks, a past pose has the exact covariance of the filter with the present pose and the map
(a stochastic clone), and a scan registered with a past one is an observation of two points.

Poses are T_past_now (3,): x, y, heading of the present pose in the frame of the past one.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.se2 import inverse, wrap_angle
from mecp_env.slam.protocols import Filter

LEVER_M = 10.0  # of a mark from its pose: a range and a bearing are nearly linear at this distance
RIGID_SIGMA_M = 1e-4 * LEVER_M  # of the marks in the frame of their pose: measurements of them stay invertible
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # by 90 degrees


def seen_from(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """T_now_past (3,) and its covariance (3,3), from T_past_now (3,) and that of it."""
    T_now_past = inverse(T_past_now)
    c, s = math.cos(T_now_past[2]), math.sin(T_now_past[2])
    J = np.array([[-c, s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]])
    J[:2, 2] = -TURN @ T_now_past[:2]
    return T_now_past, J @ cov @ J.T


def marks_seen(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """z (2,2) and R (4,4) of the two marks of a past pose, seen from a pose T_past_now with a covariance (3,3)."""
    T_now_past, spread = seen_from(T_past_now, cov)
    axis = LEVER_M * np.array([math.cos(T_now_past[2]), math.sin(T_now_past[2])])
    z, J = np.empty((2, 2)), np.empty((4, 3))
    for k, ahead in enumerate((axis, -axis)):
        p = T_now_past[:2] + ahead
        r = math.hypot(*p)
        z[k] = r, math.atan2(p[1], p[0])
        by_point = np.array([p / r, TURN @ p / r**2])
        J[2 * k : 2 * k + 2] = by_point @ np.column_stack((np.eye(2), TURN @ ahead))
    rigid = np.array([RIGID_SIGMA_M, RIGID_SIGMA_M / LEVER_M] * 2) ** 2
    return z, J @ spread @ J.T + np.diag(rigid)


def poses_since(landmark_filter: Filter, ids: Ints) -> tuple[Array, Array]:
    """T_past_now (w,3) since each of w past poses, and its covariance (w,3,3); `ids` (w,2) are those of the marks."""
    mean, cov = landmark_filter.marginal(ids.ravel())
    found = [_pose_since(mean, cov, 3 + 4 * k) for k in range(len(ids))]
    return np.array([pose for pose, _ in found]), np.array([spread for _, spread in found])


def _pose_since(mean: Array, cov: Array, at: int) -> tuple[Array, Array]:
    """T_past_now and its covariance from those of the pose and of two marks, the first of which begins at `at`."""
    ahead, behind = mean[at : at + 2], mean[at + 2 : at + 4]
    middle, axis = 0.5 * (ahead + behind), ahead - behind
    heading, length = math.atan2(axis[1], axis[0]), math.hypot(*axis)
    c, s = math.cos(heading), math.sin(heading)
    to_past = np.array([[c, s], [-s, c]])
    moved = to_past @ (mean[:2] - middle)
    by_heading = np.append(-TURN @ moved, -1.0)  # of the past pose
    heading_by_ahead = TURN @ axis / length**2
    J = np.zeros((3, 7))
    J[:2, :2], J[2, 2] = to_past, 1.0
    for column, side in ((3, 1.0), (5, -1.0)):
        J[:2, column : column + 2] = -0.5 * to_past
        J[:, column : column + 2] += side * np.outer(by_heading, heading_by_ahead)
    rows = np.r_[0:3, at : at + 4]
    return np.array([*moved, wrap_angle(mean[2] - heading)]), J @ cov[np.ix_(rows, rows)] @ J.T
