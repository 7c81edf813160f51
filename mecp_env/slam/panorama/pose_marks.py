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
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import block_of, sandwich
from mecp_env.core.se2 import inverse, wrap_angle
from mecp_env.slam.protocols import Filter

LEVER_M = 10.0  # of a mark from its pose: a range and a bearing are nearly linear at this distance
RIGID_SIGMA_M = 1e-4 * LEVER_M  # of the marks in the frame of their pose: measurements of them stay invertible


@compiled
def seen_from(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """T_now_past (3,) and its covariance (3,3), from T_past_now (3,) and that of it."""
    T_now_past, J = inverse(T_past_now), np.zeros((3, 3))
    c, s = math.cos(T_now_past[2]), math.sin(T_now_past[2])
    J[0, 0], J[0, 1], J[0, 2] = -c, s, T_now_past[1]
    J[1, 0], J[1, 1], J[1, 2] = -s, -c, -T_now_past[0]
    J[2, 2] = -1.0
    return T_now_past, sandwich(J, cov)


@compiled
def marks_seen(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """z (2,2) and R (4,4) of the two marks of a past pose, seen from a pose T_past_now with a covariance (3,3)."""
    T_now_past, spread = seen_from(T_past_now, cov)
    z, J = np.empty((2, 2)), np.empty((4, 3))
    for k in range(2):
        lever = LEVER_M - 2.0 * LEVER_M * k  # ahead, then behind
        dx, dy = lever * math.cos(T_now_past[2]), lever * math.sin(T_now_past[2])
        x, y = T_now_past[0] + dx, T_now_past[1] + dy
        r = math.hypot(x, y)
        z[k, 0], z[k, 1] = r, math.atan2(y, x)
        for row, (u, v) in enumerate(((x / r, y / r), (-y / r**2, x / r**2))):
            J[2 * k + row, 0], J[2 * k + row, 1], J[2 * k + row, 2] = u, v, v * dx - u * dy
    R = sandwich(J, spread)
    for k in range(2):
        R[2 * k, 2 * k] += RIGID_SIGMA_M**2
        R[2 * k + 1, 2 * k + 1] += (RIGID_SIGMA_M / LEVER_M) ** 2
    return z, R


def poses_since(landmark_filter: Filter, ids: Ints) -> tuple[Array, Array]:
    """T_past_now (w,3) since each of w past poses, and its covariance (w,3,3); `ids` (w,2) are those of the marks."""
    poses, covs = poses_of_marks(*landmark_filter.marginal(ids.ravel()))
    return poses, covs


@compiled
def poses_of_marks(mean: Array, cov: Array) -> tuple[Array, Array]:
    """T_past_now (w,3) and covariances (w,3,3), from mean (3+4w,) and covariance of the pose and of two marks each."""
    count = (mean.shape[0] - 3) // 4
    poses, covs, J = np.empty((count, 3)), np.empty((count, 3, 3)), np.zeros((3, 7))
    rows = np.arange(7)
    for k in range(count):
        at = 3 + 4 * k
        axis_x, axis_y = mean[at] - mean[at + 2], mean[at + 1] - mean[at + 3]
        heading, square = math.atan2(axis_y, axis_x), axis_x * axis_x + axis_y * axis_y
        c, s = math.cos(heading), math.sin(heading)
        dx, dy = mean[0] - 0.5 * (mean[at] + mean[at + 2]), mean[1] - 0.5 * (mean[at + 1] + mean[at + 3])
        x, y = c * dx + s * dy, c * dy - s * dx
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, wrap_angle(mean[2] - heading)
        J[0, 0], J[0, 1], J[1, 0], J[1, 1], J[2, 2] = c, s, -s, c, 1.0
        for mark in range(2):  # the first is ahead of the past pose: its heading, and half of its place
            side = 1.0 - 2.0 * mark
            for i, by_heading in enumerate((y, -x, -1.0)):
                J[i, 3 + 2 * mark] = -side * axis_y / square * by_heading
                J[i, 4 + 2 * mark] = side * axis_x / square * by_heading
            for i in range(2):
                for j in range(2):
                    J[i, 3 + 2 * mark + j] -= 0.5 * J[i, j]
        for i in range(4):
            rows[3 + i] = at + i
        covs[k] = sandwich(J, block_of(cov, rows, rows))
    return poses, covs
