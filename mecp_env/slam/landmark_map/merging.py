"""Two landmarks that are one corner are found, to be fused."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.arrays import row_of
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import TrackConfig
from mecp_env.slam.messages import LANDMARK, Belief, FeatureTable, Match

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

FUSE_NIS = 5.99  # chi-square, 2 degrees of freedom, 95 %


def find_duplicate(features: FeatureTable, belief: Belief, match: Match, config: TrackConfig) -> tuple[int, int] | None:
    """Ids (older, younger) of a landmark matched in this scan and another that is the same corner, or None.

    The same signature, not both seen in this scan, nearer than `config.fuse_m` and within the 95 % gate of the sum of
    their covariances: correlated errors only make the true gate narrower, so nothing apart is fused by it.
    """
    older, younger = _same_corner(
        match.ids,
        match.decision,
        belief.ids,
        belief.p_map,
        belief.covs,
        features.convex,
        features.normals,
        config.fuse_m,
        math.radians(config.signature_deg),
    )
    return None if older < 0 else (older, younger)


@compiled
def _same_corner(
    matched: Ints,
    decision: Ints,
    ids: Ints,
    p_map: Array,
    covs: Array,
    convex: Bools,
    normals: Array,
    near: float,
    tolerance: float,
) -> tuple[int, int]:
    """Ids, in order, of the first landmark seen and another not seen that are one corner, or (-1, -1).

    `convex` and `normals` are those of all features, by id.
    """
    seen = landmarks_seen(matched, decision, ids)
    for i in range(seen.shape[0]):
        if not seen[i]:
            continue
        for j in range(seen.shape[0]):
            if seen[j] or not _near(p_map, covs, i, j, near):
                continue
            one, two = ids[i], ids[j]
            if convex[one] == convex[two] and _faces_agree(normals[one], normals[two], tolerance):
                return min(one, two), max(one, two)
    return -1, -1


@compiled
def landmarks_seen(matched: Ints, decision: Ints, ids: Ints) -> Bools:
    """(N,) which of the landmarks `ids` (N,) were recognised: `matched` (n,) by a corner with that decision (n,)."""
    seen = np.zeros(ids.shape[0], np.bool_)
    for c in range(matched.shape[0]):
        row = row_of(ids, matched[c]) if decision[c] == LANDMARK else -1
        if row >= 0:
            seen[row] = True
    return seen


@compiled
def _near(p_map: Array, covs: Array, i: int, j: int, near: float) -> bool:
    """True when two landmarks are nearer than `near` (m) and within the gate of the sum of their covariances."""
    x, y = p_map[i, 0] - p_map[j, 0], p_map[i, 1] - p_map[j, 1]
    if abs(x) > 2.0 * near or abs(y) > 2.0 * near or math.hypot(x, y) > near:
        return False
    a, b, c = covs[i, 0, 0] + covs[j, 0, 0], covs[i, 0, 1] + covs[j, 0, 1], covs[i, 1, 1] + covs[j, 1, 1]
    return bool((c * x * x - 2.0 * b * x * y + a * y * y) < FUSE_NIS * (a * c - b * b))


@compiled
def _faces_agree(a: Array, b: Array, tolerance: float) -> bool:
    """True when at least one face is seen in both and none is turned by more than `tolerance`."""
    shared = 0
    for side in range(2):
        turned = wrap_angle(a[side] - b[side])
        if abs(turned) > tolerance:
            return False
        shared += not math.isnan(turned)
    return shared > 0
