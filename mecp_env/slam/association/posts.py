"""No posts of doors as landmarks (IV): they are found for doors and rooms, and left out of association and update."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.carriers import Bools, Ints
from mecp_env.slam.association.gating import MatchBuilder, chi2_gate, one_to_one, pairing_table
from mecp_env.slam.checks import check_match
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import (
    NO_DOORS,
    Belief,
    CornerKind,
    Corners,
    Decision,
    MapView,
    Match,
    Polygon,
    PolygonGroup,
    Reason,
)
from mecp_env.slam.protocols import Associator, Filter

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
