"""Landmarks come and go, and the belief in world coordinates: kernels over `mean` and `cov` of a filter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.filters.error_state import birth_column, change_chart, world_jacobian

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled
def find_slots(slot_ids: Ints, count: int, ids: Ints, slots: Ints) -> bool:
    """Write the slot of each id (m,), -1 where the filter has no such landmark; says whether it has all of them."""
    complete = True
    for k in range(ids.shape[0]):
        slots[k] = slot_of(slot_ids, count, ids[k], k)
        complete = complete and slots[k] >= 0
    return complete


@compiled
def slot_of(slot_ids: Ints, count: int, landmark: int, likely: int) -> int:
    """Slot of one landmark or -1; the slot `likely` is looked at first."""
    if likely < count and slot_ids[likely] == landmark:
        return likely
    for slot in range(count):
        if slot_ids[slot] == landmark:
            return slot
    return -1


@compiled
def append(mean: Array, cov: Array, n: int, z: Array, R: Array, invariant: bool) -> None:
    """Add the landmarks seen at z (m,2) with joint covariance R (2m,2m) behind the n numbers of the state."""
    m = z.shape[0]
    B = np.empty((m, 2, 2))  # Rot(heading) Jz
    for k in range(m):
        c, s = math.cos(mean[0] + z[k, 1]), math.sin(mean[0] + z[k, 1])
        i = n + 2 * k
        mean[i], mean[i + 1] = mean[1] + z[k, 0] * c, mean[2] + z[k, 0] * s
        B[k, 0, 0], B[k, 0, 1], B[k, 1, 0], B[k, 1, 1] = c, -z[k, 0] * s, s, z[k, 0] * c
        tx, ty = birth_column(mean, mean[i], mean[i + 1], invariant)
        for j in range(i):
            cov[i, j] = cov[1, j] + tx * cov[0, j]
            cov[i + 1, j] = cov[2, j] + ty * cov[0, j]
            cov[j, i], cov[j, i + 1] = cov[i, j], cov[i + 1, j]
        for r in range(2):  # Gr P_rr Gr^T: the pose's columns of the new rows are known by now
            cov[i + r, i] = cov[i + r, 1] + tx * cov[i + r, 0]
            cov[i + r, i + 1] = cov[i + r, 2] + ty * cov[i + r, 0]
        cov[i, i + 1] = cov[i + 1, i]
    add_sensor_noise(cov, n, B, R)


@compiled
def add_sensor_noise(cov: Array, n: int, B: Array, R: Array) -> None:
    """P += B R B^T on the block behind the first n numbers, B (m,2,2) block diagonal, R (2m,2m)."""
    size = 2 * B.shape[0]
    for i in range(size):
        a, r = i // 2, i % 2
        for j in range(i + 1):
            b, s = j // 2, j % 2
            first = B[a, r, 0] * R[2 * a, 2 * b] + B[a, r, 1] * R[2 * a + 1, 2 * b]
            second = B[a, r, 0] * R[2 * a, 2 * b + 1] + B[a, r, 1] * R[2 * a + 1, 2 * b + 1]
            cov[n + i, n + j] += first * B[b, s, 0] + second * B[b, s, 1]
            cov[n + j, n + i] = cov[n + i, n + j]


@compiled
def compact(mean: Array, cov: Array, slot_ids: Ints, kept: Ints) -> None:
    """Keep only the landmarks at the ascending slots `kept` (m,), in their order."""
    m = kept.shape[0]
    rows = np.empty(3 + 2 * m, np.int64)
    for i in range(3):
        rows[i] = i
    for k in range(m):
        rows[3 + 2 * k], rows[4 + 2 * k] = 3 + 2 * kept[k], 4 + 2 * kept[k]
        slot_ids[k] = slot_ids[kept[k]]
    for i in range(rows.shape[0]):
        mean[i] = mean[rows[i]]
        for j in range(rows.shape[0]):
            cov[i, j] = cov[rows[i], rows[j]]


@compiled
def take(mean: Array, cov: Array, slots: Ints) -> tuple[Array, Array]:
    """Mean (3+2m,) and covariance of the pose and the landmarks at `slots` (m,), in the filter's own order."""
    size = 3 + 2 * slots.shape[0]
    rows = np.arange(size)
    for k in range(slots.shape[0]):
        rows[3 + 2 * k], rows[4 + 2 * k] = 3 + 2 * slots[k], 4 + 2 * slots[k]
    part, block = np.empty(size), np.empty((size, size))
    for i in range(size):
        part[i] = mean[rows[i]]
        for j in range(size):
            block[i, j] = cov[rows[i], rows[j]]
    return part, block


@compiled
def world_marginal(mean: Array, cov: Array, slots: Ints, invariant: bool) -> tuple[Array, Array]:
    """As `take`, but x, y, heading, then the landmarks, and the covariance of world coordinates: T P T^T."""
    part, block = take(mean, cov, slots)
    size = part.shape[0]
    change_chart(block, size, world_jacobian(part, size, invariant))
    order = np.arange(size)
    order[0], order[1], order[2] = 1, 2, 0
    world_mean, world_cov = np.empty(size), np.empty((size, size))
    for i in range(size):
        world_mean[i] = part[order[i]]
        for j in range(size):
            world_cov[i, j] = block[order[i], order[j]]
    return world_mean, world_cov


@compiled
def world_belief(
    mean: Array, cov: Array, invariant: bool, pose: Array, pose_cov: Array, p_map: Array, covs: Array
) -> None:
    """Write, in the world, pose (3,) and its covariance (3,3), means (N,2) and own covariances (N,2,2) of landmarks."""
    world_pose(mean, cov, invariant, pose, pose_cov)
    for k in range(p_map.shape[0]):
        i = 3 + 2 * k
        p_map[k, 0], p_map[k, 1] = mean[i], mean[i + 1]
        tx, ty = (-mean[i + 1], mean[i]) if invariant else (0.0, 0.0)
        covs[k, 0, 0] = cov[i, i] + 2.0 * tx * cov[0, i] + tx * tx * cov[0, 0]
        covs[k, 1, 0] = cov[i + 1, i] + tx * cov[0, i + 1] + ty * cov[0, i] + tx * ty * cov[0, 0]
        covs[k, 1, 1] = cov[i + 1, i + 1] + 2.0 * ty * cov[0, i + 1] + ty * ty * cov[0, 0]
        covs[k, 0, 1] = covs[k, 1, 0]


@compiled
def world_pose(mean: Array, cov: Array, invariant: bool, pose: Array, pose_cov: Array) -> None:
    """Write x, y, heading (3,) and their covariance (3,3)."""
    block = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            block[i, j] = cov[i, j]
    change_chart(block, 3, world_jacobian(mean, 3, invariant))
    for i in range(3):
        pose[i] = mean[(i + 1) % 3]
        for j in range(3):
            pose_cov[i, j] = block[(i + 1) % 3, (j + 1) % 3]


@compiled
def pin_pose(mean: Array, cov: Array, n: int, pose: Array, var: float, invariant: bool) -> None:
    """Set the pose (x, y, heading) with variance `var`, independent of the map, whose world covariance stays."""
    change_chart(cov, n, world_jacobian(mean, n, invariant))
    mean[0], mean[1], mean[2] = pose[2], pose[0], pose[1]
    for i in range(3):
        for j in range(n):
            cov[i, j] = 0.0
            cov[j, i] = 0.0
        cov[i, i] = var
    change_chart(cov, n, -world_jacobian(mean, n, invariant))
