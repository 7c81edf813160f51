"""The plain rival: gated nearest neighbour over the whole map, one to one (individually compatible, ICNN)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mecp_env.slam.association.base import chi2_gate, one_to_one, undecided
from mecp_env.slam.association.single_corners import settle
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class NearestAssociator(Associator):
    """No polygons, no rooms, no signature: the smallest Mahalanobis distance inside the gate, each landmark once."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner."""
        match = undecided(len(corners))
        nearest = np.full(len(corners), np.inf)
        if len(view.belief.ids) and len(corners):
            nis = belief.individual_nis(corners.z, corners.R, view.belief.ids)
            nearest = nis.min(axis=1)
            pair_off(match, nis, view, chi2_gate(2, self.config.gate_probability))
        settle(match, corners, view, nearest, self.config.ignore_gate)
        return match


def pair_off(match: Match, nis: np.ndarray, view: MapView, gate: float) -> None:
    """Give each corner still NEW its nearest landmark by `nis` (n,N), one to one, inside the gate; in place."""
    row = one_to_one(nis, gate)
    paired = np.flatnonzero((row >= 0) & (match.decision == int(Decision.NEW)))
    match.ids[paired] = view.belief.ids[row[paired]]
    match.decision[paired] = int(Decision.LANDMARK)
    match.reason[paired] = int(Reason.ROOM)
    match.nis[paired] = nis[paired, row[paired]]
