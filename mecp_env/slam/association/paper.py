"""The paper to the letter, so that each reading can be measured: `mecp_paper` (III-B), and no posts as landmarks (IV).

Door posts are found for doors and rooms, and left out of association and update.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.slam.association.gating import GatedAssociator, MatchBuilder, chi2_gate, one_to_one, pairing_table
from mecp_env.slam.association.rivals import pair_nearest
from mecp_env.slam.checks import check_match
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import (
    NO_DOORS,
    Belief,
    CornerKind,
    Corners,
    Decision,
    FeatureState,
    MapView,
    Match,
    Polygon,
    PolygonGroup,
    Reason,
)
from mecp_env.slam.protocols import Associator, Filter


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


JAMB = int(CornerKind.JAMB)


@dataclass(slots=True, eq=False)
class PostsApart(Associator):
    """Another associator, which sees no posts: neither those of the scan nor those of the map (`use_posts` off).

    Posts stay features, so that doors move with the map. A corner that is a post of the map is PROVISIONAL: it has
    an id, and updates nothing. The filter holds a post as one scan has augmented it; what is never measured again
    changes no other estimate.
    """

    others: Associator
    config: AssociationConfig

    @property
    def stands_for(self) -> Associator:
        """The associator, which may be a custom one."""
        return self.others

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner; a post is never a LANDMARK."""
        plain = np.flatnonzero(corners.kind != JAMB)
        kept = [p for p, polygon in enumerate(polygons) if np.isin(polygon.corners, plain).all()]
        rings = tuple(replace(polygons[p], corners=np.searchsorted(plain, polygons[p].corners)) for p in kept)
        shown = without_posts(view, plain)
        found = self.others.associate(some_corners(corners, plain), rings, shown, _alone(belief, shown.belief.ids))
        check_match(found, len(plain), len(view.features))
        builder = MatchBuilder(len(corners))
        builder.assign(plain, found.decision, found.reason, found.ids, found.nis)
        builder.polygon = kept[found.polygon] if found.polygon >= 0 else -1
        builder.map_polygon = found.known
        return self._name_posts(builder.match(), corners, view, belief)

    def remember(self, match: Match) -> None:
        """As the other associator does."""
        self.others.remember(match)

    def _name_posts(self, match: Match, corners: Corners, view: MapView, belief: Filter) -> Match:
        """The match in which each corner that is left may be a post of the map, the nearest inside the gate.

        A post of the scan may also be a landmark that was not seen to be a post before; another corner only a post.
        """
        ids, gate = view.belief.ids, chi2_gate(2, self.config.gate_probability)
        costs = pairing_table(corners, view, belief, self.config, home_gate=math.inf).costs
        costs[match.decision != int(Decision.NEW)] = math.inf
        costs[:, np.isin(ids, match.ids[match.recognised()])] = math.inf
        costs[np.ix_(corners.kind != JAMB, ~are_posts(view, ids))] = math.inf
        row = one_to_one(costs, gate)
        found = np.flatnonzero(row >= 0)
        return match.assign(found, ids[row[found]], int(Decision.PROVISIONAL), int(Reason.TRACK))


def _alone(belief: Filter, ids: Ints) -> Filter:
    """A filter that holds the landmarks `ids` (k,) alone, a copy where the given one holds others."""
    gone = np.setdiff1d(belief.ids, ids)
    if len(gone):
        belief = belief.copy()
        belief.remove(gone)
    return belief


def are_posts(view: MapView, ids: Ints) -> Bools:
    """Which of the features `ids` (any shape) are posts of doors."""
    posts: Bools = view.features.rows["kind"][ids] == JAMB
    return posts


def some_corners(corners: Corners, index: Ints) -> Corners:
    """The corners `index` (k,) alone, without doorways."""
    z, cov = corners.measurements(index)
    marks = corners.kind[index], corners.convex[index], corners.normals[index]
    return Corners(z, cov, *marks, corners.beyond[index], corners.sites[index], NO_DOORS)


def without_posts(view: MapView, index: Ints) -> MapView:
    """The map without posts, and without the polygons that have one, for the corners `index` (k,) alone."""
    known = view.belief
    rows = np.flatnonzero(~are_posts(view, known.ids))
    belief = Belief(known.T_map_robot, known.pose_cov, known.ids[rows], known.p_map[rows], known.covs[rows])
    groups = {}
    for cardinality, group in view.groups.items():
        whole = ~are_posts(view, group.ids).any(axis=1)
        groups[cardinality] = PolygonGroup(group.index[whole], group.ids[whole])
    past = None if view.past is None else np.flatnonzero(np.isin(index, view.past))
    return MapView(view.step, belief, view.features, groups, view.graph, view.through[index], past)
