"""Sets of pairs that agree with each other (Bailey 2002, chapter 3), and the pose they give at a wide prediction.

Nodes of a graph are the pairs of corner and landmark that may be one. Two of them are joined if the distance of their
corners is that of their landmarks, within the gate of both covariances; where the prediction limits it, also if the
heading that they imply is possible, and turns the faces of both corners to those of their landmarks. The maximum clique
is the largest set of pairs all of which agree; of equally large ones, that with the least sum of the NIS of its pairs
and distances.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import face_turn, polar_to_points, wrap_angle
from mecp_env.slam.association.gating import MatchBuilder, chi2_gate
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import NO_ID, Corners, MapView
from mecp_env.slam.protocols import Filter

Relations = tuple[Array, Array, Array]  # (n,n) m distances, rad directions, m^2 variances of the distances
FEWER = 2  # pairs that the clique of a rival may have less than the best pose has


class Headings(NamedTuple):
    """What is known of the heading (rad): mean, variance, and how far a face may be turned."""

    mean: float
    variance: float
    tolerance: float


ANY_HEADING = Headings(0.0, math.inf, math.inf)


@dataclass(slots=True)
class PairGraph:
    """The pairs (P,) that may be true, with their costs, and the NIS (P,P) of their distances; inf: they disagree."""

    rows: Ints  # (P,) corner
    ids: Ints  # (P,) landmark
    costs: Array
    edges: Array
    alive: Bools  # (P,) not yet part of a clique that was taken
    budget: int  # nodes that a search tries at most

    @classmethod
    def of(
        cls, corners: Corners, costs: Array, view: MapView, belief: Filter, config: AssociationConfig, known: Headings
    ) -> PairGraph:
        """The graph of the pairs whose `costs` (n,N) are inside the gate of one pair."""
        rows, columns = candidate_pairs(costs, chi2_gate(2, config.gate_probability), config.search_budget)
        ids = view.belief.ids[columns]
        edges = np.empty((len(rows), len(rows)))
        if len(rows):
            seen, corner = np.unique(rows, return_inverse=True)
            mapped, landmark = np.unique(ids, return_inverse=True)
            mean, cov = belief.marginal(mapped)
            scan = relations(*cartesian(*corners.measurements(seen)))
            of_map = relations(mean[3:].reshape(-1, 2), cov[3:, 3:])
            faces = corners.normals[seen], view.features.rows["normals"][mapped]
            gate = chi2_gate(1, config.gate_probability)
            constraint_graph(scan, of_map, corner, landmark, faces, (*known,), gate, edges)
        return cls(rows, ids, costs[rows, columns], edges, np.ones(len(rows), np.bool_), config.search_budget)

    def largest(self, least: int = 1) -> Ints:
        """Indices (k,) of the maximum clique of the pairs alive; (0,) without one of at least `least` pairs."""
        nodes = np.flatnonzero(self.alive)
        if not len(nodes):
            return nodes
        edges = self.edges if len(nodes) == len(self.rows) else self.edges[np.ix_(nodes, nodes)]
        clique, _ = maximum_clique(edges, self.rows[nodes], self.costs[nodes], least, self.budget)
        return nodes[clique]

    def leave_out(self, ids: Ints) -> None:
        """Take away the pairs of corner i with ids[i] (n,)."""
        self.alive &= ids[self.rows] != self.ids


def candidate_pairs(costs: Array, gate: float, budget: int) -> tuple[Ints, Ints]:
    """Corner and column (P,) of each pair of `costs` (n,N) inside the gate, corners with few choices first.

    Of more pairs than a graph of `budget` edges can have, the cheapest.
    """
    inside = costs <= gate
    rows, columns = np.nonzero(inside)
    cheapest = np.sort(np.argsort(costs[rows, columns], kind="stable")[: math.isqrt(2 * budget)])
    rows, columns = rows[cheapest], columns[cheapest]
    order = np.lexsort((rows, inside.sum(axis=1)[rows]))
    return rows[order], columns[order]


def jointly_compatible(
    corners: Corners, rows: Ints, ids: Ints, belief: Filter, config: AssociationConfig, iterate: bool
) -> Ints:
    """Which of the pairs (k,) fit together at one pose: all, or those left by the ones that disturb most."""
    kept = np.arange(len(rows))
    while len(kept):
        joint = belief.joint_nis(*corners.measurements(rows[kept]), ids[kept], iterate)
        if joint <= chi2_gate(2 * len(kept), config.gate_probability):
            break
        others = [np.delete(kept, k) for k in range(len(kept))]
        without = [belief.joint_nis(*corners.measurements(rows[o]), ids[o], iterate) for o in others]
        kept = others[int(np.argmin(without))]
    return kept


def cartesian(z: Array, R: Array) -> tuple[Array, Array]:
    """Points (n,2) of ranges and bearings z (n,2), and their joint covariance (2n,2n), of R (2n,2n)."""
    points = polar_to_points(z)
    x, y = points.T
    B = np.stack([np.stack([x / z[:, 0], -y], axis=1), np.stack([y / z[:, 0], x], axis=1)], axis=1)  # (n,2,2)
    cov = np.einsum("iab,ibjc,jdc->iajd", B, R.reshape(len(z), 2, len(z), 2), B)
    return points, cov.reshape(R.shape)


@compiled
def relations(points: Array, cov: Array) -> tuple[Array, Array, Array]:
    """Distance, direction and variance of the distance (n,n) of each two points (n,2); `cov` (2n,2n) is joint."""
    n = points.shape[0]
    length, direction, variance = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        for k in range(i):
            x, y = points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]
            far = math.hypot(x, y)
            if far > 0.0:
                x, y = x / far, y / far
            a, b = 2 * i, 2 * k
            xx = cov[a, a] + cov[b, b] - 2.0 * cov[a, b]
            xy = cov[a, a + 1] + cov[b, b + 1] - cov[a, b + 1] - cov[a + 1, b]
            yy = cov[a + 1, a + 1] + cov[b + 1, b + 1] - 2.0 * cov[a + 1, b + 1]
            length[i, k] = length[k, i] = far
            variance[i, k] = variance[k, i] = x * x * xx + 2.0 * x * y * xy + y * y * yy
            direction[i, k], direction[k, i] = math.atan2(y, x), math.atan2(-y, -x)
    return length, direction, variance


@compiled
def constraint_graph(
    scan: Relations,
    of_map: Relations,
    corner: Ints,
    landmark: Ints,
    faces: tuple[Array, Array],
    known: tuple[float, float, float],
    gate: float,
    edges: Array,
) -> None:
    """Write the NIS (P,P) of the distance between two pairs of `corner` and `landmark` (P,); inf where they disagree.

    Two pairs of one corner or of one landmark disagree. `faces`: normals (n,2) of corners, robot frame, and (m,2) of
    landmarks, map frame. `known` is as in `Headings`.
    """
    (seen, seen_direction, seen_var), (mapped, mapped_direction, mapped_var) = scan, of_map
    (normals, known_normals), (mean, heading_var, tolerance) = faces, known
    for p in range(corner.shape[0]):
        edges[p, p] = math.inf
        for q in range(p):
            edges[p, q] = edges[q, p] = math.inf
            i, j, k, m = corner[p], landmark[p], corner[q], landmark[q]
            off, variance = seen[i, k] - mapped[j, m], seen_var[i, k] + mapped_var[j, m]
            if i == k or j == m or not off * off <= gate * variance:
                continue
            heading, far = mapped_direction[j, m] - seen_direction[i, k], seen[i, k]
            turn = wrap_angle(heading - mean)
            if heading_var < math.inf and turn * turn * far * far > gate * (heading_var * far * far + variance):
                continue
            if tolerance < math.inf and not (
                0.0 <= face_turn(normals[i], heading, known_normals[j]) <= tolerance
                and 0.0 <= face_turn(normals[k], heading, known_normals[m]) <= tolerance
            ):
                continue
            edges[p, q] = edges[q, p] = off * off / variance if variance > 0.0 else 0.0


@compiled
def maximum_clique(edges: Array, group: Ints, cost: Array, least: int, budget: int) -> tuple[Ints, int]:
    """Nodes (k,) of the largest clique, of equally large ones the cheapest, and how many were tried; at most `budget`.

    A clique costs the `cost` (P,) of its nodes and the cost of its `edges` (P,P), symmetric, inf without an edge; none
    is negative. The nodes of one `group` (P,) follow each other and have no edge between them, so that the groups left
    limit what a clique can still gain. A clique of fewer than `least` nodes does not count: (0,).
    """
    P = group.shape[0]
    levels = 2
    for p in range(1, P):
        levels += group[p] != group[p - 1]
    nodes, size, at = np.empty((levels, P), np.int64), np.zeros(levels, np.int64), np.zeros(levels, np.int64)
    added = np.empty((levels, P))  # what a node costs that joins the clique of its level
    left, cheapest = np.zeros((levels, P + 1), np.int64), np.zeros((levels, P + 1))  # groups from here on, least costs
    clique, total = np.empty(levels, np.int64), np.zeros(levels)
    best, largest, best_total = np.empty(0, np.int64), max(least - 1, 0), 0.0
    for p in range(P):
        nodes[0, p], added[0, p] = p, cost[p]
    size[0] = P
    limit_gain(nodes[0], P, group, added[0], left[0], cheapest[0])
    level, tried = 0, 0
    while level >= 0 and tried < budget:
        k, most = at[level], level + left[level, at[level]]
        bound = total[level] + cheapest[level, k]
        if k == size[level] or most < largest or (most == largest and bound >= best_total):
            level -= 1
            continue
        node = nodes[level, k]
        at[level] += 1
        tried += 1
        clique[level], total[level + 1] = node, total[level] + added[level, k]
        if level + 1 > largest or (level + 1 == largest and total[level + 1] < best_total):
            best, largest, best_total = clique[: level + 1].copy(), level + 1, total[level + 1]
        count = 0
        for q in range(k + 1, size[level]):
            edge = edges[node, nodes[level, q]]
            if edge < math.inf:
                nodes[level + 1, count], added[level + 1, count] = nodes[level, q], added[level, q] + edge
                count += 1
        level += 1
        at[level], size[level] = 0, count
        limit_gain(nodes[level], count, group, added[level], left[level], cheapest[level])
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


@dataclass(slots=True)
class FirstPass:
    """Poses are proposed by sets of pairs; each is judged by all pairs that are found at it.

    The score of a pose is `rival_gap` per pair, less the joint NIS of the pairs at the prediction. A pose wins by
    `rival_gap`, or none does: of two equal rooms, nothing tells which it is.
    """

    config: AssociationConfig
    corners: Corners
    view: MapView
    belief: Filter
    pair: Callable[[Filter], MatchBuilder]  # all corners, at the pose of a filter
    tried: list[MatchBuilder] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)

    def propose(self, rows: Ints, ids: Ints) -> None:
        """Judge the pose of the pairs (k,), unless a pose that was judged has most of them."""
        if self._alike(rows, ids) is not None:
            return
        corrected = self.belief.copy()
        corrected.update(*self.corners.measurements(rows), ids, iterate=True)
        builder = self.pair(corrected)
        rows = np.flatnonzero(builder.rows["id"] != NO_ID)
        if not len(rows):
            return
        ids = builder.rows["id"][rows]
        nis = self.belief.joint_nis(*self.corners.measurements(rows), ids, iterate=True)
        self._enter(builder, self.config.rival_gap * len(rows) - nis, self._alike(rows, ids))

    def _alike(self, rows: Ints, ids: Ints) -> int | None:
        """The pose judged before that has most of the pairs (k,)."""
        shared = [np.count_nonzero(builder.rows["id"][rows] == ids) for builder in self.tried]
        return next((k for k, count in enumerate(shared) if 2 * count > len(rows)), None)

    def _enter(self, builder: MatchBuilder, score: float, alike: int | None) -> None:
        """A pose that was judged; of two that are alike, the better one."""
        if alike is None:
            self.tried.append(builder)
            self.scores.append(score)
        elif score > self.scores[alike]:
            self.tried[alike], self.scores[alike] = builder, score

    def propose_cliques(self, costs: Array) -> None:
        """Propose the largest sets of pairs that agree, each of pairs that no pose before has; costs (n,N)."""
        corners, belief, config = self.corners, self.belief, self.config
        pose, tolerance = self.view.belief, math.radians(config.descriptor_deg)
        heading = Headings(
            pose.T_map_robot.item(2), pose.pose_cov.item(8), tolerance if config.use_descriptor else math.inf
        )
        graph = PairGraph.of(corners, costs, self.view, belief, config, heading)
        while self.is_clear:
            for builder in self.tried:
                graph.leave_out(builder.rows["id"])
            clique = graph.largest(max(1, self.most_pairs - FEWER))
            rows, ids = graph.rows[clique], graph.ids[clique]
            fits = jointly_compatible(corners, rows, ids, belief, config, iterate=True)
            if not len(fits):
                return
            self.propose(rows[fits], ids[fits])
            graph.alive[clique] = False

    @property
    def most_pairs(self) -> int:
        """Of a pose that was judged."""
        return max((builder.paired for builder in self.tried), default=0)

    @property
    def is_clear(self) -> bool:
        """False as soon as two poses are about equally good."""
        *others, best = sorted([-math.inf, *self.scores])
        return not others or others[-1] <= best - self.config.rival_gap

    def best(self) -> MatchBuilder | None:
        """The decisions at the pose that wins."""
        return self.tried[int(np.argmax(self.scores))] if self.tried and self.is_clear else None
