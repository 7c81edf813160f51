"""Rival associators, for comparison only: nearest neighbour and its variants, `jcbb`, `ccda`, `mecp_paper`.

`nearest` is the baseline: gated nearest neighbour over the whole map, one to one (individual compatibility, ICNN);
`nearest_descriptor` and `nearest_room` show what descriptors alone and rooms alone are worth. `mecp_paper` is the paper
to the letter (III-B), kept so that each reading can be measured.

Combined constraint data association (CCDA): the largest set of pairs that agree on all distances.

T. Bailey, "Mobile robot localisation and mapping in extensive outdoor environments", PhD thesis, University of Sydney,
2002, chapter 3. The graph and its maximum clique are those of cliques.py, without a limit of the heading. A final joint
test (Gauss-Newton where the prediction is wide) must hold for all pairs of the clique together; while it does not, the
pair that disturbs most is left out.

Nodes are limited by the gate of the pose, by rooms and by descriptors (`use_rooms`, `use_descriptor`); polygons are
never used. Distances do not show a reflection: the joint test does.

Joint compatibility branch and bound (JCBB): the most pairs that fit jointly, at the least joint distance.

J. Neira and J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17(6), 2001. A hypothesis pairs each corner with one of the landmarks inside its
own gate, or with none; every pair that is added must keep the joint distance nu^T S^-1 nu, with all cross-covariances,
inside the gate of chi-square with two degrees of freedom per pair. A branch that cannot have more pairs than the best
hypothesis, or as many at a smaller distance, is cut off.

Rooms and descriptors restrict the choices of a corner (`use_rooms`, `use_descriptor`); polygons are never used. All is
tested at the prediction, in one linearisation, and without a rule for ambiguous corners, as in the reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.association.cliques import ANY_HEADING, PairGraph, jointly_compatible
from mecp_env.slam.association.gating import MatchBuilder, chi2_gate, one_to_one, pairing_table
from mecp_env.slam.association.mecp import map_polygons_of
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


def pair_nearest(builder: MatchBuilder, nis: Array, landmarks: Ints, gate: float) -> None:
    """Give each corner still NEW its nearest landmark by `nis` (n,N), one to one, inside the gate."""
    row = one_to_one(nis, gate)
    corners = np.flatnonzero((row >= 0) & (builder.rows["decision"] == int(Decision.NEW)))
    rows = row[corners]
    builder.assign(corners, Decision.LANDMARK, Reason.ROOM, landmarks[rows], nis[corners, rows])


@dataclass(slots=True, eq=False)
class NearestMaskedAssociator(Associator):
    """As `nearest` among the landmarks that `SWITCHES` allow, whatever the switches of the configuration are."""

    config: AssociationConfig
    SWITCHES: ClassVar[dict[str, bool]] = {}

    def __post_init__(self) -> None:
        self.config = self.config.model_copy(update=self.SWITCHES)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        gate = chi2_gate(2, self.config.gate_probability)
        builder, table = MatchBuilder(len(corners)), pairing_table(corners, view, belief, self.config, gate)
        pair_nearest(builder, table.costs, view.belief.ids, gate)
        return builder.classify_unmatched(table.nis, self.config.ignore_gate).match()


class NearestDescriptorAssociator(NearestMaskedAssociator):
    """As `nearest` among the landmarks of the whole map whose descriptor is that of the corner."""

    __slots__ = ()
    SWITCHES: ClassVar = {"use_rooms": False, "use_descriptor": True}


class NearestRoomAssociator(NearestMaskedAssociator):
    """As `nearest` among the landmarks of the room; of all where no landmark of the room is inside the gate."""

    __slots__ = ()
    SWITCHES: ClassVar = {"use_rooms": True, "use_descriptor": False}


@dataclass(slots=True, eq=False)
class MecpPaperAssociator(Associator):
    """Polygon centres by the paper's covariance (eq. 3), two vertices by NIS, the rest implicitly; then the room."""

    config: AssociationConfig

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner (III-B.2)."""
        builder, landmarks = MatchBuilder(len(corners)), view.belief.ids
        if not len(landmarks) or not len(corners):
            return builder.match()
        gate = chi2_gate(2, self.config.gate_probability)
        table = pairing_table(corners, view, belief, self.config, home_gate=np.inf)
        for p, polygon in enumerate(polygons):
            index, ids = self._nearest_centre(corners, polygon, view, belief, gate)
            shift = _two_vertices(table.nis[polygon.corners], view.belief.rows(ids), gate) if index >= 0 else -1
            if shift >= 0:
                ids = np.roll(ids, -shift)
                builder.assign(polygon.corners, Decision.LANDMARK, Reason.POLYGON, ids)
                builder.polygon, builder.map_polygon = p, index
                break
        table.costs[:, np.isin(landmarks, builder.rows["id"])] = np.inf
        pair_nearest(builder, table.costs, landmarks, gate)
        return builder.match()

    def _nearest_centre(
        self, corners: Corners, polygon: Polygon, view: MapView, belief: Filter, gate: float
    ) -> tuple[int, Ints]:
        """The map polygon of equal cardinality with the smallest Mahalanobis distance of centres (III-B.2)."""
        z, R = corners.measurements(polygon.corners)
        best, nearest, vertices = gate, -1, polygon.corners
        for index, ids in zip(*map_polygons_of(view, len(polygon.corners)), strict=True):
            nis = belief.mean_of_gaussians_nis(z, R, ids, paper_S=True)  # eq. 3
            if nis < best:
                best, nearest, vertices = nis, int(index), ids
        return nearest, vertices


def _two_vertices(nis: Array, rows: Ints, gate: float) -> int:
    """The shift at which two consecutive vertices fit best by NIS, or -1 (III-B.2); nis (k,N)."""
    k = len(rows)
    best, found = np.inf, -1
    for shift in range(k):
        first, second = nis[0, rows[shift]], nis[1, rows[(shift + 1) % k]]
        if max(first, second) <= gate and first + second < best:
            best, found = first + second, shift
    return found


@dataclass(slots=True, eq=False)
class CcdaAssociator(Associator):
    """The clique found within `search_budget` nodes; then the best one so far counts."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        if not (len(view.belief.ids) and len(corners)):
            return builder.match()
        table = pairing_table(corners, view, belief, self.config, self.gate)
        graph = PairGraph.of(corners, table.costs, view, belief, self.config, ANY_HEADING)
        clique = self._selected(graph)
        if len(clique):
            rows, ids = graph.rows[clique], graph.ids[clique]
            iterate = not self.config.is_sharp(view.belief)
            fits = jointly_compatible(corners, rows, ids, belief, self.config, iterate)
            builder.assign(rows[fits], Decision.LANDMARK, Reason.JOINT, ids[fits], graph.costs[clique][fits])
        return builder.classify_unmatched(table.nis, self.config.ignore_gate).match()

    def _selected(self, graph: PairGraph) -> Ints:
        """Indices (k,) of the pairs that the joint test gets."""
        return graph.largest()


