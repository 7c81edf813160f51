"""The sparse products of a batch of range and bearing measurements: a row of H has a pose and one landmark."""

from __future__ import annotations

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.arrays import find_rows
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import wide
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.filters.error_state import linearise


@compiled
def residual(z: Array, h: Array, A: Array, a_heading: Array, slots: Ints, xi: Array, nu: Array) -> None:
    """Write nu (2m,) = z - h + H xi, bearings wrapped: the innovation, referred to xi = 0."""
    for k in range(slots.shape[0]):
        i = 3 + 2 * slots[k]
        ex, ey = xi[i] - xi[1], xi[i + 1] - xi[2]
        nu[2 * k] = z[k, 0] - h[k, 0] + A[k, 0, 0] * ex + A[k, 0, 1] * ey + a_heading[k, 0] * xi[0]
        bearing = wrap_angle(z[k, 1] - h[k, 1])
        nu[2 * k + 1] = bearing + A[k, 1, 0] * ex + A[k, 1, 1] * ey + a_heading[k, 1] * xi[0]


@compiled
def project(cov: Array, n: int, A: Array, a_heading: Array, slots: Ints) -> Array:
    """H P (2m,w) from rows of the symmetric P: n columns, and zeros up to the width that `downdate` likes."""
    m = slots.shape[0]
    HP = np.zeros((2 * m, wide(n)))
    turn, px, py = cov[0, :n], cov[1, :n], cov[2, :n]
    for k in range(m):
        lx, ly = cov[3 + 2 * slots[k], :n], cov[4 + 2 * slots[k], :n]
        for r in range(2):
            row, ax, ay, at = HP[2 * k + r, :n], A[k, r, 0], A[k, r, 1], a_heading[k, r]
            for j in range(row.shape[0]):
                row[j] = ax * (lx[j] - px[j]) + ay * (ly[j] - py[j]) + at * turn[j]
    return HP


@compiled
def innovation_cov(HP: Array, A: Array, a_heading: Array, slots: Ints, R: Array, S: Array) -> None:
    """Write S (2m,2m) = H P H^T + R, symmetric to the bit."""
    m = slots.shape[0]
    for b in range(m):
        i = 3 + 2 * slots[b]
        for s in range(2):
            ax, ay, at = A[b, s, 0], A[b, s, 1], a_heading[b, s]
            for a in range(2 * b + s, 2 * m):
                total = ax * (HP[a, i] - HP[a, 1]) + ay * (HP[a, i + 1] - HP[a, 2]) + at * HP[a, 0]
                S[a, 2 * b + s] = total + R[a, 2 * b + s]
                S[2 * b + s, a] = S[a, 2 * b + s]


@compiled
def innovation(
    state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, nu: Array, S: Array
) -> bool:
    """Write nu (2m,) and S (2m,2m) of z (m,2) against the landmarks `ids`, all cross terms; False: an unknown id."""
    m, n = ids.shape[0], 3 + 2 * slot_ids.shape[0]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_rows(slot_ids, ids, slots):
        return False
    linearise(state[0], slots, invariant, h, A, a_heading)
    residual(z, h, A, a_heading, slots, np.zeros(n), nu)
    innovation_cov(project(state[1:], n, A, a_heading, slots), A, a_heading, slots, R, S)
    return True
