"""Everything by which the two filters differ: what "error of the state" means, and what follows from it.

State, inside the filters only: `mean` (n,) = heading, x, y, l1x, l1y, ...; `xi` (n,) is its error in the same order.
  invariant: x_true = exp(xi) x on SE_{N+1}(2), the right-invariant error (Barrau and Bonnabel, "An EKF-SLAM algorithm
             with consistency properties", 2015);
  else:      x_true = x + xi, the plain error of the paper's EKF.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import mirror_lower
from mecp_env.core.se2 import wrap_angle


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
