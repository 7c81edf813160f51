"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default)."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.array_types import Array, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.association.gating import FIXED, PairingTable, chi2_gate, pairing_table, possible_pairs
from mecp_env.slam.association.joint_compatibility import best_of_seeds, greedy_joint_compatibility
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.association.polygon_matching import PolygonMatch, PolygonMatcher, PolygonTest
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Belief, Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter

NONE = np.empty(0, np.int64)
OPEN = sys.float_info.max  # a gate that every NIS passes but inf, that of another descriptor


@dataclass(slots=True, eq=False)
class MecpAssociator(Associator):
    """Polygons first, globally; then everything else jointly, within the room where rooms are used.

    Where the prediction is not sharp there are two passes: a polygon of the scan, recognised by an iterated joint test,
    corrects a copy of the filter, and all corners are paired at the pose that this implies. Where no polygon is
    recognised, the corners that fit best do the same. A sharp prediction needs one pass: to condition on the polygon is
    linear then.
    """

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner (III-B.2)."""
        if not (len(view.belief.ids) and len(corners)):
            return MatchBuilder(len(corners)).match()
        polygons = polygons if self.config.use_polygons else ()
        if self.config.is_sharp(view.belief):
            return self._paired(corners, polygons, view, belief).match()
        table = pairing_table(corners, view, belief, self.config, self.gate)
        known = np.count_nonzero((table.costs <= self.gate).any(axis=1))  # corners that may be a landmark
        corrected = self._corrected(corners, polygons, view, belief, table)
        builder = self._paired(corners, polygons, view.at(corrected.belief()), corrected)
        if 2 * builder.paired < known:  # most of them disagree: so few agree by chance
            builder = MatchBuilder(len(corners)).classify_unmatched(table.nis, self.config.ignore_gate)
        return builder.match()

    def _paired(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> MatchBuilder:
        """The decisions at the pose of a filter, with a polygon that is recognised there in one linearisation."""
        builder, table = MatchBuilder(len(corners)), pairing_table(corners, view, belief, self.config, self.gate)
        test = PolygonTest(2.0 * self.gate, self.gate, 1)
        found = PolygonMatcher(self.config, corners, view, belief, table.nis, test).first_match(polygons)
        self._pair(builder, corners, table.costs, found, view.belief, belief)
        return builder.classify_unmatched(table.nis, self.config.ignore_gate)

    def _corrected(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter, table: PairingTable
    ) -> Filter:
        """A copy of the filter, updated with the polygon that is recognised, or with the corners that fit best."""
        test = PolygonTest(OPEN, OPEN, self.config.iterations)
        found = PolygonMatcher(self.config, corners, view, belief, table.nis, test).first_match(polygons)
        if found is None:
            builder = MatchBuilder(len(corners))
            self._pair(builder, corners, table.costs, None, view.belief, belief)
            anchors = np.flatnonzero(builder.rows["id"] >= 0)
            ids = builder.rows["id"][anchors]
        else:
            anchors, ids = found.corners, found.ids
        corrected = belief.copy()
        corrected.update(*corners.measurements(anchors), ids, iterate=True)
        return corrected

    def _pair(
        self,
        builder: MatchBuilder,
        corners: Corners,
        costs: Array,
        found: PolygonMatch | None,
        predicted: Belief,
        belief: Filter,
    ) -> None:
        """Accept pairings by joint compatibility, those of the polygon that was found first."""
        config, seeds, fixed = self.config, 0, (NONE, NONE)
        if found is not None:
            fixed = found.corners, found.ids
            builder.polygon, builder.map_polygon = found.polygon, found.map_polygon
        elif not self.config.is_sharp(predicted):
            seeds = config.most_seeds
        pairs, cost = np.empty((2, costs.size), np.int64), np.empty(costs.size)
        count = possible_pairs(costs, predicted.ids, *fixed, self.gate, config.most_pairs, pairs, cost)
        if count:
            corner, ids, cost = pairs[0, :count], pairs[1, :count], cost[:count]
            innovation = belief.innovation(*corners.measurements(corner), ids)
            accept(innovation, corner, ids, cost, seeds, self.gate, config.rival_gap, builder.rows)


@compiled
def accept(
    innovation: tuple[Array, Array],
    corner: Ints,
    ids: Ints,
    cost: Array,
    seeds: int,
    gate: float,
    rival_gap: float,
    rows: Rows,
) -> None:
    """Select pairings (P,) that are jointly compatible and enter them into the rows of a match; in place.

    `innovation`: nu (2P,) and S (2P,2P). The fixed ones come first; without any, several `seeds` are tried.
    """
    nu, S = innovation
    fixed = np.flatnonzero(cost == FIXED)
    if fixed.shape[0] > 0:
        nis, ambiguous = greedy_joint_compatibility(nu, S, corner, ids, fixed, gate, rival_gap)
    else:
        nis, ambiguous = best_of_seeds(nu, S, corner, ids, cost, seeds, gate, rival_gap)
    for p in range(corner.shape[0]):
        row = rows[corner[p]]
        if ambiguous[p]:
            row.decision, row.reason = Decision.IGNORED, Reason.AMBIGUOUS
        if not math.isnan(nis[p]):
            row.id, row.nis, row.decision = ids[p], nis[p], Decision.LANDMARK
            row.reason = Reason.POLYGON if cost[p] == FIXED else Reason.JOINT
