"""Maximum Empty Convex Polygons: the polygon division of III-A.2.

The polygons of a scan: search among its corners, without edges that a wall crosses. What the beams show at an edge:
crossed by a wall (derivations 1.5), wall, gap or open (III-A.2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.cycles import best_cycles, largest_cycle, visible_edges
from mecp_env.slam.messages import CornerKind, Corners, EdgeLabel, MergedScan, Polygon

PASSES, STOPS, SHORT = 1, 0, -1  # what a beam does at an edge


class EdgeBeams(NamedTuple):
    """The beams of a scan that edges are compared with."""

    ranges: Array  # (B,) m
    bearings: Array  # (B,) rad, ascending in (-pi, pi]
    wall: Bools  # (B,) the beam ends on a wall
    step: float  # rad, spacing of the bearings


class Edge(NamedTuple):
    """A ccw edge as the origin sees it: the points distance (1, tan(x)) for bearings normal + x; and its beams."""

    distance: float  # m, from the origin to the edge's line
    normal: float  # rad, bearing of the line's foot
    start: float  # m, along the line from the foot
    length: float  # m
    farthest: float  # m, from the origin to the farther corner
    tolerance: float  # m, how far off, across it, the edge may be
    first: int  # beam, counter-clockwise and around the end
    beams: int  # how many


@compiled
def edge_between(a: Array, b: Array, sigma: float, beams: EdgeBeams, limits: Record) -> Edge:
    """The edge from a to b, the origin on its left; `sigma` is that of its less certain corner (m)."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    first = int(np.searchsorted(beams.bearings, math.atan2(a[1], a[0])))
    count = int(np.searchsorted(beams.bearings, math.atan2(b[1], b[0]))) - first
    if count < 0 or (count == 0 and a[0] * b[1] - a[1] * b[0] <= 0.0):
        count += int(beams.bearings.shape[0])
    farthest = math.sqrt(max(a[0] * a[0] + a[1] * a[1], b[0] * b[0] + b[1] * b[1]))
    tolerance = min(limits.tolerance_sigmas * sigma, limits.depth_m)
    foot = (a[0] * dy - a[1] * dx, math.atan2(-dx, dy), a[0] * dx + a[1] * dy)
    return Edge(foot[0], foot[1], foot[2], length, farthest, tolerance, first, count)


@compiled
def from_normal(bearing: float, normal: float) -> tuple[float, float]:
    """Angle x in [-pi, pi] from the normal to a beam, and its cosine.

    For |x| <= pi/2 the error is below 1e-10: a few times faster than the library's, the same on every machine.
    """
    x = bearing - normal
    if x > math.pi:
        x = x - 2.0 * math.pi
    elif x < -math.pi:
        x = x + 2.0 * math.pi
    y = x * x
    tail = 1.0 / 479001600.0 - y / 87178291200.0
    tail = 1.0 / 40320.0 - y * (1.0 / 3628800.0 - y * tail)
    return x, 1.0 - y * (0.5 - y * (1.0 / 24.0 - y * (1.0 / 720.0 - y * tail)))


@compiled
def off_by(measured: float, c: float, distance: float, spacing: float) -> float:
    """How far across an edge a hit is beyond it, in m, less (towards 0) half a beam spacing of bearing error."""
    across = measured * c - distance
    slack = 0.5 * spacing * distance / max(c, spacing)
    return max(across - slack, 0.0) if across > 0.0 else min(across + slack, 0.0)


@compiled
def in_front(measured: float, bearing: float, edge: Edge, depth: float, spacing: float) -> bool:
    """True when a beam ends in front of the edge: by more than `depth` along it and the tolerance across the edge."""
    _, c = from_normal(bearing, edge.normal)
    return (measured + depth) * c < edge.distance and off_by(measured, c, edge.distance, spacing) < -edge.tolerance


@compiled
def edge_is_cut(edge: Edge, beams: EdgeBeams, limits: Record) -> bool:
    """True when `crossing_beams` consecutive beams end on a wall in front of an edge.

    In front: shorter than the edge by more than `depth_m` and, since small errors of corners and bearings are large
    along a beam that grazes the edge, more than its tolerance inside it beyond half a beam spacing. A run of so many
    beams holds one of every `crossing_beams`-th beam, so only those are looked at, and the others beside such a one.
    """
    ranges, bearings, size = beams.ranges, beams.bearings, beams.ranges.shape[0]
    needed, depth, spacing = limits.crossing_beams, limits.depth_m, beams.step
    behind = edge.farthest - depth  # the edge is nowhere farther
    for probe in range(needed - 1, edge.beams, needed):
        i = edge.first + probe if edge.first + probe < size else edge.first + probe - size
        if ranges[i] >= behind or not in_front(ranges[i], bearings[i], edge, depth, spacing):
            continue
        run = 0
        for step in range(probe - needed + 1, min(probe + needed, edge.beams)):
            i = (edge.first + step) % size
            run = run + 1 if beams.wall[i] and in_front(ranges[i], bearings[i], edge, depth, spacing) else 0
            if run == needed:
                return True
    return False


