"""The batch update of a whole scan, one-shot or iterated (derivations 4), and the merging of two landmarks.

Landmarks are added, and part of the state is taken out: compiled functions over the state of a filter.

`state` (1+C,C): the mean in its first row, the covariance below; the leading n numbers are in use. One array is one
argument, and half the cost of two.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import block_of, downdate, factor_lower, forward_rows, solve_lower
from mecp_env.slam.filters.models import change_chart, innovation_cov, linearise, project, residual, retract
from mecp_env.slam.messages import NO_ID, find_rows


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
    rows = np.arange(4 + 2 * slots.shape[0])  # that of the mean, then that of each number
    for k in range(slots.shape[0]):
        rows[4 + 2 * k], rows[5 + 2 * k] = 4 + 2 * slots[k], 5 + 2 * slots[k]
    return block_of(state, rows, rows[1:] - 1)


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


FIRST_PROBE = -(2**40)  # the probes of `submap`, which have no variance of their own, have this id and lower ones
CONVERGED = 1e-7  # m and rad: an iteration stops when no number of the state moves by more


@compiled
def gauss_newton(
    state: Array, n: int, slots: Ints, z: Array, R: Array, invariant: bool, iterations: int, xi: Array
) -> tuple[float, Array]:
    """Minimise prior + measurement cost over the error xi (n,) of the state; xi is the start and becomes the result.

    At most `iterations` steps; one from xi = 0 is the EKF's. H is that of the filter at the state with error xi, not
    the derivative by xi there: that of the invariant error has a heading column at xi != 0, by which the map as a whole
    would turn, though nothing that is measured says so. Returns the cost, which is nu^T S^-1 nu with nu = z - h + H xi,
    and W = L^-1 H P (2m,w) of the last step, S = L L^T. The cost is nan where S is not positive or xi not finite.
    """
    m, x, cov, cost = slots.shape[0], state[0].copy(), state[1:], math.nan
    h, A, a_heading = np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    nu, S, W = np.empty(2 * m), np.empty((2 * m, 2 * m)), np.empty((0, n))
    for _ in range(iterations):
        for i in range(n):
            x[i] = state[0, i]
        retract(x, n, xi, invariant)
        linearise(x, slots, invariant, h, A, a_heading)
        residual(z, h, A, a_heading, slots, xi, nu)
        W = project(cov, n, A, a_heading, slots)
        innovation_cov(W, A, a_heading, slots, R, S)
        if not factor_lower(S):
            return math.nan, W
        forward_rows(S, W)  # W = L^-1 H P
        y = solve_lower(S, nu)
        step = state_increment(W, y, xi)  # xi = P H^T S^-1 nu
        if not step < np.inf:
            return math.nan, W
        cost = 0.0
        for i in range(2 * m):
            cost += y[i] * y[i]
        if step < CONVERGED:
            break
    return cost, W


@compiled
def batch_update(state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, iterations: int) -> bool:
    """Gauss-Newton on prior and measurements, at most `iterations` steps (1: the EKF's update), then P -= W^T W.

    Returns False, and leaves the state alone, when S is not positive or one of the `ids` (m,) is unknown.
    """
    n = 3 + 2 * slot_ids.shape[0]
    slots, xi = np.empty(ids.shape[0], np.int64), np.zeros(n)
    if not find_rows(slot_ids, ids, slots):
        return False
    cost, W = gauss_newton(state, n, slots, z, R, invariant, iterations, xi)
    return not math.isnan(cost) and apply_update(state, slot_ids, W, xi, invariant)


@compiled
def state_increment(W: Array, y: Array, xi: Array) -> float:
    """Replace xi (n,) by W^T y; returns the largest change of a number (inf when one is not finite)."""
    new = np.zeros(xi.shape[0])
    for k in range(W.shape[0]):
        row, factor = W[k], y[k]
        for j in range(new.shape[0]):
            new[j] += factor * row[j]
    step = 0.0
    for j in range(new.shape[0]):
        change = abs(new[j] - xi[j])
        if not change < np.inf:
            return np.inf
        step = max(step, change)
        xi[j] = new[j]
    return step


@compiled
def apply_update(state: Array, slot_ids: Ints, W: Array, xi: Array, invariant: bool) -> bool:
    """x <- x retracted by xi, P -= W^T W; False when a variance is then not positive (the state is spoilt)."""
    mean, cov, n = state[0], state[1:], 3 + 2 * slot_ids.shape[0]
    downdate(cov, n, W)
    retract(mean, n, xi, invariant)
    positive = True
    for i in range(n):
        positive = positive and (cov[i, i] > 0.0 or (i > 2 and slot_ids[(i - 3) // 2] <= FIRST_PROBE))
    return positive


@compiled
def merge_pair(state: Array, slot_ids: Ints, keep: int, drop: int, var: float, invariant: bool) -> bool:
    """Update with the pseudo-measurement l_keep - l_drop = 0 (variance `var`, m^2); False when not positive.

    Differences of landmarks have the same Jacobian in both filters.
    """
    mean, cov, n = state[0], state[1:], 3 + 2 * slot_ids.shape[0]
    i, j = 3 + 2 * keep, 3 + 2 * drop
    W, S, nu = np.empty((2, n)), np.empty((2, 2)), np.empty(2)
    for r in range(2):
        nu[r] = mean[j + r] - mean[i + r]
        for c in range(n):
            W[r, c] = cov[i + r, c] - cov[j + r, c]
    for r in range(2):
        for c in range(2):
            S[r, c] = W[r, i + c] - W[r, j + c]
        S[r, r] += var
    if not factor_lower(S):
        return False
    forward_rows(S, W)
    xi = np.zeros(n)
    state_increment(W, solve_lower(S, nu), xi)
    return apply_update(state, slot_ids, W, xi, invariant)
