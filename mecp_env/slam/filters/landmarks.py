"""Landmarks are added, and part of the state is taken out: compiled functions over the state of a filter.

`state` (1+C,C): the mean in its first row, the covariance below; the leading n numbers are in use. One array is one
argument, and half the cost of two.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.slam.filters.error_state import change_chart
from mecp_env.slam.messages import NO_ID


@compiled
def append(state: Array, n: int, z: Array, R: Array, invariant: bool) -> None:
    """Add the landmarks seen at z (m,2) with joint covariance R (2m,2m) behind the n numbers of the state."""
    m, mean, cov = z.shape[0], state[0], state[1:]
    B = np.empty((m, 2, 2))  # Rot(heading) Jz
    for k in range(m):
        c, s = math.cos(mean[0] + z[k, 1]), math.sin(mean[0] + z[k, 1])
        i = n + 2 * k
        mean[i], mean[i + 1] = mean[1] + z[k, 0] * c, mean[2] + z[k, 0] * s
        B[k, 0, 0], B[k, 0, 1], B[k, 1, 0], B[k, 1, 1] = c, -z[k, 0] * s, s, z[k, 0] * c
        tx, ty = 0.0, 0.0  # derivative by the heading: J (l - p), or zero for the invariant error
        if not invariant:
            tx, ty = mean[2] - mean[i + 1], mean[i] - mean[1]
        for j in range(i):
            cov[i, j] = cov[1, j] + tx * cov[0, j]
            cov[i + 1, j] = cov[2, j] + ty * cov[0, j]
            cov[j, i], cov[j, i + 1] = cov[i, j], cov[i + 1, j]
        for r in range(2):  # Gr P_rr Gr^T: the pose's columns of the new rows are known by now
            cov[i + r, i] = cov[i + r, 1] + tx * cov[i + r, 0]
            cov[i + r, i + 1] = cov[i + r, 2] + ty * cov[i + r, 0]
        cov[i, i + 1] = cov[i + 1, i]
    for i in range(2 * m):  # + B R B^T
        a, r = i // 2, i % 2
        for j in range(i + 1):
            b, s_ = j // 2, j % 2
            first = B[a, r, 0] * R[2 * a, 2 * b] + B[a, r, 1] * R[2 * a + 1, 2 * b]
            second = B[a, r, 0] * R[2 * a, 2 * b + 1] + B[a, r, 1] * R[2 * a + 1, 2 * b + 1]
            cov[n + i, n + j] += first * B[b, s_, 0] + second * B[b, s_, 1]
            cov[n + j, n + i] = cov[n + i, n + j]


@compiled
def take(state: Array, slots: Ints) -> Array:
    """The state (1+s,s) of the pose and the landmarks at `slots` (m,), s = 3 + 2m, in the filter's own order."""
    size = 3 + 2 * slots.shape[0]
    rows = np.arange(size)
    for k in range(slots.shape[0]):
        rows[3 + 2 * k], rows[4 + 2 * k] = 3 + 2 * slots[k], 4 + 2 * slots[k]
    part = np.empty((1 + size, size))
    for i in range(size):
        part[0, i] = state[0, rows[i]]
        for j in range(size):
            part[1 + i, j] = state[1 + rows[i], rows[j]]
    return part


@compiled
def world_belief(
    state: Array, slot_ids: Ints, invariant: bool, pose: Array, pose_cov: Array, p_map: Array, covs: Array
) -> bool:
    """Write, in the world, pose (3,) and its covariance (3,3), means (N,2) and own covariances (N,2,2) of landmarks.

    True when there are marks of past poses among them.
    """
    mean, cov, marked = state[0], state[1:], False
    block = state[:4, :3].copy()
    change_chart(block, 3, 1.0, invariant)
    for i in range(3):
        pose[i] = mean[(i + 1) % 3]
        for j in range(3):
            pose_cov[i, j] = block[1 + (i + 1) % 3, (j + 1) % 3]
    for k in range(p_map.shape[0]):
        i = 3 + 2 * k
        p_map[k, 0], p_map[k, 1] = mean[i], mean[i + 1]
        tx, ty = (-mean[i + 1], mean[i]) if invariant else (0.0, 0.0)
        covs[k, 0, 0] = cov[i, i] + 2.0 * tx * cov[0, i] + tx * tx * cov[0, 0]
        covs[k, 1, 0] = cov[i + 1, i] + tx * cov[0, i + 1] + ty * cov[0, i] + tx * ty * cov[0, 0]
        covs[k, 1, 1] = cov[i + 1, i + 1] + 2.0 * ty * cov[0, i + 1] + ty * ty * cov[0, 0]
        covs[k, 0, 1] = covs[k, 1, 0]
        marked |= slot_ids[k] < NO_ID
    return marked
