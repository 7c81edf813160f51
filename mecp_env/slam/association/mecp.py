"""Association by Maximum Empty Convex Polygons, then by joint compatibility (III-B; our reading, the default)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.association.base import chi2_gate, undecided
from mecp_env.slam.association.joint_compatibility import best_growth, grow, likeliest
from mecp_env.slam.association.polygon_matching import RingMatch, match_rings
from mecp_env.slam.association.single_corners import pairing_table, pairs_beside_ring, settle
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Belief, Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NONE = np.empty(0, np.int64)
LANDMARK, IGNORED = int(Decision.LANDMARK), int(Decision.IGNORED)
POLYGON, JOINT, AMBIGUOUS = int(Reason.POLYGON), int(Reason.JOINT), int(Reason.AMBIGUOUS)


@dataclass(slots=True, eq=False)
class MecpAssociator(Associator):
    """Polygons first, globally; then everything else jointly, within the room where rooms are used."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner (III-B.2)."""
        match = undecided(len(corners))
        if not len(view.belief.ids) or not len(corners):
            settle(match, corners, view, np.full(len(corners), np.inf), self.config.ignore_gate)
            return match
        table = pairing_table(corners, view, belief, self.config, self.gate)
        ring = self._recognise(corners, polygons, view, table.nis, belief)
        match = self._pair(match, corners, table.costs, ring, view, belief)
        settle(match, corners, view, table.nearest, self.config.ignore_gate)
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
        landmarks, gate = view.belief.ids, self.gate
        fixed = np.empty(len(corners), np.int64)
        corner, row = np.empty(costs.size, np.int64), np.empty(costs.size, np.int64)
        by_polygon = (NONE, NONE) if ring is None else (ring.corners, ring.ids)
        most = self.config.most_pairs
        count = pairs_beside_ring(costs, gate, most, landmarks, *by_polygon, fixed, corner, row)
        if not count:
            return match
        corner, row = corner[:count], row[:count]
        z, R = corners.measurements(corner)
        ids = landmarks[row]
        nu, S = belief.innovation(z, R, ids)
        seeds = 0 if ring is not None or self._is_sharp(view.belief) else self.config.most_seeds
        columns = match.ids, match.decision, match.reason, match.nis
        accept(nu, S, corner, row, ids, fixed, costs, seeds, gate, self.config.rival_gap, *columns)
        return match if ring is None else Match(*columns, ring.polygon, ring.known, match.closure)

    def _is_sharp(self, belief: Belief) -> bool:
        """True while the pose is so well known that a free choice is enough to start from."""
        x, y, heading = belief.pose_cov.diagonal().tolist()
        known: bool = max(x, y) < self.config.sharp_sigma_m**2
        return known and heading < math.radians(self.config.sharp_sigma_deg) ** 2


@compiled
def accept(
    nu: Array,
    S: Array,
    corner: Ints,
    row: Ints,
    ids: Ints,
    fixed: Ints,
    costs: Array,
    most_seeds: int,
    gate: float,
    gap: float,
    match_ids: Ints,
    decision: Ints,
    reason: Ints,
    match_nis: Array,
) -> None:
    """Select pairings (P,) that are jointly compatible and enter them into the columns of a match; in place.

    Those that a polygon has `fixed` come first; without any, the best of several growths counts.
    """
    seed = fixed_pairs(corner, row, fixed)
    if seed.shape[0] > 0:
        nis, ambiguous = grow(nu, S, corner, row, seed, gate, gap)
    else:
        seeds = likeliest(costs, corner, row, most_seeds)
        nis, ambiguous = best_growth(nu, S, corner, row, seeds, gate, gap)
    write_pairs(match_ids, decision, reason, match_nis, corner, ids, nis, ambiguous, fixed)


@compiled
def fixed_pairs(corner: Ints, row: Ints, fixed: Ints) -> Ints:
    """The pairings (of P) that the polygon has `fixed` (n,)."""
    pairs = np.empty(corner.shape[0], np.int64)
    count = 0
    for p in range(corner.shape[0]):
        if fixed[corner[p]] == row[p]:
            pairs[count] = p
            count += 1
    return pairs[:count]


@compiled
def write_pairs(
    match_ids: Ints,
    decision: Ints,
    reason: Ints,
    match_nis: Array,
    corner: Ints,
    ids: Ints,
    nis: Array,
    ambiguous: Bools,
    fixed: Ints,
) -> None:
    """Enter the accepted pairs (nis not nan) and the ambiguous corners into the columns of a match; in place."""
    for p in range(corner.shape[0]):
        c = corner[p]
        if ambiguous[p]:
            decision[c], reason[c] = IGNORED, AMBIGUOUS
        if not math.isnan(nis[p]):
            match_ids[c], match_nis[c], decision[c] = ids[p], nis[p], LANDMARK
            reason[c] = POLYGON if fixed[c] >= 0 else JOINT
