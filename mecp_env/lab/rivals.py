"""Rival associators: nearest neighbour and its variants, `jcbb` and `ccda`.

`nearest` is the baseline: gated nearest neighbour over the whole map, one to one (individual compatibility, ICNN);
`nearest_descriptor` and `nearest_room` show what descriptors alone and rooms alone are worth.

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
from abc import abstractmethod

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.association.cliques import ANY_HEADING, PairGraph, jointly_compatible
from mecp_env.slam.association.gating import GatedAssociator, MatchBuilder, chi2_gate, one_to_one, pairing_table
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


class NearestAssociator(GatedAssociator):
    """No polygons, no rooms, no descriptor: the smallest Mahalanobis distance inside the gate, each landmark once."""

    __slots__ = ()

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        nis = belief.individual_nis(corners.z, corners.R, view.belief.ids)
        pair_nearest(builder, nis, view.belief.ids, self.gate)
        return builder.classify_unmatched(nis, self.config.ignore_gate).match()


def pair_nearest(builder: MatchBuilder, nis: Array, landmarks: Ints, gate: float) -> None:
    """Give each corner still NEW its nearest landmark by `nis` (n,N), one to one, inside the gate."""
    row = one_to_one(nis, gate)
    corners = np.flatnonzero((row >= 0) & (builder.rows["decision"] == int(Decision.NEW)))
    rows = row[corners]
    builder.assign(corners, Decision.LANDMARK, Reason.ROOM, landmarks[rows], nis[corners, rows])


class TableAssociator(GatedAssociator):
    """Pairs from one table of NIS at the prediction, limited by rooms and descriptors where they are used."""

    __slots__ = ()

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        if len(view.belief.ids) and len(corners):
            table = pairing_table(corners, view, belief, self.config, self.gate)
            self._pair(builder, corners, table.costs, view, belief)
            builder.classify_unmatched(table.nis, self.config.ignore_gate)
        return builder.match()

    @abstractmethod
    def _pair(self, builder: MatchBuilder, corners: Corners, costs: Array, view: MapView, belief: Filter) -> None:
        """Enter pairs of corners and landmarks with these costs (n,N); inf: another room or descriptor."""


class NearestMaskedAssociator(TableAssociator):
    """As `nearest` among the landmarks that rooms and descriptors allow."""

    __slots__ = ()

    def _pair(self, builder: MatchBuilder, corners: Corners, costs: Array, view: MapView, belief: Filter) -> None:
        pair_nearest(builder, costs, view.belief.ids, self.gate)


def nearest_descriptor(config: AssociationConfig) -> Associator:
    """As `nearest` among the landmarks of the whole map whose descriptor is that of the corner."""
    return NearestMaskedAssociator(config.model_copy(update={"use_rooms": False, "use_descriptor": True}))


def nearest_room(config: AssociationConfig) -> Associator:
    """As `nearest` among the landmarks of the room; of all where no landmark of the room is inside the gate."""
    return NearestMaskedAssociator(config.model_copy(update={"use_rooms": True, "use_descriptor": False}))


class CcdaAssociator(TableAssociator):
    """The clique found within `search_budget` nodes; then the best one so far counts."""

    __slots__ = ()

    def _pair(self, builder: MatchBuilder, corners: Corners, costs: Array, view: MapView, belief: Filter) -> None:
        graph = PairGraph.of(corners, costs, view, belief, self.config, ANY_HEADING)
        clique = self._selected(graph)
        rows, ids = graph.rows[clique], graph.ids[clique]
        iterate = not self.config.is_sharp(view.belief)
        fits = jointly_compatible(corners, rows, ids, belief, self.config, iterate)
        builder.assign(rows[fits], Decision.LANDMARK, Reason.JOINT, ids[fits], graph.costs[clique][fits])

    def _selected(self, graph: PairGraph) -> Ints:
        """Indices (k,) of the pairs that the joint test gets."""
        return graph.largest()


class JcbbAssociator(TableAssociator):
    """The hypothesis that JCBB finds within `search_budget` nodes; then the best one so far counts."""

    __slots__ = ()

    def _pair(self, builder: MatchBuilder, corners: Corners, costs: Array, view: MapView, belief: Filter) -> None:
        pair_jointly(builder, corners, costs, view.belief.ids, belief, self.config)


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
