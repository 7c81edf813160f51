"""Landmark merging: finds two landmarks that are one corner."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array, Ints, Rows
from mecp_env.core.arrays import row_of
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn
from mecp_env.slam.config import SlamConfig, chi2_of_point
from mecp_env.slam.messages import LANDMARK, Belief, FeatureTable, Match

SAME_NIS = chi2_of_point(0.95)  # 95 % of the landmarks that are one corner lie inside


def find_duplicate(features: FeatureTable, belief: Belief, match: Match, config: SlamConfig) -> tuple[int, int] | None:
    """Ids (older, younger) of a landmark matched in this scan and another that is the same corner, or None.

    They have one descriptor, are not both seen in this scan, are nearer than two corners of a scan and within the 95 %
    gate of the sum of their covariances: correlated errors only make the true gate narrower, so nothing apart is
    merged.
    """
    landmarks = belief.ids, belief.p_map, belief.covs
    gate = config.corners.detail_m, SAME_NIS, config.association.face_turn_rad
    older, younger = find_same_corner(match.ids, match.decision, *landmarks, features.rows, gate)
    return None if older < 0 else (older, younger)


@compiled
def find_same_corner(
    matched: Ints,
    decision: Ints,
    ids: Ints,
    p_map: Array,
    covs: Array,
    rows: Rows,
    gate: tuple[float, float, float],
) -> tuple[int, int]:
    """Ids, in order, of the first landmark seen and another not seen that are one corner, or (-1, -1).

    `matched` (n,) and `decision` (n,) are of the corners of the scan, `ids` (N,), `p_map` (N,2) and `covs` (N,2,2) of
    the landmarks; `gate` is in m, NIS and rad that a face may turn.
    """
    (near_m, nis, turn), seen = gate, np.zeros(ids.shape[0], np.bool_)
    for c in range(matched.shape[0]):
        row = row_of(ids, matched[c]) if decision[c] == LANDMARK else -1
        if row >= 0:
            seen[row] = True
    for i in range(seen.shape[0]):
        for j in range(seen.shape[0] if seen[i] else 0):
            x, y = p_map[i, 0] - p_map[j, 0], p_map[i, 1] - p_map[j, 1]
            if seen[j] or abs(x) > near_m or abs(y) > near_m or math.hypot(x, y) > near_m:
                continue
            a, b, c_yy = covs[i, 0, 0] + covs[j, 0, 0], covs[i, 0, 1] + covs[j, 0, 1], covs[i, 1, 1] + covs[j, 1, 1]
            if not (c_yy * x * x - 2.0 * b * x * y + a * y * y) < nis * (a * c_yy - b * b):
                continue
            one, two = rows[ids[i]], rows[ids[j]]
            if one.convex == two.convex and 0.0 <= face_turn(one.normals, 0.0, two.normals) <= turn:
                return min(ids[i], ids[j]), max(ids[i], ids[j])
    return -1, -1
