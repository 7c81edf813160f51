"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default).

Greedy joint compatibility with the corner descriptor: `mecp` in one pass and without polygons.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.carriers import Array, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.association.first_pass import FirstPass
from mecp_env.slam.association.gating import FIXED, chi2_gate, pairing_table, possible_pairs
from mecp_env.slam.association.joint_compatibility import greedy_joint_compatibility
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

    Where the prediction is not sharp there are two passes. In the first, a polygon of the scan, recognised by an
    iterated joint test, and the largest sets of pairs that agree on distances (cliques.py) each propose a pose: that of
    a copy of the filter which they correct. In the second, all corners are paired at each of these poses, and the pose
    that explains them clearly better than the others counts. A sharp prediction needs one pass: to condition on the
    polygon is linear then.
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
        return self._in_two_passes(corners, polygons, view, belief).match()

    def _in_two_passes(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter
    ) -> MatchBuilder:
        """The decisions at the pose that the first pass finds; without one, no corner is paired."""

        def pair(corrected: Filter) -> MatchBuilder:
            return self._paired(corners, polygons, view.at(corrected.belief()), corrected)

        turn = math.sqrt(self.config.rival_gap * view.belief.pose_cov.item(8))
        table = pairing_table(corners, view, belief, self.config, self.gate, turn)
        test = PolygonTest(OPEN, OPEN, iterate=True)
        found = PolygonMatcher(self.config, corners, view, belief, table.nis, test).first_match(polygons)
        poses = self._first_pass()(self.config, corners, view, belief, pair)
        if found is not None:
            poses.propose(found.corners, found.ids)
        poses.propose_cliques(table.costs)
        builder = poses.best()
        known = np.count_nonzero((table.costs <= self.gate).any(axis=1))  # corners that may be a landmark
        if builder is None or 2 * builder.paired < known:  # most of them disagree: so few agree by chance
            builder = MatchBuilder(len(corners)).classify_unmatched(table.nis, self.config.ignore_gate)
        return builder

    def _first_pass(self) -> type[FirstPass]:
        """What proposes poses."""
        return FirstPass

    def _paired(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> MatchBuilder:
        """The decisions at the pose of a filter, with a polygon that is recognised there in one linearisation."""
        builder, table = MatchBuilder(len(corners)), pairing_table(corners, view, belief, self.config, self.gate)
        test = PolygonTest(2.0 * self.gate, self.gate, iterate=False)
        found = PolygonMatcher(self.config, corners, view, belief, table.nis, test).first_match(polygons)
        self._pair(builder, corners, table.costs, found, view.belief, belief)
        return builder.classify_unmatched(table.nis, self.config.ignore_gate)

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
        fixed = NONE, NONE
        if found is not None:
            fixed = found.corners, found.ids
            builder.polygon, builder.map_polygon = found.polygon, found.map_polygon
        pairs, cost = np.empty((2, costs.size), np.int64), np.empty(costs.size)
        count = possible_pairs(costs, predicted.ids, *fixed, self.gate, pairs, cost)
        if count:
            corner, ids, cost = pairs[0, :count], pairs[1, :count], cost[:count]
            innovation = belief.innovation(*corners.measurements(corner), ids)
            accept(innovation, corner, ids, cost, self.gate, self.config.rival_gap, builder.rows)


@compiled
def accept(
    innovation: tuple[Array, Array],
    corner: Ints,
    ids: Ints,
    cost: Array,
    gate: float,
    rival_gap: float,
    rows: Rows,
) -> None:
    """Select pairings (P,) that are jointly compatible and enter them into the rows of a match; in place.

    `innovation`: nu (2P,) and S (2P,2P). The fixed ones come first.
    """
    nu, S = innovation
    fixed = np.flatnonzero(cost == FIXED)
    nis, ambiguous = greedy_joint_compatibility(nu, S, corner, ids, fixed, gate, rival_gap)
    for p in range(corner.shape[0]):
        row = rows[corner[p]]
        if ambiguous[p]:
            row.decision, row.reason = Decision.IGNORED, Reason.AMBIGUOUS
        if not math.isnan(nis[p]):
            row.id, row.nis, row.decision = ids[p], nis[p], Decision.LANDMARK
            row.reason = Reason.POLYGON if cost[p] == FIXED else Reason.JOINT


@dataclass(slots=True, eq=False)
class JointDescriptorAssociator(MecpAssociator):
    """Pairs are accepted one by one at the prediction, each given those before it (joint_compatibility.py).

    Descriptors and rooms are switches.
    """

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        if not (len(view.belief.ids) and len(corners)):
            return MatchBuilder(len(corners)).match()
        return self._paired(corners, (), view, belief).match()
