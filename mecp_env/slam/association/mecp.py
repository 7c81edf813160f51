"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.association.base import chi2_gate, undecided
from mecp_env.slam.association.joint import best_growth, grow
from mecp_env.slam.association.rings import RingMatch, match_rings
from mecp_env.slam.association.singles import pairing_table, possible_pairs, settle
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.data import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LANDMARK, IGNORED = int(Decision.LANDMARK), int(Decision.IGNORED)
POLYGON, JOINT, AMBIGUOUS = int(Reason.POLYGON), int(Reason.JOINT), int(Reason.AMBIGUOUS)


@dataclass(slots=True, eq=False)
class MecpAssociator:
    """Polygons first, globally; then everything else jointly, within the room where rooms are used."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner (III-B.2)."""
        match = undecided(len(corners))
        nearest = np.full(len(corners), np.inf)
        if len(view.belief.ids) and len(corners):
            table = pairing_table(corners, view, belief, self.config, self._gate)
            nearest = table.nearest
            ring = self._recognise(corners, polygons, view, table.nis, belief)
            match = self._pair(match, corners, table.costs, ring, view, belief)
        settle(match, corners, view, nearest, self.config.ignore_gate)
        return match

    @property
    def _gate(self) -> float:
        return chi2_gate(2, self.config.gate_probability)

    def _recognise(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, nis: Array, belief: Filter
    ) -> RingMatch | None:
        if not self.config.use_polygons:
            return None
        return match_rings(corners, polygons, view, nis, belief, self.config)

    def _pair(
        self, match: Match, corners: Corners, costs: Array, ring: RingMatch | None, view: MapView, belief: Filter
    ) -> Match:
        fixed = np.full(len(corners), -1, np.int64)
        if ring is not None:
            fixed[ring.corners] = view.belief.rows(ring.ids)
        corner, row = possible_pairs(costs, self._gate, fixed, self.config.most_pairs)
        if not len(corner):
            return match
        z, R = corners.measurements(corner)
        nu, S = belief.innovation(z, R, view.belief.ids[row])
        if ring is not None:
            seed = np.flatnonzero(fixed[corner] == row)
            nis, ambiguous = grow(nu, S, corner, row, seed, self._gate, self.config.rival_gap)
        else:
            seeds = self._first_pairs(costs, corner, row, view)
            nis, ambiguous = best_growth(nu, S, corner, row, seeds, self._gate, self.config.rival_gap)
        ids = view.belief.ids[row]
        write_pairs(match.ids, match.decision, match.reason, match.nis, corner, ids, nis, ambiguous, fixed >= 0)
        return match if ring is None else replace(match, polygon=ring.polygon, known=ring.known)

    def _first_pairs(self, costs: Array, corner: Ints, row: Ints, view: MapView) -> Ints:
        """Which pairing to start from: a free choice while the pose is sharp, each of the likeliest otherwise."""
        variance = view.belief.pose_cov.diagonal()
        sharp = max(variance[0], variance[1]) < self.config.sharp_sigma_m**2
        if sharp and variance[2] < np.deg2rad(self.config.sharp_sigma_deg) ** 2:
            return np.array([-1])
        order = np.argsort(costs[corner, row], kind="stable")[: self.config.most_seeds]
        return np.concatenate(([-1], order))


@kernel
def write_pairs(
    match_ids: Ints,
    decision: Ints,
    reason: Ints,
    match_nis: Array,
    corner: Ints,
    ids: Ints,
    nis: Array,
    ambiguous: Bools,
    by_polygon: Bools,
) -> None:
    """Enter the accepted pairs (nis not nan) and the ambiguous corners into the columns of a match; in place."""
    for p in range(corner.shape[0]):
        c = corner[p]
        if ambiguous[p]:
            decision[c], reason[c] = IGNORED, AMBIGUOUS
        if not math.isnan(nis[p]):
            match_ids[c], match_nis[c], decision[c] = ids[p], nis[p], LANDMARK
            reason[c] = POLYGON if by_polygon[c] else JOINT
