"""Dead reckoning of one control step: the new pose and the noise it picked up (derivations 4: u and L)."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.filters.error_state import propagate_invariant, propagate_plain


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
