"""The polygon search as the paper writes it down (III-A.2, after Dobkin, Edelsbrunner, Overmars 1990), in plain Python.

Kept beside ours to measure its rule: only sites p whose star polygon P_p has the robot in its kernel are leftmost
vertices. The robot then sees every site to the right of p in order, which is more than an empty convex polygon needs.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.polygons import find_polygons
from mecp_env.slam.messages import Corners, MergedScan, Polygon

Point = tuple[float, float]


class Ring(NamedTuple):
    """A polygon around the robot."""

    size: int  # number of vertices
    area: float  # twice the area
    vertices: tuple[int, ...]  # sites, counter-clockwise from the leftmost


class Chain(NamedTuple):
    """The largest convex chain that starts with an edge i -> j of a star polygon and closes at its first point."""

    edges: int
    area: float  # twice that of the triangles with the first point
    following: int  # the vertex after j, or -1


def find_dobkin(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The empty convex polygons of a scan with most vertices among those that the paper's kernel rule leaves.

    Sites are `corners.sites`; turns are exact, without tolerance. Of equally many vertices, the `keep_ties` largest
    come back. With `check_walls`, a polygon that a wall crosses is replaced by what is left of its vertices.
    """
    sites = np.flatnonzero(corners.sites)
    rings = rings_around(polar_to_points(corners.z)[sites])
    best = [ring for ring in rings if ring.size == rings[0].size][: config.keep_ties]
    alone = config.model_copy(update={"sites": "corners", "keep_ties": 1, "tolerance_sigmas": 0.0})
    found: list[Polygon] = []
    for ring in best:
        marks = np.zeros(len(corners), np.bool_)
        marks[sites[list(ring.vertices)]] = True
        found += find_polygons(corners.with_sites(marks), beams, alone, wall)
    return tuple(found)


def rings_around(points: Array, by_kernel: bool = True) -> list[Ring]:
    """For each of `points` (n,2) the largest empty convex polygon around the origin that has it as leftmost vertex.

    Most vertices first, then the largest area. `by_kernel`: only for points p with the origin in the kernel of P_p,
    the paper's rule; without it the first one is the MECP. Points are in general position.
    """
    sites: list[Point] = [(x, y) for x, y in points.tolist()]
    found = (_from_leftmost(sites, p, by_kernel) for p in range(len(sites)))
    return sorted((ring for ring in found if ring is not None), key=lambda ring: (-ring.size, -ring.area))


def _from_leftmost(sites: list[Point], p: int, by_kernel: bool) -> Ring | None:
    order = star(sites, p)
    fan, first = [sites[i] for i in order], sites[p]
    if len(fan) < 2 or (by_kernel and not in_kernel((0.0, 0.0), [first, *fan])):
        return None
    chains = longest_chains(fan, visible_from(first, fan), first)
    starts = [edge for edge in chains if keeps_left(first, fan[edge[0]])]
    if not starts:
        return None
    i, j = max(starts, key=lambda edge: chains[edge][:2])
    size, area, path = chains[i, j].edges + 2, chains[i, j].area, [p, order[i]]
    while j >= 0:
        path.append(order[j])
        i, j = j, chains[i, j].following
    return Ring(size, area, tuple(path))


def turn(a: Point, b: Point, c: Point) -> float:
    """Positive where a, b, c turn left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def keeps_left(a: Point, b: Point) -> bool:
    """True when the edge a -> b has the robot, the origin, on its left."""
    return a[0] * b[1] - a[1] * b[0] > 0.0


def star(sites: list[Point], p: int) -> list[int]:
    """The sites right of p, counter-clockwise about it: with p, the star polygon P_p (step 1)."""
    right = np.array([i for i, site in enumerate(sites) if site > sites[p]], np.int64)
    x, y = (np.array([sites[i] for i in right]).reshape(-1, 2) - sites[p]).T
    return [int(i) for i in right[np.lexsort((np.hypot(x, y), np.arctan2(y, x)))]]


def in_kernel(point: Point, ring: list[Point]) -> bool:
    """True when every edge of the polygon is visible from the point (step 2)."""
    return all(turn(a, b, point) >= 0.0 for a, b in zip(ring, ring[1:] + ring[:1], strict=True))


def visible_from(first: Point, fan: list[Point]) -> list[list[int]]:
    """For each point of the fan around `first` the earlier ones that it sees inside the star polygon (step 2).

    An edge i -> j is visible when the triangle of it and `first` is empty. Queues as in the paper: Q_l holds the points
    that l sees and that nothing after l has seen.
    """
    queues: list[deque[int]] = [deque() for _ in fan]
    incoming: list[list[int]] = [[] for _ in fan]

    def proceed(i: int, j: int) -> None:
        while queues[i] and turn(fan[queues[i][0]], fan[i], fan[j]) > 0.0:
            proceed(queues[i].popleft(), j)
        incoming[j].append(i)
        queues[j].append(i)

    for i in range(len(fan) - 1):
        proceed(i, i + 1)
    return incoming


def longest_chains(fan: list[Point], incoming: list[list[int]], first: Point) -> dict[tuple[int, int], Chain]:
    """The longest convex chain that starts with each edge i -> j, from the last vertex back to the first (step 3).

    Chains have the robot on their left, and so has the edge back to `first`: the polygon is around it.
    """
    chains: dict[tuple[int, int], Chain] = {}
    outgoing: list[list[int]] = [[] for _ in fan]
    for j in range(len(fan) - 1, -1, -1):
        for i in incoming[j]:
            convex = [k for k in outgoing[j] if turn(fan[i], fan[j], fan[k]) > 0.0]
            longest = _longest((fan[i], fan[j], first), [(chains[j, k], k) for k in convex])
            if longest is not None:
                chains[i, j] = longest
                outgoing[i].append(j)
    return chains


def _longest(corners: tuple[Point, Point, Point], longer: list[tuple[Chain, int]]) -> Chain | None:
    """The longest chain from the first of the `corners` i, j, `first`: one of those `longer` ones, or to close at j."""
    i, j, first = corners
    area = turn(first, i, j)
    if area <= 0.0 or not keeps_left(i, j):
        return None
    ends = [Chain(1, area, -1)] if keeps_left(j, first) else []
    return max(ends + [Chain(1 + chain.edges, area + chain.area, k) for chain, k in longer], default=None)
