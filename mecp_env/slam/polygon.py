"""Maximum Empty Convex Polygons: the polygon division of III-A.2."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mecp_env.errors import ConfigError, MecpError
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.data import Beams, CornerKind, Corners, Polygon
from mecp_env.slam.geometry import polar_to_points
from mecp_env.slam.polygon_edges import Limits, View, edge_intervals
from mecp_env.slam.polygon_kernels import (
    best_free_cycles,
    chain_table,
    fan_edges,
    median_sigma,
    order_by_bearing,
    visible_edges,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

MATCHABLE = 4  # a triangle is no evidence of a place (maths 1.5)
Ranked = tuple[int, float, tuple[int, ...]]  # vertices, twice the area, ids


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

    With tolerance 0 vertices are strict and a point on the boundary does not block (mode `open` of maths 1.5). Exact as
    long as products of coordinate differences are exact in float64, as for integers below 2**25.

    Raises:
        MecpError: points or robot are not finite or not of that shape.
        ConfigError: tolerance is negative or not finite, or ties is unknown.

    Source: III-A.2; Dobkin, Edelsbrunner, Overmars, "Searching for empty convex polygons", Algorithmica 5, 1990, with
    the corrections of maths 1.3: containment by edges, left turns instead of slopes.
    """
    given = _finite("points", points, 2)
    sites, ids = _distinct(given)
    if not (isinstance(tolerance, (int, float, np.number)) and 0.0 <= float(tolerance) < math.inf):
        raise ConfigError(f"tolerance: {tolerance!r} is not a finite number >= 0")
    if ties not in ("area", "cardinality"):
        raise ConfigError(f"ties: {ties!r} is not 'area' or 'cardinality'")
    center = None if robot is None else _finite("robot", robot, 1)
    weight = 1.0 if ties == "area" else 0.0
    if center is None or robot_on_edge:
        found = _around_leftmost(sites, center, float(tolerance), weight)
    else:
        found = _around_robot(sites - center, float(tolerance), weight)
    rings = _best([(size, area, tuple(int(ids[i]) for i in ring)) for size, area, ring in found])
    return rings if ties == "area" else sorted(rings, key=lambda ring: -_twice_area(given[list(ring)]))


def _finite(name: str, given: ArrayLike, dimensions: int) -> Array:
    """`given` as floats of shape (n,2) or (2,); an empty list stands for (0,2)."""
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise MecpError(f"{name}: {given!r:.80} are no numbers") from None
    if dimensions == 2 and array.size == 0:
        return np.empty((0, 2))
    if array.ndim != dimensions or array.shape[-1] != 2:
        raise MecpError(f"{name}: shape {array.shape} is not {'(n, 2)' if dimensions == 2 else '(2,)'}")
    if not np.isfinite(array).all():
        raise MecpError(f"{name}: every coordinate must be finite, given {given!r:.80}")
    return array


def _distinct(points: Array) -> tuple[Array, Ints]:
    """The points without exact duplicates, and which index each had first."""
    if len(points) == 0:
        return points, np.empty(0, np.int64)
    first = np.sort(np.unique(points, axis=0, return_index=True)[1]).astype(np.int64)
    return np.ascontiguousarray(points[first]), first


def _around_robot(sites: Array, tolerance: float, weight: float) -> Iterator[Ranked]:
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


def _around_leftmost(sites: Array, robot: Array | None, tolerance: float, weight: float) -> Iterator[Ranked]:
    """The largest polygons by their leftmost (then lowest) vertex, the robot on none of the edges' right sides."""
    for p in range(len(sites)):
        right = np.flatnonzero(
            (sites[:, 0] > sites[p, 0]) | ((sites[:, 0] == sites[p, 0]) & (sites[:, 1] > sites[p, 1]))
        )
        if len(right) < 2:
            continue
        relative = sites[right] - sites[p]
        order = order_by_bearing(relative)
        fan = np.ascontiguousarray(relative[order])
        ids = np.r_[p, np.tile(right[order], 3), p]
        nodes = np.vstack([np.zeros((1, 2)), fan, fan, fan, np.zeros((1, 2))])
        steps = _fan_steps(fan, tolerance)
        if robot is not None:
            steps &= _left_of_edges(nodes, robot - sites[p])
        area = np.multiply.outer(nodes[:, 0], nodes[:, 1])
        for chosen, first in _first_choices(steps, tolerance):
            for size, twice, path in _longest(nodes, chosen, weight * (area - area.T), tolerance, first):
                yield size, twice, tuple(ids[list(path[:-1])])


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
    """The steps, once for each first vertex where the turn at the leftmost vertex is to be tested (it is always left)."""
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


