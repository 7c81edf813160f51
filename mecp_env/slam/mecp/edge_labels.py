"""What the beams of a scan say of an edge: cut by a wall (derivations 1.5), wall, gap or open (III-A.2)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.messages import ClusterKind

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WALL, GAP, OPEN = 0.0, 1.0, 2.0  # EdgeLabel as it stands in an array of floats
PASSES, STOPS, SHORT = 1, 0, -1
LINES = int(ClusterKind.LINES)
FARTHER = 1.001  # a beam this many times longer than an edge is far ends behind it, whatever the error of `cosine`
JAMB_DEPTH_M = 0.3  # how far off an edge the jambs of a gap in it may lie


class View(NamedTuple):
    """The beams of a scan that edges are held against."""

    ranges: Array  # (B,) m
    bearings: Array  # (B,) rad, ascending in (-pi, pi]
    wall: Bools  # (B,) the beam ends on a wall


class Limits(NamedTuple):
    """What counts as cut, as open and as a gap."""

    tolerance_sigmas: float  # of a corner: how far an edge may be off across its own direction
    guard_m: float
    guard_beams: int
    open_depth_m: float
    open_width_m: float
    gap_min_m: float
    gap_max_m: float


class Edge(NamedTuple):
    """A ccw edge as the origin sees it: the points distance (1, tan(x)) for bearings normal + x."""

    distance: float  # m, from the origin to the edge's line
    normal: float  # rad, bearing of the line's foot
    start: float  # m, along the line from the foot
    length: float  # m


@compiled
def edge_from(a: Array, b: Array) -> Edge:
    """The edge from a to b, the origin on its left."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    return Edge(a[0] * dy - a[1] * dx, math.atan2(-dx, dy), a[0] * dx + a[1] * dy, length)


@compiled
def edge_slack(sigma_a: float, sigma_b: float, limits: Limits) -> float:
    """How far off, across it, an edge between corners with these sigmas may be, m; no more than what counts as open."""
    return min(limits.tolerance_sigmas * max(sigma_a, sigma_b), limits.open_depth_m)


@compiled
def cosine(x: float) -> float:
    """cos(x) for |x| <= pi/2, error below 1e-10: a few times cheaper than the library's, the same on every machine."""
    y = x * x
    tail = 1.0 / 479001600.0 - y / 87178291200.0
    tail = 1.0 / 40320.0 - y * (1.0 / 3628800.0 - y * tail)
    return 1.0 - y * (0.5 - y * (1.0 / 24.0 - y * (1.0 / 720.0 - y * tail)))


@compiled
def beams_before(bearings: Array, bearing: float) -> int:
    """How many of the ascending bearings lie below `bearing`, by bisection."""
    low, high = 0, int(bearings.shape[0])
    while low < high:
        middle = (low + high) // 2
        if bearings[middle] < bearing:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def beams_between(a: Array, b: Array, bearings: Array) -> tuple[int, int]:
    """First beam and number of beams between the bearings of a and b, counter-clockwise and around the end."""
    first = beams_before(bearings, math.atan2(a[1], a[0]))
    count = beams_before(bearings, math.atan2(b[1], b[0])) - first
    if count < 0 or (count == 0 and a[0] * b[1] - a[1] * b[0] <= 0.0):
        count += int(bearings.shape[0])
    return first, count


@compiled
def off_normal(bearing: float, normal: float) -> float:
    """Angle in [-pi, pi] from the normal to a beam."""
    x = bearing - normal
    if x > math.pi:
        return x - 2.0 * math.pi
    return x + 2.0 * math.pi if x < -math.pi else x


@compiled
def _off_by(measured: float, c: float, edge: Edge, spacing: float) -> float:
    """How far across the edge a hit lies beyond it, in m, less (towards 0) half a beam spacing of bearing error."""
    across = measured * c - edge.distance
    slack = 0.5 * spacing * edge.distance / max(c, spacing)
    return max(across - slack, 0.0) if across > 0.0 else min(across + slack, 0.0)