@compiled
def beam_effects(edge: Edge, beams: EdgeBeams, depth: float) -> tuple[Ints, Array]:
    """What each of its beams does at an edge (PASSES, STOPS or is SHORT of it), and its angle to the normal: (m,)."""
    size = beams.ranges.shape[0]
    effects, off, before_end = np.empty(edge.beams, np.int64), np.empty(edge.beams), min(edge.beams, size - edge.first)
    for part in range(2):  # up to the end of the scan, and on from its beginning
        start, stop = (0, before_end) if part == 0 else (before_end, edge.beams)
        beam = edge.first if part == 0 else 0
        ranges, bearings = beams.ranges[beam : beam + stop - start], beams.bearings[beam : beam + stop - start]
        part_effects, part_off = effects[start:stop], off[start:stop]
        for i in range(ranges.shape[0]):
            x, c = from_normal(bearings[i], edge.normal)
            far = (ranges[i] - depth) * c > edge.distance
            across = off_by(ranges[i], c, edge.distance, beams.step)
            beyond = PASSES if far and across > edge.tolerance else STOPS
            part_off[i] = x
            part_effects[i] = SHORT if (ranges[i] + depth) * c < edge.distance else beyond
    return effects, off


@compiled
def passing_intervals(edge: Edge, beams: EdgeBeams, limits: Record) -> Array:
    """Intervals (s,2) of an edge, in metres from its start, that beams pass by `depth_m`, as long or longer.

    An interval ends half way to the first beam that stops at the edge, or at the edge's end. A beam that stops well in
    front of the edge (at a pillar, at a person) is no evidence: it neither makes nor ends an interval.
    """
    effects, off = beam_effects(edge, beams, limits.depth_m)
    intervals = np.empty((effects.shape[0] // 2 + 1, 2))
    found, begin, before, last = 0, 0.0, SHORT, 0.0
    for step in range(effects.shape[0]):
        effect = effects[step]
        if effect == SHORT:
            continue
        if effect != before and before != SHORT:
            border = min(max(edge.distance * math.tan(0.5 * (off[step] + last)) - edge.start, 0.0), edge.length)
            if effect == STOPS and border - begin >= limits.depth_m:
                intervals[found, 0], intervals[found, 1] = begin, border
                found += 1
            begin = border
        before, last = effect, off[step]
    if before == PASSES and edge.length - begin >= limits.depth_m:
        intervals[found, 0], intervals[found, 1] = begin, edge.length
        found += 1
    return intervals[:found]


@compiled
def is_gap(a: Array, b: Array, interval: Array, doors: Array, limits: Record) -> bool:
    """True when an open interval (2,) of the edge from a to b is a gap of door width.

    That is: it coincides with a doorway of the scan (each covers at least half of the other), or it is between two
    intervals of wall and about as wide as a door or, as a door appears from the side, narrower.
    """
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    begin, end = interval[0], interval[1]
    if begin > 0.0 and end < length and end - begin <= limits.widest_gap_m:
        return True
    for door in range(doors.shape[0]):
        low, high, off = math.inf, -math.inf, 0.0
        for jamb in range(2):
            x, y = doors[door, jamb, 0] - a[0], doors[door, jamb, 1] - a[1]
            along = (x * dx + y * dy) / length
            low, high = min(low, along), max(high, along)
            off = max(off, abs(x * dy - y * dx) / length)
        common = min(high, end) - max(low, begin)
        if off < limits.depth_m and 2.0 * common >= max(end - begin, high - low):
            return True
    return False


@compiled
def write_intervals(
    rows: Array, at: int, ring: Array, sigmas: Array, doors: Array, beams: EdgeBeams, limits: Record
) -> int:
    """Writes the intervals of a ring (k,2) around the origin into the rows (m,4) from `at` on; returns the next row.

    A row: edge, start and end as share of its length, EdgeLabel. `sigmas` (k,) are those of the vertices, m; `doors`
    (g,2,2) the jambs of the scan's doorways. An edge is cut into the intervals that beams pass, GAP or OPEN, and what
    is left, WALL; where beams pass nowhere it is one WALL.
    """
    size = ring.shape[0]
    for e in range(size):
        a, b = ring[e], ring[(e + 1) % size]
        edge = edge_between(a, b, max(sigmas[e], sigmas[(e + 1) % size]), beams, limits)
        passing, done = passing_intervals(edge, beams, limits), 0.0
        for s in range(passing.shape[0] + 1):
            begin = passing[s, 0] / edge.length if s < passing.shape[0] else 1.0
            if begin > done:
                rows[at, 0], rows[at, 1], rows[at, 2], rows[at, 3] = e, done, begin, EdgeLabel.WALL.value
                at += 1
            if s < passing.shape[0] and passing[s, 1] > passing[s, 0]:
                label = EdgeLabel.GAP.value if is_gap(a, b, passing[s], doors, limits) else EdgeLabel.OPEN.value
                done = passing[s, 1] / edge.length
                rows[at, 0], rows[at, 1], rows[at, 2], rows[at, 3] = e, begin, done, label
                at += 1
    return at


LAZY_ATTEMPTS = 2
MATCHABLE = 4  # a triangle is no evidence of a place (derivations 1.4)


@compiled
def polygons_of_scan(
    corners: tuple[Array, Array, Bools, Ints, Ints, Ints],
    beams: tuple[Array, Array, Bools, float],
    config: Rows,
    by_area: bool,
) -> tuple[Ints, Array, Ints]:
    """Corners (s,) and intervals (t,4) of all polygons, one after the other, and where each one's end (p,2).

    `corners` are z, cov, sites, kind and beyond, and the jambs of the doorways; `beams` the fields of `EdgeBeams`. What
    is searched for, and where, is described in `find_polygons`, and in `find_largest` where it goes `by_area`.
    """
    (z, cov, sites, kind, beyond, jambs), limits = corners, config[0]
    scan, p_robot, variance = EdgeBeams(*beams), polar_to_points(z), np.diag(cov)
    sigmas = np.sqrt(0.5 * (variance[::2] + z[:, 0] * z[:, 0] * variance[1::2]))  # root mean square of the two axes
    sizes, rings = rings_among(p_robot, sigmas, sites, scan, limits, by_area)
    if sizes[0] < MATCHABLE:
        more = np.empty(sites.shape[0], np.bool_)
        for k in range(more.shape[0]):
            more[k] = sites[k] or (kind[k] == CornerKind.JAMB and beyond[k] < 0)
        more_sizes, more_rings = rings_among(p_robot, sigmas, more, scan, limits, by_area)
        if more_sizes[0] >= MATCHABLE or sizes[0] == 0:
            sizes, rings = more_sizes, more_rings
    doors = np.empty((jambs.shape[0], 2, 2))
    for gap in range(jambs.shape[0]):
        for side in range(2):
            doors[gap, side, 0], doors[gap, side, 1] = p_robot[jambs[gap, side], 0], p_robot[jambs[gap, side], 1]
    most = rings.shape[0] * rings.shape[1]
    found, rows = np.empty(most, np.int64), np.empty((rings.shape[0] * scan.ranges.shape[0] + 3 * most, 4))
    ends, polygons, corner, row = np.empty((rings.shape[0], 2), np.int64), 0, 0, 0
    for place in range(rings.shape[0]):
        size = sizes[place]
        if size == 0:
            continue
        ring, spread = np.empty((size, 2)), np.empty(size)
        for i in range(size):
            k = found[corner + i] = rings[place, i]
            ring[i, 0], ring[i, 1], spread[i] = p_robot[k, 0], p_robot[k, 1], sigmas[k]
        corner += size
        row = write_intervals(rows, row, ring, spread, doors, scan, limits)
        ends[polygons, 0], ends[polygons, 1] = corner, row
        polygons += 1
    return found[:corner], rows[:row].copy(), ends[:polygons]


@compiled
def rings_among(
    p_robot: Array, sigmas: Array, sites: Bools, beams: EdgeBeams, limits: Record, by_area: bool
) -> tuple[Ints, Ints]:
    """Sizes (keep,) and rings (keep,s) of the best polygons of the corners that are sites, each from the smallest."""
    ids, n = np.empty(sites.shape[0], np.int64), 0
    for k in range(sites.shape[0]):
        if sites[k]:
            ids[n] = k
            n += 1
    points, spread = np.empty((n, 2)), np.empty(n)
    for i in range(n):
        points[i, 0], points[i, 1], spread[i] = p_robot[ids[i], 0], p_robot[ids[i], 1], sigmas[ids[i]]
    sizes, rings = best_free_cycles(points, spread, beams, limits, by_area)
    for place in range(rings.shape[0]):
        for i in range(sizes[place]):
            rings[place, i] = ids[rings[place, i]]
    return sizes, rings


@compiled
def best_free_cycles(
    points: Array, sigmas: Array, beams: EdgeBeams, limits: Record, by_area: bool
) -> tuple[Ints, Ints]:
    """`best_cycles` or, `by_area`, `largest_cycle`, without edges that a wall crosses.

    The lazy check of derivations 1.5: solve, compare the edges of the result with the beams, forbid those that are cut,
    solve again. In a scan where that does not come to an end soon, all edges are tested. Points (n,2) are sorted as by
    `order_by_bearing`; the tolerance is `tolerance_sigmas` times the (upper) median of their sigmas (n,), m.
    """
    n, attempt, cut, median = points.shape[0], 0, True, 0.0
    for sigma in sigmas:  # `np.sort` would take a second to compile
        smaller, least = 0, 0
        for other in sigmas:
            smaller, least = smaller + (other < sigma), least + (other <= sigma)
        median = sigma if smaller <= n // 2 < least else median
    tolerance = limits.tolerance_sigmas * median
    allowed, tested, doubtful = visible_edges(points, tolerance), np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
    sizes, rings = np.empty(0, np.int64), np.empty((0, n), np.int64)
    while cut:
        if by_area:
            sizes, rings = largest_cycle(points, allowed, tolerance)
        else:
            sizes, rings = best_cycles(points, allowed, tolerance, limits.keep_ties)
        for place in range(sizes.shape[0]):
            for i in range(sizes[place]):
                doubtful[rings[place, i], rings[place, (i + 1) % sizes[place]]] = True
        cut = False
        for pair in range(n * n):
            a, b = pair // n, pair % n
            if not (allowed[a, b] and not tested[a, b] and (doubtful[a, b] or attempt == LAZY_ATTEMPTS)):
                continue
            edge = edge_between(points[a], points[b], max(sigmas[a], sigmas[b]), beams, limits)
            tested[a, b], allowed[a, b] = True, not edge_is_cut(edge, beams, limits)
            cut = cut or not allowed[a, b]
        attempt += 1
    return sizes, rings


def find_polygons(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The Maximum Empty Convex Polygons of a scan: the one with most vertices, of equals the largest (III-A.2).

    Sites are `corners.sites`. If they give no polygon of four, the jambs of this side of the doors count too (a
    corridor between doors has little else), unless `config.sites` is "corners"; if even that gives none of four, a
    triangle of the first attempt comes back, or else of the second: good for free space, not for matching. Polygons
    with equally many vertices are rare and both of use: the `keep_ties` largest come back, the larger area first.

    The tolerance is `tolerance_sigmas` times the median sigma of the sites; where beams are compared with an edge,
    times the larger sigma of its two corners. Polygons that walls cross are ruled out (`check_walls`) by the beams: all
    of them, or those that end on a wall according to `wall` (B,) (`beams_on_walls`). The beams also cut each edge into
    intervals WALL, GAP and OPEN.

    Differs from the paper: strict turns with tolerance, area decides between equals, jambs only where the other corners
    are too few, the wall-crossing check (derivations 1).
    """
    return _polygons(corners, beams, config, wall, by_area=False)


def find_largest(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The empty convex polygon around the robot that covers most floor, however many vertices it has; one, or none.

    All else is as in `find_polygons`: sites, tolerance, jambs, the wall-crossing check, intervals. No two polygons of a
    scan have equal areas, so `keep_ties` means nothing here. Not in the paper, which leaves other structures to future
    work (VI).
    """
    return _polygons(corners, beams, config, wall, by_area=True)


def _polygons(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None, by_area: bool
) -> tuple[Polygon, ...]:
    kind = corners.kind if config.sites == "posts_too" else np.full_like(corners.kind, CornerKind.CROSSING)
    if wall is None or not config.check_walls:
        wall = np.full(len(beams.ranges), config.check_walls)
    ids, intervals, ends = polygons_of_scan(
        (corners.z, corners.cov, corners.sites, kind, corners.beyond, corners.doorways.jambs),
        (beams.ranges, beams.bearings, wall, beams.step),
        config.record,
        by_area,
    )
    found, at, row = [], 0, 0
    for end, last_row in ends.tolist():
        found.append(Polygon(ids[at:end], intervals[row:last_row]))
        at, row = end, last_row
    return tuple(found)
