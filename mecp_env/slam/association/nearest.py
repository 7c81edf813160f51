"""The baseline: gated nearest neighbour over the whole map, one to one (individual compatibility, ICNN)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.slam.association.gating import chi2_gate, one_to_one, pairing_table
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class NearestAssociator(Associator):
    """No polygons, no rooms, no descriptor: the smallest Mahalanobis distance inside the gate, each landmark once."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        nis = belief.individual_nis(corners.z, corners.R, view.belief.ids)
        pair_nearest(builder, nis, view.belief.ids, chi2_gate(2, self.config.gate_probability))
        return builder.classify_unmatched(nis, self.config.ignore_gate).match()


def pair_masked(corners: Corners, view: MapView, belief: Filter, config: AssociationConfig) -> Match:
    """The match by nearest neighbour among the pairs that rooms and descriptors allow, where `config` uses them."""
    gate = chi2_gate(2, config.gate_probability)
    builder, table = MatchBuilder(len(corners)), pairing_table(corners, view, belief, config, gate)
    pair_nearest(builder, table.costs, view.belief.ids, gate)
    return builder.classify_unmatched(table.nis, config.ignore_gate).match()


def pair_nearest(builder: MatchBuilder, nis: Array, landmarks: Ints, gate: float) -> None:
    """Give each corner still NEW its nearest landmark by `nis` (n,N), one to one, inside the gate."""
    row = one_to_one(nis, gate)
    corners = np.flatnonzero((row >= 0) & (builder.rows["decision"] == int(Decision.NEW)))
    rows = row[corners]
    builder.assign(corners, Decision.LANDMARK, Reason.ROOM, landmarks[rows], nis[corners, rows])
