"""Combined constraint data association (CCDA): the largest set of pairs that agree on all distances.

T. Bailey, "Mobile robot localisation and mapping in extensive outdoor environments", PhD thesis, University of Sydney,
2002, chapter 3. Nodes of a graph are the pairs of corner and landmark that may be one. Two of them are joined if the
distance of their corners is that of their landmarks, within the gate of both covariances: a relative constraint, which
needs no pose. The maximum clique is the largest set of pairs all of which agree; of equally large ones, that with the
least sum of the NIS of its pairs and distances. A final joint test (Gauss-Newton where
the prediction is wide) must hold for all of its pairs together; while it does not, the pair that disturbs most is left
out.

Nodes are limited by the gate of the pose, by rooms and by descriptors (`use_rooms`, `use_descriptor`); polygons are
never used. Distances do not show a reflection: the joint test does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.association.gating import chi2_gate, pairing_table
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class CcdaAssociator(Associator):
    """The clique found within `search_budget` nodes; then the best one so far counts."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder, ids = MatchBuilder(len(corners)), view.belief.ids
        if not (len(ids) and len(corners)):
            return builder.match()
        table = pairing_table(corners, view, belief, self.config, self.gate)
        rows, columns = self._nodes(table.costs)
        if len(rows):
            edges = self._graph(corners, rows, columns, ids, belief)
            clique, _ = maximum_clique(edges, rows, table.costs[rows, columns], self.config.search_budget)
            rows, columns = rows[clique], columns[clique]
            iterations = 1 if self.config.is_sharp(view.belief) else self.config.iterations
            fits = self._jointly_compatible(corners, rows, ids[columns], belief, iterations)
            rows, columns = rows[fits], columns[fits]
            builder.assign(rows, Decision.LANDMARK, Reason.JOINT, ids[columns], table.costs[rows, columns])
        return builder.classify_unmatched(table.nis, self.config.ignore_gate).match()

    def _nodes(self, costs: Array) -> tuple[Ints, Ints]:
        """Corner and column (P,) of each pair inside the gate, corners with few choices first.

        Of more pairs than a graph of `search_budget` edges can have, the cheapest.
        """
        inside = costs <= self.gate
        rows, columns = np.nonzero(inside)
        cheapest = np.argsort(costs[rows, columns], kind="stable")[: math.isqrt(2 * self.config.search_budget)]
        rows, columns = rows[cheapest], columns[cheapest]
        order = np.lexsort((rows, inside.sum(axis=1)[rows]))
        return rows[order], columns[order]

    def _graph(self, corners: Corners, rows: Ints, columns: Ints, ids: Ints, belief: Filter) -> Array:
        """(P,P) as `constraint_graph`."""
        seen, row = np.unique(rows, return_inverse=True)
        known, column = np.unique(columns, return_inverse=True)
        mean, cov = belief.marginal(ids[known])
        scan = distances(*cartesian(*corners.measurements(seen)))
        of_map = distances(mean[3:].reshape(-1, 2), cov[3:, 3:])
        return constraint_graph(scan, of_map, row, column, chi2_gate(1, self.config.gate_probability))

    def _jointly_compatible(self, corners: Corners, rows: Ints, ids: Ints, belief: Filter, iterations: int) -> Ints:
        """Which of the pairs (k,) fit together at one pose: all, or those left by the ones that disturb most."""
        kept = np.arange(len(rows))
        while len(kept):
            joint = belief.joint_nis(*corners.measurements(rows[kept]), ids[kept], iterations)
            if joint <= chi2_gate(2 * len(kept), self.config.gate_probability):
                break
            others = [np.delete(kept, k) for k in range(len(kept))]
            without = [belief.joint_nis(*corners.measurements(rows[o]), ids[o], iterations) for o in others]
            kept = others[int(np.argmin(without))]
        return kept


def cartesian(z: Array, R: Array) -> tuple[Array, Array]:
    """Points (n,2) of ranges and bearings z (n,2), and their joint covariance (2n,2n), of R (2n,2n)."""
    points = polar_to_points(z)
    x, y = points.T
    B = np.stack([np.stack([x / z[:, 0], -y], axis=1), np.stack([y / z[:, 0], x], axis=1)], axis=1)  # (n,2,2)
    cov = np.einsum("iab,ibjc,jdc->iajd", B, R.reshape(len(z), 2, len(z), 2), B)
    return points, cov.reshape(R.shape)


