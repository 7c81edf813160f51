"""Matching a polygon of the scan with the polygons of the map (III-B.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints, Rows, carrier
from mecp_env.core.jit import compiled
from mecp_env.slam.association.gating import chi2_gate
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, FeatureState, MapView, Polygon, PolygonGroup
from mecp_env.slam.protocols import Filter


@carrier
class PolygonMatch:
    """A polygon of the scan recognised as one of the map."""

    polygon: int  # index in the scan's polygons
    map_polygon: int  # index in the map's polygons
    corners: Ints  # (v,) corners whose landmarks the match fixes
    ids: Ints  # (v,) their landmark ids


class PolygonTest(NamedTuple):
    """How a polygon is tested: one linearisation where the prediction is sharp; else no gates but the joint one."""

    vertex_gate: float  # NIS of a vertex alone; generous: the joint test decides
    centre_gate: float  # NIS of the centre
    iterate: bool  # the joint test


def map_polygons_of(view: MapView, cardinality: int) -> tuple[Ints, Ints]:
    """Indices (C,) of the map polygons of that cardinality made of landmarks alone, and their ids (C,k)."""
    group = view.groups.get(cardinality)
    if group is None:
        return np.empty(0, np.int64), np.empty((0, cardinality), np.int64)
    whole = (view.features.rows["state"][group.ids] == int(FeatureState.LANDMARK)).all(axis=1)
    return group.index[whole], group.ids[whole]


@compiled
def polygon_hypotheses(
    nis: Array, corners: Ints, landmarks: Ints, features: Rows, ids: Ints, gate: float, found: Ints, which: Ints
) -> int:
    """Write the map polygons (h,k), turned so that every vertex passes its own gate, and which (h,) they are.

    `nis` (n,N) of corners against `landmarks` (N,); `corners` (k,) are the vertices of the scan's polygon, `ids` (C,k)
    those of the map's polygons, both ccw, among `features` (F,) FEATURE. A polygon of landmarks alone counts. Returns
    h; `found` and `which` have room for one more.
    """
    count, k = ids.shape
    row, h = np.full(features.shape[0], -1), 0
    for j in range(landmarks.shape[0]):
        row[landmarks[j]] = j
    for c in range(count):
        whole = True
        for v in range(k):
            whole &= features[ids[c, v]].state == FeatureState.LANDMARK
        for shift in range(k if whole else 0):
            v, passed = 0, True
            while v < k and passed:
                found[h, v] = ids[c, v + shift - (k if v + shift >= k else 0)]
                column = row[found[h, v]]
                passed = column >= 0 and nis[corners[v], column] <= gate
                v += 1
            if passed:
                which[h] = c
                h += 1
    return h


@dataclass(slots=True, eq=False)
class PolygonMatcher:
    """Matches polygons of one scan with those of the map."""

    config: AssociationConfig
    corners: Corners
    view: MapView
    belief: Filter
    nis: Array  # (n,N) of corners against landmarks
    test: PolygonTest

    def first_match(self, polygons: tuple[Polygon, ...]) -> PolygonMatch | None:
        """The match of the first polygon that is recognised, or None."""
        for p, polygon in enumerate(polygons):
            found = self._match(polygon) if len(polygon.corners) >= 4 else None
            if found is not None:
                return PolygonMatch(p, *found)
        return None

    def _match(self, polygon: Polygon) -> tuple[int, Ints, Ints] | None:
        """Index of the map polygon, the corners (v,) whose landmarks are clear, and their ids (v,); or None."""
        group = self.view.groups.get(len(polygon.corners))
        if group is None:
            return None
        ids, which = self._hypotheses(polygon, group, self.test.vertex_gate)
        if not len(ids):
            return None
        joint_gate = chi2_gate(2 * len(polygon.corners), self.config.gate_probability)
        z, R = self.corners.measurements(polygon.corners)
        accepted = []
        for hypothesis, c in zip(ids, which.tolist(), strict=True):
            if self.belief.mean_of_gaussians_nis(z, R, hypothesis, paper_S=self.config.paper_S) > self.test.centre_gate:
                continue
            joint = self.belief.joint_nis(z, R, hypothesis, self.test.iterate)
            if joint <= joint_gate:
                accepted.append((joint, int(group.index[c]), hypothesis))
        return _agreed(accepted, polygon.corners, self.config.rival_gap)

    def _hypotheses(self, polygon: Polygon, group: PolygonGroup, gate: float) -> tuple[Ints, Ints]:
        """Ids (h,k) of map polygons as `polygon_hypotheses` writes them, and which of `group` (h,) they are."""
        view, (count, k) = self.view, group.ids.shape
        ids, which = np.empty((count * k + 1, k), np.int64), np.empty(count * k + 1, np.int64)
        landmarks, features = view.belief.ids, view.features.rows
        h = polygon_hypotheses(self.nis, polygon.corners, landmarks, features, group.ids, gate, ids, which)
        return ids[:h], which[:h]


def _agreed(
    hypotheses: list[tuple[float, int, Ints]], corners: Ints, rival_gap: float
) -> tuple[int, Ints, Ints] | None:
    """The best hypothesis, cut down to the vertices on which all serious rivals agree; None under three of them."""
    if not hypotheses:
        return None
    if len(hypotheses) == 1:
        return hypotheses[0][1], corners, hypotheses[0][2]
    nis, map_polygon, ids = min(hypotheses, key=lambda h: (h[0], h[1]))
    agreed = np.ones(len(ids), np.bool_)
    for rival in hypotheses:
        if rival[0] < nis + rival_gap:
            agreed &= rival[2] == ids
    return (map_polygon, corners[agreed], ids[agreed]) if agreed.sum() >= 3 else None