@compiled
def _in_front(measured: float, bearing: float, edge: Edge, tolerance: float, beams: tuple[float, float]) -> bool:
    """True when a beam ends in front of the edge: by more than `guard_m` along it and `tolerance` across the edge."""
    guard_m, spacing = beams
    c = cosine(off_normal(bearing, edge.normal))
    return (measured + guard_m) * c < edge.distance and _off_by(measured, c, edge, spacing) < -tolerance


@compiled
def edge_is_cut(a: Array, b: Array, tolerance: float, view: View, limits: Limits) -> bool:
    """True when `guard_beams` consecutive beams end on a wall in front of the edge from a to b.

    In front: shorter than the edge by more than `guard_m` and, since small errors of corners and bearings are large
    along a beam that grazes the edge, more than `tolerance` (m) inside it beyond half a beam spacing. A run of so many
    beams holds one of every `guard_beams`-th beam, so only those are looked at, and the others beside such a one.
    """
    edge = edge_from(a, b)
    ranges, bearings, wall = view.ranges, view.bearings, view.wall
    size = ranges.shape[0]
    first, count = beams_between(a, b, bearings)
    needed, rules = limits.guard_beams, (limits.guard_m, 2.0 * math.pi / size)
    behind = FARTHER * math.sqrt(max(a[0] * a[0] + a[1] * a[1], b[0] * b[0] + b[1] * b[1])) - limits.guard_m
    for probe in range(needed - 1, count, needed):
        i = first + probe if first + probe < size else first + probe - size
        if ranges[i] >= behind or not _in_front(ranges[i], bearings[i], edge, tolerance, rules):
            continue
        run = 0
        for step in range(probe - needed + 1, min(probe + needed, count)):
            i = (first + step) % size
            run = run + 1 if wall[i] and _in_front(ranges[i], bearings[i], edge, tolerance, rules) else 0
            if run == needed:
                return True
    return False


@compiled
def _sight(measured: float, c: float, edge: Edge, rules: tuple[float, float], limits: Limits) -> int:
    """What a beam at an angle with cosine `c` to the normal does: PASSES, STOPS at the edge or is SHORT of it."""
    tolerance, spacing = rules
    far = (measured - limits.open_depth_m) * c > edge.distance
    beyond = PASSES if far and _off_by(measured, c, edge, spacing) > tolerance else STOPS
    return SHORT if (measured + limits.guard_m) * c < edge.distance else beyond


