"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.association.gating import chi2_gate, pairing_table, possible_pairs
from mecp_env.slam.association.joint_compatibility import best_of_seeds, greedy_joint_compatibility
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.association.polygon_matching import PolygonMatcher
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Belief, Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Rows = NDArray[np.void]

FIXED = -1.0  # cost of a pair that a polygon match has fixed: below every NIS


@dataclass(slots=True, eq=False)
class MecpAssociator(Associator):
    """Polygons first, globally; then everything else jointly, within the room where rooms are used."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner (III-B.2)."""
        builder, landmarks = MatchBuilder(len(corners)), view.belief.ids
        nis = np.empty((len(corners), 0))
        if len(landmarks) and len(corners):
            table = pairing_table(corners, view, belief, self.config, self.gate)
            nis, costs = table.nis, table.costs
            matcher = PolygonMatcher(self.config, corners, view, belief, nis)
            found = matcher.first_match(polygons) if self.config.use_polygons else None
            seeds = 0 if found is not None or self._is_sharp(view.belief) else self.config.most_seeds
            if found is not None:
                costs[found.corners] = np.inf
                costs[found.corners, view.belief.rows(found.ids)] = FIXED
                builder.polygon, builder.map_polygon = found.polygon, found.map_polygon
            self._pair(builder, corners, costs, landmarks, seeds, belief)
        return builder.classify_unmatched(corners, view, nis, self.config.ignore_gate).match()

    def _pair(
        self, builder: MatchBuilder, corners: Corners, costs: Array, landmarks: Ints, seeds: int, belief: Filter
    ) -> None:
        """Accept pairings by joint compatibility, those that a polygon has fixed first."""
        config = self.config
        corner, ids, cost = np.empty(costs.size, np.int64), np.empty(costs.size, np.int64), np.empty(costs.size)
        count = possible_pairs(costs, landmarks, self.gate, config.most_pairs, corner, ids, cost)
        if count:
            corner, ids, cost = corner[:count], ids[:count], cost[:count]
            innovation = belief.innovation(*corners.measurements(corner), ids)
            accept(innovation, corner, ids, cost, seeds, self.gate, config.rival_gap, builder.rows)

    def _is_sharp(self, belief: Belief) -> bool:
        """True while the pose is so well known that a free choice is enough to start from."""
        x, y, heading = belief.pose_cov.diagonal().tolist()
        known: bool = max(x, y) < self.config.sharp_sigma_m**2
        return known and heading < math.radians(self.config.sharp_sigma_deg) ** 2


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
