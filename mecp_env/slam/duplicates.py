"""Two landmarks that are one corner are found, to be fused (design 4.8)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import TrackConfig
from mecp_env.slam.data import Belief, Decision, FeatureTable, Match
from mecp_env.slam.geometry import wrap_angle

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

FUSE_NIS = 5.99  # chi-square, 2 degrees of freedom, 95 %


def find_duplicate(features: FeatureTable, belief: Belief, match: Match, config: TrackConfig) -> tuple[int, int] | None:
    """Ids (older, younger) of a landmark matched in this scan and another that is the same corner, or None.

    The same signature, not both seen in this scan, nearer than `config.fuse_m` and within the 95 % gate of the sum of
    their covariances: correlated errors only make the true gate narrower, so nothing apart is fused by it.
    """
    matched = match.ids[match.decision == int(Decision.LANDMARK)]
    if not len(matched):
        return None
    seen = np.zeros(len(belief.ids), np.bool_)
    seen[belief.rows(matched)] = True
    tolerance = math.radians(config.signature_deg)
    a, b = _same_corner(
        seen,
        belief.p_map,
        belief.covs,
        features.convex[belief.ids],
        features.normals[belief.ids],
        config.fuse_m,
        tolerance,
    )
    return None if a < 0 else (int(min(belief.ids[a], belief.ids[b])), int(max(belief.ids[a], belief.ids[b])))


@kernel
def _same_corner(
    seen: Bools, p_map: Array, covs: Array, convex: Bools, normals: Array, near: float, tolerance: float
) -> tuple[int, int]:
    """Rows of the first landmark seen and another not seen that are one corner, or (-1, -1)."""
    for i in range(seen.shape[0]):
        for j in range(seen.shape[0]):
            if not seen[i] or seen[j] or convex[i] != convex[j]:
                continue
            x, y = p_map[i, 0] - p_map[j, 0], p_map[i, 1] - p_map[j, 1]
            if math.hypot(x, y) > near or not _faces_agree(normals[i], normals[j], tolerance):
                continue
            a, b, c = covs[i, 0, 0] + covs[j, 0, 0], covs[i, 0, 1] + covs[j, 0, 1], covs[i, 1, 1] + covs[j, 1, 1]
            if (c * x * x - 2.0 * b * x * y + a * y * y) < FUSE_NIS * (a * c - b * b):
                return i, j
    return -1, -1


@kernel
def _faces_agree(a: Array, b: Array, tolerance: float) -> bool:
    """True when at least one face is seen in both and none is turned by more than `tolerance`."""
    shared = 0
    for side in range(2):
        turned = wrap_angle(a[side] - b[side])
        if abs(turned) > tolerance:
            return False
        shared += not math.isnan(turned)
    return shared > 0
