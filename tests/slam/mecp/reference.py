"""The largest empty convex polygons by exhaustive search: all optima, with or without a robot (derivations 1).

The reference for the compiled search of the package, which finds a few of the largest around the robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.jit import compiled
from mecp_env.slam.mecp.cycles import order_by_bearing, turns_left, visible_edges

Ranked = tuple[int, float, tuple[int, ...]]  # vertices, twice the area, ring


def largest_empty_convex_polygons(
    points: ArrayLike,
    robot: ArrayLike | None = None,
    *,
    robot_on_edge: bool = False,
    tolerance: float = 0.0,
    ties: Literal["area", "cardinality"] = "area",
) -> list[tuple[int, ...]]:
    """The largest empty convex polygons of `points`: index tuples, counter-clockwise from the smallest index.

    Largest is most vertices, then largest area: what is returned shares both, in order of ids. With
    `ties="cardinality"` all polygons with most vertices come back, the larger areas first; there can be very many.
    Without any polygon (fewer than three points, all on one line, robot outside) the list is empty.

    Args:
        points: (n,2) any unit of length. Of exact duplicates the first is used.
        robot: (2,) must lie strictly inside the polygon; None: no such condition.
        robot_on_edge: a robot on the boundary counts as inside.
        tolerance: same unit. A vertex lies farther than this from the chord of its neighbours, and a point blocks only
            if it lies farther than this inside the edge behind it, as seen from the robot (without a robot, or with
            `robot_on_edge`: from the leftmost vertex, and then inside the edges at that vertex too).
        ties: "area" or "cardinality".

    With tolerance 0 vertices are strict and a point on the boundary does not block (mode `open`). Exact as
    long as products of coordinate differences are exact in float64, as for integers below 2**25.

    Raises:
        MecpError: points or robot are not finite or not of that shape.
        ConfigError: tolerance is negative or not finite, or ties is unknown.

    Source: III-A.2; Dobkin, Edelsbrunner, Overmars, "Searching for empty convex polygons", Algorithmica 5, 1990, with
    the corrections of derivations 1.3: containment by edges, left turns instead of slopes.
    """
    given = _finite("points", points, 2)
    center = None if robot is None else _finite("robot", robot, 1)
    _check_options(tolerance, ties)
    given, center, tolerance = _to_unit_size(given, center, tolerance)
    sites, ids = _distinct(given)
    weight = 1.0 if ties == "area" else 0.0
    if center is None or robot_on_edge:
        found = around_leftmost(sites, center, float(tolerance), weight)
    else:
        found = around_robot(sites - center, float(tolerance), weight)
    rings = best_rings(found, ids)
    return rings if ties == "area" else sorted(rings, key=lambda ring: -twice_area(given[list(ring)]))


def _to_unit_size(points: Array, robot: Array | None, tolerance: float) -> tuple[Array, Array | None, float]:
    """All three divided by one power of two, which changes no digit: products can neither overflow nor vanish."""
    largest = max(np.abs(points).max(initial=0.0), 0.0 if robot is None else np.abs(robot).max())
    exponent = -math.frexp(largest)[1]
    scaled = None if robot is None else np.ldexp(robot, exponent)
    return np.ldexp(points, exponent), scaled, math.ldexp(float(tolerance), exponent)


def _check_options(tolerance: float, ties: str) -> None:
    number = isinstance(tolerance, int | float | np.number) and not isinstance(tolerance, bool)
    if not (number and 0.0 <= tolerance < math.inf):
        raise ConfigError(f"tolerance: {tolerance!r} is not a finite number >= 0")
    if ties not in ("area", "cardinality"):
        raise ConfigError(f"ties: {ties!r} is not 'area' or 'cardinality'")


def _finite(name: str, given: ArrayLike, dimensions: int) -> Array:
    """`given` as floats of shape (n,2) or (2,); an empty list stands for (0,2)."""
    array = _as_floats(name, given)
    if dimensions == 2 and array.size == 0:
        return np.empty((0, 2))
    if array.ndim != dimensions or array.shape[-1] != 2:
        raise MecpError(f"{name}: shape {array.shape} is not {'(n, 2)' if dimensions == 2 else '(2,)'}")
    if not np.isfinite(array).all():
        raise MecpError(f"{name}: every coordinate must be finite, given {given!r:.80}")
    return array


def _as_floats(name: str, given: ArrayLike) -> Array:
    if np.iscomplexobj(given):
        raise MecpError(f"{name}: complex coordinates, {given!r:.80}")
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise MecpError(f"{name}: {given!r:.80} are no numbers") from None


def _distinct(points: Array) -> tuple[Array, Ints]:
    """The points without exact duplicates, and which index each had first."""
    if len(points) == 0:
        return points, np.empty(0, np.int64)
    first = np.sort(np.unique(points, axis=0, return_index=True)[1]).astype(np.int64)
    return np.ascontiguousarray(points[first]), first


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
