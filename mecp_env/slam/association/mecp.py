"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.association.base import chi2_gate, undecided
from mecp_env.slam.association.joint import best_growth, grow
from mecp_env.slam.association.rings import RingMatch, match_rings
from mecp_env.slam.association.singles import open_rooms, pairing_table, settle
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.data import Belief, Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.filters import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class MecpAssociator:
    """Polygons first, globally; then everything else jointly, within the room where rooms are used."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner (III-B.2)."""
        gate = chi2_gate(2, self.config.gate_probability)
        match = undecided(len(corners))
        nearest = np.full(len(corners), np.inf)
        if len(view.belief.ids) and len(corners):
            table = pairing_table(corners, view, belief, self.config)
            nearest = table.nis.min(axis=1)
            ring = self._recognise(corners, polygons, view, table.nis, belief)
            costs = open_rooms(table, gate)
            match = self._pair(match, corners, costs, ring, view, belief)
        settle(match, corners, view, nearest, self.config.ignore_gate)
        return match

    def _recognise(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, nis: Array, belief: Filter
    ) -> RingMatch | None:
        if not self.config.use_polygons:
            return None
        return match_rings(corners, polygons, view, nis, belief, self.config)

    def _pair(
        self, match: Match, corners: Corners, costs: Array, ring: RingMatch | None, view: MapView, belief: Filter
    ) -> Match:
        gate = chi2_gate(2, self.config.gate_probability)
        corner, row = possible_pairs(costs, gate, ring, view.belief, self.config.most_pairs)
        if not len(corner):
            return match
        ids = view.belief.ids[row]
        z, R = corners.measurements(corner)
        nu, S = belief.innovation(z, R, ids)
        if ring is not None:
            seed = np.flatnonzero(_of_ring(corner, ids, ring))
            nis, ambiguous = grow(nu, S, corner, row, seed, gate, self.config.rival_gap)
        else:
            seeds = self._first_pairs(costs, corner, row, view)
            nis, ambiguous = best_growth(nu, S, corner, row, seeds, gate, self.config.rival_gap)
        return _decided(match, corner, ids, nis, ambiguous, ring)

    def _first_pairs(self, costs: Array, corner: Ints, row: Ints, view: MapView) -> Ints:
        """Which pairing to start from: a free choice while the pose is sharp, each of the likeliest otherwise."""
        variance = view.belief.pose_cov.diagonal()
        sharp = max(variance[0], variance[1]) < self.config.sharp_sigma_m**2
        if sharp and variance[2] < np.deg2rad(self.config.sharp_sigma_deg) ** 2:
            return np.array([-1])
        order = np.argsort(costs[corner, row], kind="stable")[: self.config.most_seeds]
        return np.concatenate(([-1], order))


def possible_pairs(costs: Array, gate: float, ring: RingMatch | None, belief: Belief, most: int) -> tuple[Ints, Ints]:
    """Corner and landmark row (P,) of each pairing inside the gate, those of the recognised ring always included."""
    possible = costs <= gate
    if ring is not None:
        possible[ring.corners, :] = False
        possible[ring.corners, belief.rows(ring.ids)] = True
    corner, row = np.nonzero(possible)
    if len(corner) > most:
        keep = np.sort(np.argsort(costs[corner, row], kind="stable")[:most])
        corner, row = corner[keep], row[keep]
    return corner, row


def _of_ring(corner: Ints, ids: Ints, ring: RingMatch) -> Bools:
    wanted = dict(zip(ring.corners.tolist(), ring.ids.tolist(), strict=True))
    return np.array([wanted.get(c) == i for c, i in zip(corner.tolist(), ids.tolist(), strict=True)])


def _decided(match: Match, corner: Ints, ids: Ints, nis: Array, ambiguous: Bools, ring: RingMatch | None) -> Match:
    paired = ~np.isnan(nis)
    match.ids[corner[paired]] = ids[paired]
    match.decision[corner[paired]] = int(Decision.LANDMARK)
    match.reason[corner[paired]] = int(Reason.JOINT)
    match.nis[corner[paired]] = nis[paired]
    match.decision[corner[ambiguous]] = int(Decision.IGNORED)
    match.reason[corner[ambiguous]] = int(Reason.AMBIGUOUS)
    if ring is None:
        return match
    match.reason[ring.corners[match.ids[ring.corners] == ring.ids]] = int(Reason.POLYGON)
    return Match(match.ids, match.decision, match.reason, match.nis, ring.polygon, ring.known, match.closure)
