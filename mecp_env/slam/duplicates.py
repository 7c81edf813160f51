"""Two landmarks that are one corner are found and fused (design 4.8)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.config import TrackConfig
from mecp_env.slam.data import Belief, FeatureTable, Match
from mecp_env.slam.geometry import wrap_angle
from mecp_env.slam.linalg import mahalanobis

Ints = NDArray[np.int64]

FUSE_NIS = 5.99  # chi-square, 2 degrees of freedom, 95 %


def find_duplicate(features: FeatureTable, belief: Belief, match: Match, config: TrackConfig) -> tuple[int, int] | None:
    """Ids (older, younger) of a landmark matched in this scan and another that is the same corner, or None.

    The same signature, not both seen in this scan, nearer than `config.fuse_m` and within the 95 % gate of the sum of
    their covariances: correlated errors only make the true gate narrower, so nothing apart is fused by it.
    """
    seen = match.ids[match.decision == 0]
    row = {landmark: i for i, landmark in enumerate(belief.ids.tolist())}
    for landmark in seen.tolist():
        i = row[landmark]
        offset = belief.p_map - belief.p_map[i]
        near = np.flatnonzero((np.abs(offset) < config.fuse_m).all(axis=1))
        for j in near.tolist():
            other = int(belief.ids[j])
            if j != i and other not in seen and _same_corner(features, belief, landmark, other, (i, j), config):
                return min(landmark, other), max(landmark, other)
    return None


def _same_corner(
    features: FeatureTable, belief: Belief, a: int, b: int, rows: tuple[int, int], config: TrackConfig
) -> bool:
    nu = belief.p_map[rows[0]] - belief.p_map[rows[1]]
    if math.hypot(nu[0], nu[1]) > config.fuse_m or features.convex[a] != features.convex[b]:
        return False
    turned = [wrap_angle(x) for x in features.normals[a] - features.normals[b]]
    shared = [abs(t) for t in turned if not math.isnan(t)]
    if not shared or max(shared) > math.radians(config.signature_deg):
        return False
    return bool(mahalanobis(nu, belief.covs[rows[0]] + belief.covs[rows[1]]) < FUSE_NIS)