@dataclass(slots=True, eq=False)
class JcbbAssociator(Associator):
    """The hypothesis that JCBB finds within `search_budget` nodes; then the best one so far counts."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        if not (len(view.belief.ids) and len(corners)):
            return builder.match()
        table = pairing_table(corners, view, belief, self.config, self.gate)
        pair_jointly(builder, corners, table.costs, view.belief.ids, belief, self.config)
        return builder.classify_unmatched(table.nis, self.config.ignore_gate).match()


def pair_jointly(
    builder: MatchBuilder, corners: Corners, costs: Array, ids: Ints, belief: Filter, config: AssociationConfig
) -> int:
    """The number of nodes tried for the hypothesis of JCBB, which is entered into `builder`.

    Its pairs are among those of corners and landmarks `ids` (N,) whose `costs` (n,N) are inside the gate of one pair.
    Corners with few choices are decided first, then those that fit best; a corner tries the landmark that fits best.
    """
    gate = chi2_gate(2, config.gate_probability)
    inside = costs <= gate
    order = np.lexsort((costs.min(axis=1), inside.sum(axis=1)))
    rows, columns = order[inside[order].any(axis=1)], np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return 0
    h, HPH = predicted_measurements(belief, ids[columns])
    gates = np.array([0.0, *(chi2_gate(2 * k, config.gate_probability) for k in range(1, len(rows) + 1))])
    choices = sorted_choices(costs[np.ix_(rows, columns)], gate)
    found, _, tried = branch_and_bound(*corners.measurements(rows), h, HPH, choices, gates, config.search_budget)
    paired, columns = rows[found >= 0], columns[found[found >= 0]]
    builder.assign(paired, Decision.LANDMARK, Reason.JOINT, ids[columns], costs[paired, columns])
    return tried


def predicted_measurements(belief: Filter, ids: Ints) -> tuple[Array, Array]:
    """h (m,2) of each landmark and H P H^T (2m,2m) of all: those of exact measurements of zero.

    As H depends on the landmark alone, they hold for every corner that it may be paired with.
    """
    m = len(ids)
    nu, HPH = belief.innovation(np.zeros((m, 2)), np.zeros((2 * m, 2 * m)), ids)
    return -nu.reshape(m, 2), HPH


def sorted_choices(costs: Array, gate: float) -> Ints:
    """(n,w) the columns of `costs` (n,m) inside the gate in each row, the cheapest first; -1 where there are fewer."""
    order = np.argsort(costs, axis=1, kind="stable")
    choices: Ints = np.where(np.take_along_axis(costs, order, axis=1) <= gate, order, -1)
    return np.ascontiguousarray(choices[:, : max(int((choices >= 0).sum(axis=1).max()), 1)])


@compiled
def branch_and_bound(
    z: Array, R: Array, h: Array, HPH: Array, choices: Ints, gates: Array, budget: int
) -> tuple[Ints, float, int]:
    """(n,) landmark of each corner, or -1, the joint distance, and how many nodes were tried; at most `budget`.

    Corners z (n,2), R (2n,2n) in the order in which they are decided, landmarks h (m,2), HPH (2m,2m); `choices` (n,w)
    landmarks of each corner, in the order in which they are tried, then -1; `gates` (n+1,) of so many pairs.
    """
    n, width = choices.shape
    L, pairs = np.empty((2 * n, 2 * n + 1)), np.empty((2, n), np.int64)
    option, paired, taken = np.zeros(n + 1, np.int64), np.full(n + 1, -1), np.zeros(h.shape[0], np.bool_)
    count, distance = np.zeros(n + 1, np.int64), np.zeros(n + 1)  # of the hypothesis above each level
    best, best_count, best_distance = np.full(n, -1), 0, 0.0
    level, tried = 0, 0
    while level >= 0 and tried < budget:
        if paired[level] >= 0:
            taken[paired[level]], paired[level] = False, -1
        k, most = count[level], count[level] + n - level
        cut = most < best_count or (most == best_count and distance[level] >= best_distance)
        if cut or option[level] > width:  # below the last corner, the hypothesis is the best one or cut off
            option[level] = 0
            level -= 1
            continue
        column = choices[level, option[level]] if option[level] < width else -1
        option[level] = option[level] + 1 if column >= 0 else width + 1
        tried += 1
        count[level + 1], distance[level + 1] = k, distance[level]
        if column >= 0:
            if taken[column]:
                continue
            pairs[0, k], pairs[1, k] = level, column
            joint = distance[level] + add_pair(L, k, pairs, z, R, h, HPH)
            if not joint <= gates[k + 1]:
                continue
            taken[column], paired[level] = True, column
            count[level + 1], distance[level + 1] = k + 1, joint
            if k + 1 > best_count or (k + 1 == best_count and joint < best_distance):
                best, best_count, best_distance = paired[:n].copy(), k + 1, joint
        level += 1
    return best, best_distance, tried


@compiled
def add_pair(L: Array, k: int, pairs: Ints, z: Array, R: Array, h: Array, HPH: Array) -> float:
    """How much the pair `pairs[:, k]` adds to the joint distance of those before it; inf where S is not positive.

    Writes two rows of L (2n,2n+1), the lower Cholesky factor of S with L^-1 nu as its last column.
    """
    corner, column, added, last = pairs[0, k], pairs[1, k], 0.0, L.shape[1] - 1
    for u in range(2):
        row = 2 * k + u
        nu = z[corner, u] - h[column, u]
        y = wrap_angle(nu) if u == 1 else nu
        for c in range(row + 1):
            q, v = c // 2, c % 2
            s = HPH[2 * column + u, 2 * pairs[1, q] + v] + R[2 * corner + u, 2 * pairs[0, q] + v]
            for d in range(c):
                s -= L[row, d] * L[c, d]
            if c < row:
                L[row, c] = s / L[c, c]
                y -= L[row, c] * L[c, last]
            elif s > 0.0:
                L[row, c] = math.sqrt(s)
            else:
                return math.inf
        L[row, last] = y / L[row, row]
        added += L[row, last] * L[row, last]
    return added
