"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default).

Greedy joint compatibility with the corner descriptor: `mecp` in one pass and without polygons.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints, Rows, carrier
from mecp_env.core.jit import compiled
from mecp_env.slam.association.cliques import FirstPass
from mecp_env.slam.association.gating import (
    FIXED,
    GatedAssociator,
    MatchBuilder,
    chi2_gate,
    greedy_joint_compatibility,
    pairing_table,
    possible_pairs,
)
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import (
    NO_IDS,
    Belief,
    Corners,
    Decision,
    MapView,
    Match,
    Polygon,
    PolygonGroup,
    Reason,
)
from mecp_env.slam.protocols import Filter

OPEN = sys.float_info.max  # a gate that every NIS passes but inf, that of another descriptor


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


@compiled
def polygon_hypotheses(
    nis: Array, corners: Ints, landmarks: Ints, features: int, ids: Ints, gate: float, found: Ints, which: Ints
) -> int:
    """Write the map polygons (h,k), turned so that every vertex passes its own gate, and which (h,) they are.

    `nis` (n,N) of corners against `landmarks` (N,); `corners` (k,) are the vertices of the scan's polygon, `ids` (C,k)
    those of the map's polygons, both ccw, of so many `features`. A polygon of landmarks alone counts. Returns h;
    `found` and `which` have room for one more.
    """
    count, k = ids.shape
    row, h = np.full(features, -1), 0
    for j in range(landmarks.shape[0]):
        row[landmarks[j]] = j
    for c in range(count):
        for shift in range(k):
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
        landmarks, features = view.belief.ids, len(view.features)
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


class MecpAssociator(GatedAssociator):
    """Polygons first, globally; then everything else jointly, within the room where rooms are used.

    Where the prediction is not sharp there are two passes. In the first, a polygon of the scan, recognised by an
    iterated joint test, and the largest sets of pairs that agree on distances (cliques.py) each propose a pose: that of
    a copy of the filter which they correct. In the second, all corners are paired at each of these poses, and the pose
    that explains them clearly better than the others counts. A sharp prediction needs one pass: to condition on the
    polygon is linear then.
    """

    __slots__ = ()

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
        fixed = NO_IDS, NO_IDS
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


class JointDescriptorAssociator(MecpAssociator):
    """Pairs are accepted one by one at the prediction, each given those before it; no polygons, and one pass."""

    __slots__ = ()

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        if not (len(view.belief.ids) and len(corners)):
            return MatchBuilder(len(corners)).match()
        return self._paired(corners, (), view, belief).match()
