"""Compiled functions of the models of motion and measurement, and of their errors about the estimate.

Everything by which the two filters differ: what "error of the state" means, and what follows from it.

State, inside the filters only: `mean` (n,) = heading, x, y, l1x, l1y, ...; `xi` (n,) is its error in the same order.
  invariant: x_true = exp(xi) x on SE_{N+1}(2), the right-invariant error (Barrau and Bonnabel, "An EKF-SLAM algorithm
             with consistency properties", 2015);
  else:      x_true = x + xi, the plain error of the paper's EKF.

Dead reckoning of one control step: the new pose and the noise it picked up (derivations 4: u and L).

The sparse products of a batch of range and bearing measurements: a row of H has a pose and one landmark.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import mirror_lower, wide
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.messages import find_rows


@compiled
def left_jacobian(t: float) -> tuple[float, float]:
    """a, b of V(t) = [[a, -b], [b, a]]: sin t / t and (1 - cos t) / t."""
    if abs(t) < 1e-2:
        u = t * t
        return 1.0 - u / 6.0 + u * u / 120.0, t * (0.5 - u / 24.0 + u * u / 720.0)
    return math.sin(t) / t, 2.0 * math.sin(0.5 * t) ** 2 / t


@compiled
def retract(mean: Array, n: int, xi: Array, invariant: bool) -> None:
    """Replace the leading n numbers of `mean` by the state whose error was xi (n,)."""
    heading = wrap_angle(mean[0] + xi[0])
    if invariant:
        c, s = math.cos(xi[0]), math.sin(xi[0])
        a, b = left_jacobian(xi[0])
        for i in range(1, n, 2):  # position and landmarks alike
            x, y = mean[i], mean[i + 1]
            mean[i] = c * x - s * y + a * xi[i] - b * xi[i + 1]
            mean[i + 1] = s * x + c * y + b * xi[i] + a * xi[i + 1]
    else:
        for i in range(1, n):
            mean[i] += xi[i]
    mean[0] = heading


@compiled
def linearise(mean: Array, slots: Ints, invariant: bool, h: Array, A: Array, a_heading: Array) -> None:
    """Predict range and bearing of the landmarks at `slots` (m,), and their Jacobian by the error of the state.

    Writes h (m,2); A (m,2,2): by the landmark (and, negated, by the position); a_heading (m,2): by the heading, zero
    for the invariant error, so that the unobservable directions never change.
    """
    c, s = math.cos(mean[0]), math.sin(mean[0])
    for k in range(slots.shape[0]):
        i = 3 + 2 * slots[k]
        dx, dy = mean[i] - mean[1], mean[i + 1] - mean[2]
        r2 = dx * dx + dy * dy
        r = math.sqrt(r2)
        h[k, 0] = r
        h[k, 1] = math.atan2(-s * dx + c * dy, c * dx + s * dy)
        A[k, 0, 0], A[k, 0, 1], A[k, 1, 0], A[k, 1, 1] = dx / r, dy / r, -dy / r2, dx / r2
        a_heading[k, 0], a_heading[k, 1] = 0.0, 0.0 if invariant else -1.0


@compiled
def propagate_invariant(state: Array, n: int, N: Array) -> None:
    """P += G N G^T for pose noise N (3,3) (heading, x, y in the world, at the new pose); F is the identity.

    The error of the map turns with the heading: xi_p = dp - J p dtheta, xi_l = -J l dtheta, so every block gets some.
    """
    mean, cov = state[0], state[1:]
    px, py = mean[1], mean[2]
    G = np.array([[1.0, 0.0, 0.0], [py, 1.0, 0.0], [-px, 0.0, 1.0]])
    GN = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            GN[i, j] = G[i, 0] * N[0, j] + G[i, 1] * N[1, j] + G[i, 2] * N[2, j]
    for i in range(3):
        for j in range(i + 1):
            cov[i, j] += GN[i, 0] * G[j, 0] + GN[i, 1] * G[j, 1] + GN[i, 2] * G[j, 2]
            cov[j, i] = cov[i, j]
    turn = np.empty(n)
    for i in range(3, n, 2):
        turn[i], turn[i + 1] = mean[i + 1], -mean[i]
    for i in range(3):
        for j in range(3, n):
            cov[i, j] += GN[i, 0] * turn[j]
            cov[j, i] = cov[i, j]
    tail = turn[3:n]
    for i in range(3, n):  # the landmarks' block, the same bits on both sides of the diagonal
        row, v_i = cov[i, 3:n], turn[i]
        for j in range(row.shape[0]):
            row[j] += N[0, 0] * (v_i * tail[j])


@compiled
def propagate_plain(state: Array, n: int, moved: Array, N: Array) -> None:
    """P_rr = F P_rr F^T + N, P_rl = F P_rl with F = [[1, 0], [J (p' - p), I]]; `moved` (2,) is p' - p, N (3,3)."""
    cov, fx, fy = state[1:], -moved[1], moved[0]
    for j in range(n):
        cov[1, j] += fx * cov[0, j]
        cov[2, j] += fy * cov[0, j]
    for i in range(3):
        cov[i, 1] += fx * cov[i, 0]
        cov[i, 2] += fy * cov[i, 0]
    for i in range(3):
        for j in range(i + 1):
            cov[i, j] += N[i, j]
            cov[j, i] = cov[i, j]
        for j in range(3, n):
            cov[j, i] = cov[i, j]


@compiled
def change_chart(state: Array, n: int, sign: float, invariant: bool) -> None:
    """P := T P T^T on the leading n numbers: `sign` 1.0 to the covariance of world coordinates, -1.0 back.

    T is the Jacobian d(heading, p, l_1, ...) / d xi: the identity, and for the invariant error J p, J l_i in the
    heading's column.
    """
    mean, cov, column = state[0], state[1:], np.zeros(n)
    if invariant:
        for i in range(1, n, 2):
            column[i], column[i + 1] = -sign * mean[i + 1], sign * mean[i]
    top = cov[0, :n].copy()
    for i in range(1, n):
        row, factor = cov[i, : i + 1], column[i]
        first = row[0] + factor * top[0]  # heading's column of T P
        for j in range(row.shape[0]):
            row[j] += factor * top[j] + column[j] * first
    mirror_lower(cov, n)


@compiled
def predict(
    state: Array, n: int, increments: Array, covs: Array, lateral_var: float, heading_var: float, invariant: bool
) -> None:
    """Move the pose along the arcs and carry the covariance of the n numbers with it; in place.

    increments (M,2): distance and turn; covs (M,2,2); lateral_var (m^2) and heading_var (rad^2) are for the whole
    step (slip at a contact) and spread evenly over the arcs.
    """
    M, mean, moved = increments.shape[0], state[0], state[0, 1:3].copy()
    N = np.zeros((3, 3))  # noise of (heading, x, y) in the world at the end of the arcs so far
    G = np.zeros((3, 2))
    G[0, 1] = 1.0
    for k in range(M):
        d, turn = increments[k, 0], increments[k, 1]
        c, s = math.cos(mean[0] + 0.5 * turn), math.sin(mean[0] + 0.5 * turn)
        fx, fy = -d * s, d * c  # N := F N F^T with F = [[1, 0, 0], [fx, 1, 0], [fy, 0, 1]], (fx, fy) = J (p' - p)
        N[1, 1] += 2.0 * fx * N[1, 0] + fx * fx * N[0, 0]
        N[2, 2] += 2.0 * fy * N[2, 0] + fy * fy * N[0, 0]
        N[2, 1] += fx * N[2, 0] + fy * N[1, 0] + fx * fy * N[0, 0]
        N[1, 0] += fx * N[0, 0]
        N[2, 0] += fy * N[0, 0]
        N[0, 1], N[0, 2], N[1, 2] = N[1, 0], N[2, 0], N[2, 1]
        G[1, 0], G[2, 0] = c, s
        G[1, 1], G[2, 1] = -0.5 * d * s, 0.5 * d * c
        q_dd, q_dw, q_ww = covs[k, 0, 0], covs[k, 1, 0], covs[k, 1, 1] + heading_var / M
        for i in range(3):  # N += G Q G^T
            gq_d, gq_w = G[i, 0] * q_dd + G[i, 1] * q_dw, G[i, 0] * q_dw + G[i, 1] * q_ww
            for j in range(i + 1):
                N[i, j] += gq_d * G[j, 0] + gq_w * G[j, 1]
                N[j, i] = N[i, j]
        lateral = lateral_var / M
        N[1, 1] += s * s * lateral
        N[2, 1] -= s * c * lateral
        N[2, 2] += c * c * lateral
        N[1, 2] = N[2, 1]
        mean[0] = wrap_angle(mean[0] + turn)
        mean[1] += d * c
        mean[2] += d * s
    if invariant:
        propagate_invariant(state, n, N)
    else:
        moved[0], moved[1] = mean[1] - moved[0], mean[2] - moved[1]
        propagate_plain(state, n, moved, N)


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