def _best(found: list[Ranked]) -> list[tuple[int, ...]]:
    """The polygons with most vertices, of those the ones with the largest area, in order of ids."""
    best = max(((size, area) for size, area, _ in found), default=None)
    return sorted(_from_smallest(ring) for size, area, ring in found if (size, area) == best)


def _from_smallest(ring: tuple[int, ...]) -> tuple[int, ...]:
    """The same cycle, the smallest id first."""
    start = ring.index(min(ring))
    return ring[start:] + ring[:start]


def _twice_area(ring: Array) -> float:
    """Twice the area of a ring (k,2), ccw positive."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def find_polygons(
    corners: Corners, beams: Beams, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The Maximum Empty Convex Polygons of a scan: the one with most vertices, of equals the largest (III-A.2).

    Sites are `corners.sites`. If they give no polygon of four, the jambs of this side of the doors count too (a
    corridor between doors has little else); if even that gives none of four, a triangle of the first attempt comes
    back, or else of the second: good for free space, not for matching. Polygons with equally many vertices are rare
    and both of use: the `keep_ties` largest come back, the larger area first.

    The tolerance is `tolerance_sigmas` times the median sigma of the sites. Polygons that walls cross are ruled out by
    the beams (`guard`): all of them, or those that `wall` (B,) says end on a wall. Each edge is cut into intervals
    {WALL, GAP, OPEN} by the beams.

    Differs from the paper: strict turns with tolerance, area decides between equals, jambs only in need, the guard
    (maths 1.3, 1.5, 1.6).
    """
    return _Finder(corners, beams, config, wall).find()


class _Finder:
    """One scan's polygons: what both attempts and all their edges have in common."""

    def __init__(self, corners: Corners, beams: Beams, config: PolygonConfig, wall: Bools | None) -> None:
        self.corners, self.config = corners, config
        self.p_robot = polar_to_points(corners.z)
        walls = np.full(len(beams.ranges), config.guard) if wall is None else wall & config.guard
        self.view = View(beams.ranges, beams.bearings, walls)

    def find(self) -> tuple[Polygon, ...]:
        corners = self.corners
        limits, rings = self._solve(corners.sites)
        if not rings or len(rings[0]) < MATCHABLE:
            this_side = (corners.kind == CornerKind.JAMB) & (corners.beyond < 0)
            more_limits, more = self._solve(corners.sites | this_side)
            if more and (not rings or len(more[0]) >= MATCHABLE):
                limits, rings = more_limits, more
        doors = self.p_robot[corners.doorways.jambs]
        return tuple(Polygon(ring, edge_intervals(self.p_robot[ring], doors, self.view, limits)) for ring in rings)

    def _solve(self, sites: Bools) -> tuple[Limits, list[Ints]]:
        """Rings of corner indices, and the limits that went with these sites."""
        ids = np.flatnonzero(sites)
        limits = self._limits(ids)
        if len(ids) < 3:
            return limits, []
        ids = ids[order_by_bearing(self.p_robot[ids])]
        sizes, rings = best_free_cycles(self.p_robot[ids], self.config.keep_ties, self.view, limits)
        return limits, [_smallest_first(ids[ring[:size]]) for ring, size in zip(rings, sizes, strict=True) if size]

    def _limits(self, ids: Ints) -> Limits:
        config = self.config
        tolerance = config.tolerance_sigmas * median_sigma(self.corners.z, self.corners.cov, ids)
        return Limits(
            tolerance,
            config.guard_m,
            config.guard_beams,
            config.open_depth_m,
            config.open_width_m,
            *config.gap_width_m,
        )


def _smallest_first(ring: Ints) -> Ints:
    start = int(np.argmin(ring))
    return np.concatenate((ring[start:], ring[:start]))
