"""Association to the letter of the paper (III-B): kept beside ours so that each reading can be measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.association.base import chi2_gate, undecided
from mecp_env.slam.association.nearest import pair_off
from mecp_env.slam.association.polygon_matching import known_rings
from mecp_env.slam.association.single_corners import pairing_table
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class MecpPaperAssociator(Associator):
    """Polygon centres by the paper's covariance (eq. 3), two vertices by NIS, the rest implicitly; then the room."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner (III-B.2)."""
        match = undecided(len(corners))
        if not len(view.belief.ids) or not len(corners):
            return match
        gate = chi2_gate(2, self.config.gate_probability)
        table = pairing_table(corners, view, belief, self.config, gate, elsewhere=False)
        costs = table.costs
        for p, polygon in enumerate(polygons):
            known, ids = self._nearest_centre(corners, polygon, view, belief, gate)
            shift = _two_vertices(table.nis[polygon.corners], view.belief.rows(ids), gate) if known >= 0 else -1
            if shift >= 0:
                match = _implicit(match, polygon, np.roll(ids, -shift), p, known)
                break
        costs[:, np.isin(view.belief.ids, match.ids)] = np.inf
        pair_off(match, costs, view, gate)
        return match

    def _nearest_centre(
        self, corners: Corners, polygon: Polygon, view: MapView, belief: Filter, gate: float
    ) -> tuple[int, Ints]:
        """The known polygon of equal cardinality with the smallest Mahalanobis distance of centres (III-B.2)."""
        z, R = corners.measurements(polygon.corners)
        best, known, ring = gate, -1, polygon.corners
        for index, ids in zip(*known_rings(view, len(polygon.corners)), strict=True):
            nis = belief.mean_of_gaussians_nis(z, R, ids, paper_S=True)  # eq. 3
            if nis < best:
                best, known, ring = nis, int(index), ids
        return known, ring


def _two_vertices(nis: Array, rows: Ints, gate: float) -> int:
    """The shift at which two consecutive vertices fit best by NIS, or -1 (III-B.2); nis (k,N)."""
    k = len(rows)
    best, found = np.inf, -1
    for shift in range(k):
        first, second = nis[0, rows[shift]], nis[1, rows[(shift + 1) % k]]
        if max(first, second) <= gate and first + second < best:
            best, found = first + second, shift
    return found


def _implicit(match: Match, polygon: Polygon, ids: Ints, p: int, known: int) -> Match:
    match.ids[polygon.corners] = ids
    match.decision[polygon.corners] = int(Decision.LANDMARK)
    match.reason[polygon.corners] = int(Reason.POLYGON)
    return Match(match.ids, match.decision, match.reason, match.nis, p, known, match.closure)
