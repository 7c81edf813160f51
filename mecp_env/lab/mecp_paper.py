"""Association as the paper has it (III-B), to the letter: the associator `mecp_paper`."""

from __future__ import annotations

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.lab.rivals import pair_nearest
from mecp_env.slam.association.gating import GatedAssociator, MatchBuilder, pairing_table
from mecp_env.slam.messages import Corners, Decision, FeatureState, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Filter


class MecpPaperAssociator(GatedAssociator):
    """Polygon centres by the paper's covariance (eq. 3), two vertices by NIS, the rest implicitly; then the room."""

    __slots__ = ()

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner (III-B.2)."""
        builder, landmarks = MatchBuilder(len(corners)), view.belief.ids
        if not len(landmarks) or not len(corners):
            return builder.match()
        table = pairing_table(corners, view, belief, self.config, home_gate=np.inf)
        for p, polygon in enumerate(polygons):
            index, ids = self._nearest_centre(corners, polygon, view, belief)
            shift = _two_vertices(table.nis[polygon.corners], view.belief.rows(ids), self.gate) if index >= 0 else -1
            if shift >= 0:
                ids = np.roll(ids, -shift)
                builder.assign(polygon.corners, Decision.LANDMARK, Reason.POLYGON, ids)
                builder.polygon, builder.map_polygon = p, index
                break
        table.costs[:, np.isin(landmarks, builder.rows["id"])] = np.inf
        pair_nearest(builder, table.costs, landmarks, self.gate)
        return builder.match()

    def _nearest_centre(self, corners: Corners, polygon: Polygon, view: MapView, belief: Filter) -> tuple[int, Ints]:
        """The map polygon of equal cardinality with the smallest Mahalanobis distance of centres (III-B.2)."""
        z, R = corners.measurements(polygon.corners)
        best, nearest, vertices = self.gate, -1, polygon.corners
        for index, ids in zip(*map_polygons_of(view, len(polygon.corners)), strict=True):
            nis = belief.mean_of_gaussians_nis(z, R, ids, paper_S=True)  # eq. 3
            if nis < best:
                best, nearest, vertices = nis, int(index), ids
        return nearest, vertices


def map_polygons_of(view: MapView, cardinality: int) -> tuple[Ints, Ints]:
    """Indices (C,) of the map polygons of that cardinality made of landmarks alone, and their ids (C,k)."""
    group = view.groups.get(cardinality)
    if group is None:
        return np.empty(0, np.int64), np.empty((0, cardinality), np.int64)
    whole = (view.features.rows["state"][group.ids] == int(FeatureState.LANDMARK)).all(axis=1)
    return group.index[whole], group.ids[whole]


def _two_vertices(nis: Array, rows: Ints, gate: float) -> int:
    """The shift at which two consecutive vertices fit best by NIS, or -1 (III-B.2); nis (k,N)."""
    k = len(rows)
    best, found = np.inf, -1
    for shift in range(k):
        first, second = nis[0, rows[shift]], nis[1, rows[(shift + 1) % k]]
        if max(first, second) <= gate and first + second < best:
            best, found = first + second, shift
    return found
