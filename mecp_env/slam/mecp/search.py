"""Exhaustive search for the largest empty convex polygons: all optima, with or without a robot (derivations 1)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mecp_env.core.array_types import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.slam.mecp.cycles import order_by_bearing, turns_left, visible_edges

Ranked = tuple[int, float, tuple[int, ...]]  # vertices, twice the area, ring


def around_robot(sites: Array, tolerance: float, weight: float) -> Iterator[Ranked]:
    """The largest polygons around the origin, by the edge that closes them across the ray of bearing pi."""
    if (sites == 0.0).all(axis=1).any():
        return  # a point at the robot blocks every polygon
    order = order_by_bearing(sites)
    sites = np.ascontiguousarray(sites[order])
    allowed = visible_edges(sites, tolerance)
    area = np.multiply.outer(sites[:, 0], sites[:, 1])
    area = weight * (area - area.T)
    for tail, head in np.argwhere(np.tril(allowed)):
        nodes = np.r_[tail, head : tail + 1]
        steps = np.triu(allowed[np.ix_(nodes, nodes)])
        steps[0] = False
        steps[0, 1] = True
        for size, twice, path in _longest(sites[nodes], steps, area[np.ix_(nodes, nodes)], tolerance, 1):
            yield size, twice, tuple(order[nodes[list(path[1:])]])


def around_leftmost(sites: Array, robot: Array | None, tolerance: float, weight: float) -> Iterator[Ranked]:
    """The largest polygons by their leftmost (then lowest) vertex, the robot on none of the edges' right sides."""
    for p in range(len(sites)):
        x, y = sites.T
        right = np.flatnonzero((x > x[p]) | ((x == x[p]) & (y > y[p])))
        right = right[order_by_bearing(sites[right] - sites[p])]
        fan = np.ascontiguousarray(sites[right] - sites[p])
        nodes = np.vstack([np.zeros((1, 2)), fan, fan, fan, np.zeros((1, 2))])
        steps = _fan_steps(fan, tolerance)
        if robot is not None:
            steps &= _left_of_edges(nodes, robot - sites[p])
        ids = np.r_[p, right, right, right, p]
        for size, twice, path in _around_first_node(nodes, steps, tolerance, weight):
            yield size, twice, tuple(ids[list(path[:-1])])


def _around_first_node(nodes: Array, steps: Bools, tolerance: float, weight: float) -> Iterator[Ranked]:
    """The best rings through the first node, which is the last one too."""
    area = np.multiply.outer(nodes[:, 0], nodes[:, 1])
    area = weight * (area - area.T)
    for chosen, first in _first_choices(steps, tolerance):
        yield from _longest(nodes, chosen, area, tolerance, first)


def _fan_steps(fan: Array, tolerance: float) -> Bools:
    """Steps (N,N) of chains from the leftmost vertex through `fan` (m,2) and back, N = 3m + 2.

    A point stands there three times: as first, inner and last one of a chain, because the edges at the leftmost vertex
    bound the first and the last triangle of the chain, and a point on them does not block.
    """
    m = len(fan)
    inner, first, last, only = fan_edges(fan, tolerance)
    steps = np.zeros((3 * m + 2, 3 * m + 2), np.bool_)
    a, b, c = slice(1, m + 1), slice(m + 1, 2 * m + 1), slice(2 * m + 1, 3 * m + 1)
    steps[0, a] = steps[c, -1] = True
    steps[a, b], steps[b, b], steps[b, c], steps[a, c] = first, inner, last, only
    return steps


def _left_of_edges(nodes: Array, robot: Array) -> Bools:
    """(N,N) whether the robot lies on or left of the edge between two nodes."""
    edge = nodes[None, :, :] - nodes[:, None, :]
    to_robot = robot - nodes[:, None, :]
    left: Bools = edge[..., 0] * to_robot[..., 1] - edge[..., 1] * to_robot[..., 0] >= 0.0
    return left


def _first_choices(steps: Bools, tolerance: float) -> Iterator[tuple[Bools, int]]:
    """The steps, once for each first vertex where the turn at the leftmost vertex, always left, needs the tolerance."""
    if tolerance == 0.0:
        yield steps, -1
        return
    for first in np.flatnonzero(steps[0]):
        chosen = steps.copy()
        chosen[0] = False
        chosen[0, first] = True
        yield chosen, int(first)


def _longest(nodes: Array, steps: Bools, area: Array, tolerance: float, first: int) -> Iterator[Ranked]:
    """All best left-turning chains from the first node to the last: edges, twice the area, nodes."""
    sizes, areas = chain_table(
        np.ascontiguousarray(nodes), np.ascontiguousarray(steps), np.ascontiguousarray(area), tolerance, first
    )
    size = int(sizes[0].max())
    if size < 3:
        return
    twice = float(areas[0][sizes[0] == size].max())
    for start in np.flatnonzero((sizes[0] == size) & (areas[0] == twice)):
        for path in _chains(nodes, (sizes, areas, area), tolerance, (0, int(start))):
            yield size, twice, path


