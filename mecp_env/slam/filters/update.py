"""The batch update of a whole scan, one-shot or iterated (derivations 4), and the merging of two landmarks."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.arrays import find_rows
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import downdate, factor_lower, forward_rows, solve_lower
from mecp_env.slam.filters.error_state import linearise, retract
from mecp_env.slam.filters.measurement import innovation_cov, project, residual

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
