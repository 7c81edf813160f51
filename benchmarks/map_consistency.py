"""Whether a finished map knows how well it knows: NEES of landmarks, and of the offsets between them."""

from __future__ import annotations

import numpy as np

from benchmarks.errors import mean_nees
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import to_map
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.slam.protocols import Filter


def map_nees(truth: GroundTruth, log: AssociationLog, belief: Filter, T_map_world: Array) -> tuple[float, float]:
    """Mean NEES of the landmarks, and of the offset of two that were matched in one scan (2 expected of both).

    Those of no true corner are left out; nan where none is left.
    """
    still, corner = len(truth.outline.corners), log.corners_of(belief.ids)
    slots = np.flatnonzero((corner >= 0) & (corner < still))
    mean, cov = belief.marginal(belief.ids[slots])
    p_map = to_map(T_map_world, np.ascontiguousarray(truth.outline.corners.p_world[corner[slots]]))
    errors, m = mean[3:].reshape(-1, 2) - p_map, len(slots)
    blocks = cov[3:, 3:].reshape(m, 2, m, 2).transpose(0, 2, 1, 3)  # (m,m,2,2)
    a, b = seen_together(log, belief.ids[slots])
    apart = corner[slots[a]] != corner[slots[b]]  # duplicates are one corner
    a, b = a[apart], b[apart]
    offsets = blocks[a, a] + blocks[b, b] - blocks[a, b] - blocks[b, a]
    return mean_nees(errors, blocks[np.arange(m), np.arange(m)]), mean_nees(errors[a] - errors[b], offsets)


def seen_together(log: AssociationLog, ids: Ints) -> tuple[Ints, Ints]:
    """Indices (k,), (k,) of all pairs of the landmarks ids (m,) that were matched in one scan, each pair once."""
    step, _, feature, matched = log.rows[: log.used].T
    slot = np.full(max(int(feature.max(initial=-1)), int(ids.max(initial=-1))) + 1, -1)
    slot[ids] = np.arange(len(ids))
    rows = np.flatnonzero((matched > 0) & (slot[feature] >= 0))
    seen = np.zeros((int(step.max(initial=0)) + 1, len(ids)))
    seen[step[rows], slot[feature[rows]]] = 1.0
    a, b = np.nonzero(np.triu(seen.T @ seen, 1))
    return a, b
