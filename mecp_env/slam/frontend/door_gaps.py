"""Kernels for door jambs: two ends of walls that face each other across a gap (III, doors)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.line_intersections import Found, Sight, Walls, length_of
from mecp_env.slam.messages import CornerKind

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
JAMB = int(CornerKind.JAMB)
PARALLEL_RAD, OFFSET_M = math.radians(15.0), 0.15  # how far the two wall faces beside a door may be from one line
OBLIQUE_RAD = math.radians(60.0)  # and one of them, where the door is in line with the other
STUB_RAD = math.radians(20.0)  # how far the faces of a concave corner may be from the wall's and from square to it
STUB_M, STUB_SHARE = 0.3, 0.85  # how long a wall it may stand for, and how many of the other beams pass beyond
PLAIN_M = 1.05  # a gap between two walls in line is a door; a wider one only where the floor gets wider behind it,
ODD_M, WALL_M = 1.3, 0.5  # and from here on only between walls as long; one beside no two walls in line, up to here
DEPTH_M = (0.35, 0.7)  # behind the gap: deeper than a wall is thick
PASSED_M, STOPPED_M, WITNESSES = 0.12, 0.05, 2  # outside of the gap's width; beams on one side that tell
BEYOND_M, BEYOND_SHARE = 0.25, 0.6  # of the beams between the jambs, this share passes this far beyond their line
DEEP_M, DEEP_SHARE = 0.7, 0.25  # what is less deep is a niche
BEHIND_M = 0.1  # a corner this far beyond the gap's line belongs to the next room


class DoorRules(NamedTuple):
    """Which gaps are doors, and which of them are seen well."""

    narrowest: float  # m
    widest: float  # m
    range: float  # m
    cosine: float  # of the largest incidence


@compiled
def find_doorways(found: Found, n: int, sight: Sight, walls: Walls, rules: DoorRules) -> tuple[Ints, Array, Bools]:
    """Jambs (g,2), right then left, widths (g,) and whether seen well (g,)."""
    jambs, width, good = np.empty((n, 2), np.int64), np.empty(n), np.empty(n, np.bool_)
    rights, lefts = nearest_partners(found, n, walls, rules)
    size = 0
    for right in range(n):
        left = lefts[right]
        if left < 0 or rights[left] != right or not passes_through(found, sight, walls, (right, left)):
            continue
        jambs[size, 0], jambs[size, 1] = right, left
        (ax, ay), (bx, by) = point_of(found, right), point_of(found, left)
        width[size] = math.hypot(bx - ax, by - ay)
        mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
        distance = math.hypot(mx, my)
        across = abs(mx * (by - ay) - my * (bx - ax)) / width[size]
        good[size] = distance <= rules.range and across >= rules.cosine * distance
        wider = widening(sight, beside(found, right, left), beside(found, left, right))
        plain, _, sides = widths_and_sides(found, walls, right, left)
        size += wider >= sides or (wider == 0 and width[size] <= plain)
    return jambs[:size], width[:size], good[:size]


@compiled
def nearest_partners(found: Found, n: int, walls: Walls, rules: DoorRules) -> tuple[Ints, Ints]:
    """For each corner the nearest that may be the right, and the left jamb (n,) of a door with it; -1 without one."""
    rights, lefts = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    to_right, to_left = np.full(n, rules.widest), np.full(n, rules.widest)
    for right in range(n):
        for left in range(n):
            ended = found.border[right, 0] >= 0 or found.border[left, 1] >= 0
            if not ended or wrap_angle(found.z[left, 1] - found.z[right, 1]) <= 0.0:
                continue
            (ax, ay), (bx, by) = point_of(found, right), point_of(found, left)
            width = math.hypot(bx - ax, by - ay)
            if not rules.narrowest <= width <= max(to_left[right], to_right[left]):
                continue
            if not face_each_other(found, walls, right, left):
                continue
            if width > widths_and_sides(found, walls, right, left)[1]:
                continue
            if width <= to_left[right]:
                to_left[right], lefts[right] = width, left
            if width <= to_right[left]:
                to_right[left], rights[left] = width, right
    return rights, lefts


@compiled
def face_each_other(found: Found, walls: Walls, right: int, left: int) -> bool:
    """True when a wall ends at `right` or begins at `left`, and what is at the other is the end of a wall in its line.

    That wall may be at an angle to the first; and it may be too short to be one: then a concave corner is seen in its
    place, where it joins another wall.
    """
    ending, beginning = found.border[right, 0], found.border[left, 1]
    if beginning < 0:
        return stub_in_line(found, left, right, walls.line[ending])
    if ending < 0:
        return stub_in_line(found, right, left, walls.line[beginning])
    turn = abs(wrap_angle(walls.line[ending, 0] - walls.line[beginning, 0]))
    off_ending = off_line(walls.line[ending], point_of(found, left))
    off_beginning = off_line(walls.line[beginning], point_of(found, right))
    if turn <= PARALLEL_RAD:
        return max(off_ending, off_beginning) <= OFFSET_M
    return turn <= OBLIQUE_RAD and min(off_ending, off_beginning) <= OFFSET_M


@compiled
def stub_in_line(found: Found, corner: int, opposite: int, line: Array) -> bool:
    """True for a concave corner with one face on the line (alpha, rho), the other looking to the `opposite` corner."""
    if found.convex[corner] or off_line(line, point_of(found, corner)) > OFFSET_M:
        return False
    (ax, ay), (bx, by) = point_of(found, corner), point_of(found, opposite)
    across = math.atan2(by - ay, bx - ax)
    stub = False
    for face in range(2):
        along = abs(wrap_angle(found.normals[corner, face] - line[0] - math.pi))
        aside = abs(wrap_angle(found.normals[corner, 1 - face] - across))
        stub = stub or (along <= STUB_RAD and aside <= STUB_RAD)
    return stub


@compiled
def point_of(found: Found, n: int) -> tuple[float, float]:
    """x, y of corner n."""
    return found.z[n, 0] * math.cos(found.z[n, 1]), found.z[n, 0] * math.sin(found.z[n, 1])


@compiled
def off_line(line: Array, p: tuple[float, float]) -> float:
    """Distance of p from the line (alpha, rho)."""
    return float(abs(p[0] * math.cos(line[0]) + p[1] * math.sin(line[0]) - line[1]))


@compiled
def passes_through(found: Found, sight: Sight, walls: Walls, gap: tuple[int, int]) -> bool:
    """True when most beams between the two walls beside the gap pass well beyond the line through its jambs, some far.

    Where a concave corner stands for a jamb, almost all but those beside it: the wall there is short.
    """
    (right, left), size = gap, sight.polar.shape[1]
    ending, beginning = found.border[right, 0], found.border[left, 1]
    last = walls.last[ending] if ending >= 0 else walls.first[beginning] - size + 1
    first = walls.first[beginning] if beginning >= 0 else last - 1
    a, b = beside(found, right, left), beside(found, left, right)
    start = math.atan2(a[1], a[0])
    turn = wrap_angle(math.atan2(b[1], b[0]) - start)
    between, beyond, deep = 0, 0, 0
    for k in range(1, (first - last) % size):
        q = (last + k) % size
        r, bearing = sight.polar[0, q], sight.polar[1, q]
        ahead = wrap_angle(bearing - start)
        if ahead <= 0.0 or ahead >= turn:
            continue
        depth = depth_behind(a, b, (r * math.cos(bearing), r * math.sin(bearing))) if sight.hit[q] else math.inf
        between, beyond, deep = between + 1, beyond + (depth > BEYOND_M), deep + (depth > DEEP_M)
    share = BEYOND_SHARE if found.convex[right] and found.convex[left] else STUB_SHARE
    return between > 0 and beyond >= share * between and deep >= DEEP_SHARE * between


@compiled
def widening(sight: Sight, a: tuple[float, float], b: tuple[float, float]) -> int:
    """On how many sides the floor behind the gap from a to b gets wider than the gap; -1: on none, 0: not to be seen.

    Looked at are beams through the gap that cross the line square to it at a jamb, as deep as no wall is thick. Behind
    a door they go on, at least on one side; in the mouth of a corridor and in a niche they end there, on both sides.
    """
    width = math.hypot(b[0] - a[0], b[1] - a[1])
    ux, uy = (b[0] - a[0]) / width, (b[1] - a[1]) / width
    along, depth = -(a[0] * ux + a[1] * uy), a[1] * ux - a[0] * uy  # of the robot
    passed, stopped = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for q in range(sight.polar.shape[1]):
        r, bearing = sight.polar[0, q], sight.polar[1, q]
        x, y = math.cos(bearing), math.sin(bearing)
        sideways, onward = x * ux + y * uy, x * uy - y * ux
        if onward <= 1e-6 or abs(sideways) <= 1e-6 or not 0.0 < along - depth / onward * sideways < width:
            continue
        side = 1 if sideways > 0.0 else 0
        reach = ((width if side == 1 else 0.0) - along) / sideways
        if not DEPTH_M[0] <= depth + reach * onward <= DEPTH_M[1]:
            continue
        outside = (r - reach) * abs(sideways)
        passed[side] += (not sight.hit[q]) or outside > PASSED_M
        stopped[side] += sight.hit[q] and abs(outside) <= STOPPED_M
    wider = 0
    for side in range(2):
        wider += passed[side] >= WITNESSES and passed[side] > stopped[side]
    return -1 if wider == 0 and min(stopped[0], stopped[1]) >= WITNESSES else wider


@compiled
def widths_and_sides(found: Found, walls: Walls, right: int, left: int) -> tuple[float, float, int]:
    """How wide a gap is a door without, and with the floor seen to get wider behind it, m, and on how many sides."""
    ending, beginning = found.border[right, 0], found.border[left, 1]
    if ending < 0 or beginning < 0:
        return 0.0, ODD_M, 1
    if abs(wrap_angle(walls.line[ending, 0] - walls.line[beginning, 0])) > PARALLEL_RAD:
        return 0.0, ODD_M, 2
    shorter = min(length_of(walls.points, ending), length_of(walls.points, beginning))
    return PLAIN_M, math.inf if shorter >= WALL_M else ODD_M, 1


@compiled
def beside(found: Found, corner: int, opposite: int) -> tuple[float, float]:
    """x, y where a gap begins: at its corner, or `STUB_M` nearer to the `opposite` one where that is concave."""
    (ax, ay), (bx, by) = point_of(found, corner), point_of(found, opposite)
    share = 0.0 if found.convex[corner] else min(STUB_M / math.hypot(bx - ax, by - ay), 0.5)
    return ax + share * (bx - ax), ay + share * (by - ay)


@compiled
def depth_behind(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> float:
    """How far (m) p lies beyond the line through a and b, as seen from the robot."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    return (dy * (p[0] - a[0]) - dx * (p[1] - a[1])) / math.hypot(dx, dy)


@compiled
def mark_beyond(found: Found, n: int, jambs: Ints) -> Ints:
    """(n,) the farthest gap through which each corner is seen, as index into `jambs`, or -1."""
    beyond = np.empty(n, np.int64)
    for c in range(n):
        beyond[c], farthest = -1, 0.0
        for g in range(jambs.shape[0]):
            right, left = jambs[g, 0], jambs[g, 1]
            turn = wrap_angle(found.z[left, 1] - found.z[right, 1])
            ahead = wrap_angle(found.z[c, 1] - found.z[right, 1])
            distance = found.z[right, 0] + found.z[left, 0]
            if not 0.0 < ahead < turn or distance < farthest:
                continue
            if depth_behind(point_of(found, right), point_of(found, left), point_of(found, c)) > BEHIND_M:
                beyond[c], farthest = g, distance
    return beyond