def _chains(
    nodes: Array, table: tuple[Ints, Array, Array], tolerance: float, path: tuple[int, ...]
) -> Iterator[tuple[int, ...]]:
    """All ways to go on from `path` that reach what the table promises for its last edge."""
    i, j = path[-2:]
    if j == len(nodes) - 1:
        yield path
        return
    sizes, areas, area = table
    a, b = nodes[j] - nodes[i], nodes[j + 1 :] - nodes[j]
    turn, chord = a[0] * b[:, 1] - a[1] * b[:, 0], ((a + b) ** 2).sum(axis=1)
    good = (turn > 0.0) & (turn * turn > tolerance * tolerance * chord)
    good &= (sizes[j, j + 1 :] == sizes[i, j] - 1) & (areas[j, j + 1 :] + area[i, j] == areas[i, j])
    for k in np.flatnonzero(good):
        yield from _chains(nodes, table, tolerance, (*path, j + 1 + int(k)))


def best_rings(found: Iterable[Ranked], ids: Ints) -> list[tuple[int, ...]]:
    """The rings with most vertices, of those the ones with the largest area, named by `ids` and in their order."""
    ranked = list(found)
    best = max(((size, area) for size, area, _ in ranked), default=None)
    return sorted(
        _from_smallest(tuple(int(ids[i]) for i in ring)) for size, area, ring in ranked if (size, area) == best
    )


def _from_smallest(ring: tuple[int, ...]) -> tuple[int, ...]:
    """The same cycle, the smallest id first."""
    start = ring.index(min(ring))
    return ring[start:] + ring[:start]


def twice_area(ring: Array) -> float:
    """Twice the area of a ring (k,2), ccw positive."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def fan_edges(fan: Array, tolerance: float) -> tuple[Bools, Bools, Bools, Bools]:
    """Which edges i -> j (m,m) a chain around the origin, the leftmost vertex, has: as inner, first, last, only one.

    No point of the triangle (origin, i, j), its sides to the origin included, lies more than `tolerance` inside the
    edge; where i is first or j last the side to the origin is an edge too. Points are sorted by bearing.
    """
    x, y = fan.T
    cross_of = np.multiply.outer(x, y) - np.multiply.outer(y, x)
    dx, dy = x - x[:, None], y - y[:, None]  # of edge i -> j; below (m,m,m): i, j and a third point
    depth = dx[..., None] * dy[:, None, :] - dy[..., None] * dx[:, None, :]
    deep = (depth > 0.0) & (depth * depth > tolerance * tolerance * (dx * dx + dy * dy)[..., None])
    deep &= (cross_of[:, None, :] >= 0.0) & (cross_of.T[None] >= 0.0)
    far = tolerance * np.hypot(x, y)
    inside_first, inside_last = cross_of > far[:, None], far[:, None] < cross_of.T
    edges = np.triu(cross_of > 0.0, 1)
    inner = edges & ~deep.any(axis=2)
    first = edges & ~(deep & inside_first[:, None, :]).any(axis=2)
    last = edges & ~(deep & inside_last[None]).any(axis=2)
    only = edges & ~(deep & inside_first[:, None, :] & inside_last[None]).any(axis=2)
    return inner, first, last, only


@compiled
def chain_table(points: Array, steps: Bools, area: Array, tolerance: float, first: int) -> tuple[Ints, Array]:
    """Sizes and areas (N,N) of the best left-turning chain that starts with step i -> j and ends at the last node.

    Size counts edges, 0: no such chain; then area adds `area` (N,N) over them. Steps (N,N) lead to later nodes only.
    With `first` >= 0 the chain is a ring that starts with 0 -> first, and its turn at the last node (which is node 0
    again) is tested too.
    """
    n = points.shape[0]
    sizes, areas = np.zeros((n, n), np.int64), np.zeros((n, n))
    for i in range(n - 2, -1, -1):
        for j in range(i + 1, n - 1):
            if steps[i, j]:
                size, most = _best_step(points, sizes[j], areas[j], (i, j), tolerance * tolerance)
                sizes[i, j], areas[i, j] = size, area[i, j] + most
        ax, ay = points[n - 1, 0] - points[i, 0], points[n - 1, 1] - points[i, 1]
        bx, by = points[first, 0] - points[0, 0], points[first, 1] - points[0, 1]
        if steps[i, n - 1] and (first < 0 or turns_left(ax, ay, bx, by, tolerance * tolerance)):
            sizes[i, n - 1], areas[i, n - 1] = 1, area[i, n - 1]
    return sizes, areas


@compiled
def _best_step(points: Array, sizes: Ints, areas: Array, edge: tuple[int, int], tolerance2: float) -> tuple[int, float]:
    """Size of the best chain with edge i -> j in front, and area of the rest; sizes and areas (N,) are those from j."""
    i, j = edge
    ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    size, most = 0, 0.0
    for k in range(j + 1, points.shape[0]):
        if sizes[k] == 0 or sizes[k] < size or (sizes[k] == size and areas[k] <= most):
            continue
        if turns_left(ax, ay, points[k, 0] - points[j, 0], points[k, 1] - points[j, 1], tolerance2):
            size, most = sizes[k], areas[k]
    return (size + 1 if size > 0 else 0), most
