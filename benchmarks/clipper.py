"""CLIPPER as a rival: the densest set of pairs that agree, by a relaxation instead of a search for a clique.

P. C. Lusk, K. Fathian and J. P. How, "CLIPPER: a graph-theoretic framework for robust data association", IEEE
International Conference on Robotics and Automation, 2021, algorithm 1. The graph is that of `ccda`: pairs of corner and
landmark inside the gate, with descriptors, joined where their distances agree. What it selects must pass the joint test
of `ccda`.
"""

from __future__ import annotations

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.lab.rivals import CcdaAssociator
from mecp_env.slam.association.cliques import PairGraph

MOST_ASCENTS, MOST_STEPS, MOST_HALVINGS = 100, 200, 40
SETTLED = 1e-9


class ClipperAssociator(CcdaAssociator):
    """The pairs of the densest subgraph, as far as they fit together at one pose."""

    __slots__ = ()

    def _selected(self, graph: PairGraph) -> Ints:
        """The densest subgraph."""
        return densest(np.exp(-0.5 * graph.edges))


def densest(affinity: Array) -> Ints:
    """Nodes of a dense set without a missing edge: the local optimum of u' M u that begins at even weights.

    `affinity` (P,P) is symmetric, 0 without an edge. A penalty of missing edges grows until u has none.
    """
    n = len(affinity)
    if n == 0:
        return np.empty(0, np.int64)
    M, missing = affinity.copy(), affinity == 0.0
    np.fill_diagonal(M, 1.0)
    np.fill_diagonal(missing, val=False)
    u, penalty = np.full(n, n**-0.5), 0.0
    for _ in range(MOST_ASCENTS):
        broken = missing @ u
        wrong = (broken > SETTLED) & (u > SETTLED)
        if penalty > 0.0 and not wrong.any():
            break
        penalty += float(np.mean((M @ u)[wrong] / broken[wrong])) if wrong.any() else SETTLED
        u = _ascend(u, M, missing, penalty)
    return np.sort(np.argsort(-u, kind="stable")[: max(1, round(float(u @ M @ u)))])


def _ascend(u: Array, M: Array, missing: Bools, penalty: float) -> Array:
    """Projected gradient ascent on the part of the unit sphere without negative numbers, with backtracking."""
    A = M - penalty * missing
    value = float(u @ A @ u)
    for _ in range(MOST_STEPS):
        gradient, step = 2.0 * (A @ u), 1.0
        for _ in range(MOST_HALVINGS):
            tried = np.maximum(u + step * gradient, 0.0)
            tried /= max(float(np.linalg.norm(tried)), SETTLED)
            if (gained := float(tried @ A @ tried) - value) >= 0.0:
                break
            step *= 0.5
        if gained < SETTLED:
            return u
        u, value = tried, value + gained
    return u