def distances(points: Array, cov: Array) -> tuple[Array, Array]:
    """(n,n) distance of each two points (n,2), and its variance, of their joint covariance (2n,2n)."""
    n = len(points)
    offsets = points[:, None] - points
    length = np.hypot(offsets[..., 0], offsets[..., 1])
    along = offsets / np.where(length > 0.0, length, 1.0)[..., None]
    blocks = cov.reshape(n, 2, n, 2).transpose(0, 2, 1, 3)
    own = blocks[np.arange(n), np.arange(n)]
    of_offset = own[:, None] + own - blocks - blocks.transpose(0, 1, 3, 2)
    return length, np.einsum("ika,ikab,ikb->ik", along, of_offset, along)


def constraint_graph(
    scan: tuple[Array, Array], of_map: tuple[Array, Array], corner: Ints, landmark: Ints, gate: float
) -> Array:
    """(P,P) NIS of the distance between two pairs of `corner` and `landmark` (P,); inf where they disagree.

    `scan` (n,n) and `of_map` (m,m) are distances and variances. Two pairs of one corner or of one landmark disagree.
    """
    differ = (corner[:, None] != corner) & (landmark[:, None] != landmark)
    (seen, seen_var), (known, known_var) = (
        [values[np.ix_(index, index)] for values in one] for one, index in ((scan, corner), (of_map, landmark))
    )
    nis = np.full(differ.shape, math.inf)
    np.divide((seen - known) ** 2, seen_var + known_var, out=nis, where=differ)
    nis[nis > gate] = math.inf
    return nis


@compiled
def maximum_clique(edges: Array, group: Ints, cost: Array, budget: int) -> tuple[Ints, int]:
    """Nodes (k,) of the largest clique, of equally large ones the cheapest, and how many were tried; at most `budget`.

    A clique costs the `cost` (P,) of its nodes and the cost of its `edges` (P,P), symmetric, inf without an edge; none
    is negative. The nodes of one `group` (P,) follow each other and have no edge between them, so that the groups left
    limit what a clique can still gain.
    """
    P = group.shape[0]
    levels = 2
    for p in range(1, P):
        levels += group[p] != group[p - 1]
    nodes, size, at = np.empty((levels, P), np.int64), np.zeros(levels, np.int64), np.zeros(levels, np.int64)
    added = np.empty((levels, P))  # what a node costs that joins the clique of its level
    left, least = np.zeros((levels, P + 1), np.int64), np.zeros((levels, P + 1))  # groups from here on, least costs
    clique, total = np.empty(levels, np.int64), np.zeros(levels)
    best, best_total = np.empty(0, np.int64), 0.0
    for p in range(P):
        nodes[0, p], added[0, p] = p, cost[p]
    size[0] = P
    limit_gain(nodes[0], P, group, added[0], left[0], least[0])
    level, tried = 0, 0
    while level >= 0 and tried < budget:
        k, most = at[level], level + left[level, at[level]]
        bound = total[level] + least[level, k]
        if k == size[level] or most < best.shape[0] or (most == best.shape[0] and bound >= best_total):
            level -= 1
            continue
        node = nodes[level, k]
        at[level] += 1
        tried += 1
        clique[level], total[level + 1] = node, total[level] + added[level, k]
        if level + 1 > best.shape[0] or (level + 1 == best.shape[0] and total[level + 1] < best_total):
            best, best_total = clique[: level + 1].copy(), total[level + 1]
        count = 0
        for q in range(k + 1, size[level]):
            edge = edges[node, nodes[level, q]]
            if edge < math.inf:
                nodes[level + 1, count], added[level + 1, count] = nodes[level, q], added[level, q] + edge
                count += 1
        level += 1
        at[level], size[level] = 0, count
        limit_gain(nodes[level], count, group, added[level], left[level], least[level])
    return best, tried


@compiled
def limit_gain(nodes: Ints, count: int, group: Ints, added: Array, left: Ints, least: Array) -> None:
    """Write how many groups the `nodes` from each position to `count` on are of, and the sum of their least costs.

    `added` is the cost of each of the nodes.
    """
    left[count], least[count] = 0, 0.0
    cheapest, rest = 0.0, 0.0
    for q in range(count - 1, -1, -1):
        same = q + 1 < count and group[nodes[q]] == group[nodes[q + 1]]
        rest = rest if same else least[q + 1]
        cheapest = min(cheapest, added[q]) if same else added[q]
        left[q] = left[q + 1] if same else left[q + 1] + 1
        least[q] = rest + cheapest
