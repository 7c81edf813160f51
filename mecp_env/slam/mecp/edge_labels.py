"""What the beams of a scan show at an edge: crossed by a wall (derivations 1.5), wall, gap or open (III-A.2)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import EdgeLabel

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