@compiled
def passing_stretches(a: Array, b: Array, tolerance: float, view: View, limits: Limits) -> Array:
    """Stretches (s,2) of an edge, in metres from a, that beams pass by `open_depth_m` and that are `open_width_m` long.

    A stretch ends half way to the first beam that stops at the edge, or at the edge's end. A beam that stops well in
    front of the edge (at a pillar, at a person) says nothing: it neither makes nor ends a stretch.
    """
    edge = edge_from(a, b)
    sights, off = sights_of(edge, beams_between(a, b, view.bearings), tolerance, view, limits)
    stretches = np.empty((sights.shape[0] // 2 + 1, 2))
    found, begin, before, last = 0, 0.0, SHORT, 0.0
    for step in range(sights.shape[0]):
        sight = sights[step]
        if sight == SHORT:
            continue
        if sight != before and before != SHORT:
            border = min(max(edge.distance * math.tan(0.5 * (off[step] + last)) - edge.start, 0.0), edge.length)
            if sight == STOPS and border - begin >= limits.open_width_m:
                stretches[found, 0], stretches[found, 1] = begin, border
                found += 1
            begin = border
        before, last = sight, off[step]
    if before == PASSES and edge.length - begin >= limits.open_width_m:
        stretches[found, 0], stretches[found, 1] = begin, edge.length
        found += 1
    return stretches[:found]


@compiled
def sights_of(edge: Edge, beams: tuple[int, int], tolerance: float, view: View, limits: Limits) -> tuple[Ints, Array]:
    """What each of the beams (first, number of them) does at the edge, and its angle to the normal: (m,) and (m,)."""
    first, count = beams
    sights, off = np.empty(count, np.int64), np.empty(count)
    rules, before_end = (tolerance, 2.0 * math.pi / view.ranges.shape[0]), min(count, view.ranges.shape[0] - first)
    for part in range(2):  # up to the end of the scan, and on from its beginning
        start, stop = (0, before_end) if part == 0 else (before_end, count)
        beam = first if part == 0 else 0
        ranges, bearings = view.ranges[beam : beam + stop - start], view.bearings[beam : beam + stop - start]
        part_sights, part_off = sights[start:stop], off[start:stop]
        for i in range(ranges.shape[0]):
            x = off_normal(bearings[i], edge.normal)
            part_off[i], part_sights[i] = x, _sight(ranges[i], cosine(x), edge, rules, limits)
    return sights, off


@compiled
def _is_gap(a: Array, b: Array, stretch: tuple[float, float], doors: Array, limits: Limits) -> bool:
    """True when an open stretch of the edge from a to b is a gap of door width.

    That is: it coincides with a doorway of the scan (each covers at least half of the other), or it lies between two
    stretches of wall and is about as wide as a door or, as a door looks from the side, narrower.
    """
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    begin, end = stretch
    if begin > 0.0 and end < length and limits.gap_min_m <= end - begin <= limits.gap_max_m:
        return True
    for door in range(doors.shape[0]):
        low, high, off = math.inf, -math.inf, 0.0
        for jamb in range(2):
            x, y = doors[door, jamb, 0] - a[0], doors[door, jamb, 1] - a[1]
            along = (x * dx + y * dy) / length
            low, high = min(low, along), max(high, along)
            off = max(off, abs(x * dy - y * dx) / length)
        common = min(high, end) - max(low, begin)
        if off < JAMB_DEPTH_M and 2.0 * common >= max(end - begin, high - low):
            return True
    return False


@compiled
def wall_beams(roll: int, first: Ints, last: Ints, kind: Ints, beams: int) -> Bools:
    """(B,) which beams belong to a run (first and last position from `roll`) of kind `wall`."""
    mask = np.zeros(beams, np.bool_)
    for run in range(first.shape[0]):
        if kind[run] != LINES:
            continue
        for position in range(first[run], last[run] + 1):
            beam = position + roll
            mask[beam if beam < beams else beam - beams] = True
    return mask


@compiled
def _write(rows: Array, at: int, edge: int, stretch: tuple[float, float], label: float) -> int:
    """Writes an interval into row `at` and returns the next row; an interval of no length is left out."""
    if stretch[1] <= stretch[0]:
        return at
    rows[at, 0], rows[at, 1], rows[at, 2], rows[at, 3] = edge, stretch[0], stretch[1], label
    return at + 1


@compiled
def write_intervals(
    rows: Array, at: int, ring: Array, sigmas: Array, doors: Array, view_and_limits: tuple[View, Limits]
) -> int:
    """Writes the intervals of a ring (k,2) around the origin into the rows (m,4) from `at` on; returns the next row.

    A row: edge, start and end as share of its length, EdgeLabel. `sigmas` (k,) are those of the vertices, m; `doors`
    (g,2,2) the jambs of the scan's doorways. An edge is cut into the stretches that beams pass, GAP or OPEN, and what
    is left, WALL; without a stretch it is one WALL.
    """
    size, (view, limits) = ring.shape[0], view_and_limits
    for e in range(size):
        a, b, slack = ring[e], ring[(e + 1) % size], edge_slack(sigmas[e], sigmas[(e + 1) % size], limits)
        length = edge_from(a, b).length
        stretches = passing_stretches(a, b, slack, view, limits)
        done = 0.0
        for s in range(stretches.shape[0]):
            begin, end = stretches[s, 0], stretches[s, 1]
            label = GAP if _is_gap(a, b, (begin, end), doors, limits) else OPEN
            at = _write(rows, at, e, (done, begin / length), WALL)
            at = _write(rows, at, e, (begin / length, end / length), label)
            done = end / length
        at = _write(rows, at, e, (done, 1.0), WALL)
    return at
