"""Compiled functions for door jambs: two ends of walls that face each other across a gap (III, doors)."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.beams import Lines, Noise, Records, RolledScan

Point = tuple[float, float]


@compiled
def find_doorways(
    found: Records, p_robot: Array, scan: RolledScan, lines: Lines, limits: Record, gaps: Record, noise: Noise
) -> tuple[Ints, Array, Bools]:
    """Jambs (g,2), right then left, widths (g,) and whether seen well (g,), of the corners `found` at p_robot (n,2)."""
    n, size = found.shape[0], 0
    jambs, width, good = np.empty((n, 2), np.int64), np.empty(n), np.empty(n, np.bool_)
    rights, lefts = nearest_partners(found, p_robot, lines, limits, gaps)
    for right in range(n):
        left = lefts[right]
        if left < 0 or rights[left] != right:
            continue
        a, b = gap_end(found, p_robot, right, left, limits), gap_end(found, p_robot, left, right, limits)
        if not passes_through(found, scan, lines, (right, left), (a, b), limits, gaps):
            continue
        jambs[size, 0], jambs[size, 1] = right, left
        (ax, ay), (bx, by) = (p_robot[right, 0], p_robot[right, 1]), (p_robot[left, 0], p_robot[left, 1])
        width[size] = math.hypot(bx - ax, by - ay)
        mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
        distance = math.hypot(mx, my)
        across = abs(mx * (by - ay) - my * (bx - ax)) / width[size]
        steep = across >= math.cos(limits.door_incidence_rad) * distance
        good[size] = distance <= limits.door_range_m and steep
        wider = widening(scan, a, b, limits, gaps, noise)
        plain, _, sides = width_limits(found, lines, right, left, limits, gaps)
        size += wider >= sides or (wider == 0 and width[size] <= plain)
    return jambs[:size], width[:size], good[:size]


@compiled
def nearest_partners(found: Records, p_robot: Array, lines: Lines, limits: Record, gaps: Record) -> tuple[Ints, Ints]:
    """For each corner the nearest that may be the right, and the left jamb (n,) of a door with it; -1 without one."""
    n, narrowest, widest = found.shape[0], limits.door_width_m[0], limits.door_width_m[1]
    rights, lefts = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    to_right, to_left = np.full(n, widest), np.full(n, widest)
    for right in range(n):
        for left in range(n):
            ended = found[right].border[0] >= 0 or found[left].border[1] >= 0
            if not ended or wrap_angle(found[left].z[1] - found[right].z[1]) <= 0.0:
                continue
            width = math.hypot(p_robot[left, 0] - p_robot[right, 0], p_robot[left, 1] - p_robot[right, 1])
            if not narrowest <= width <= max(to_left[right], to_right[left]):
                continue
            if not face_each_other(found, p_robot, lines, right, left, limits, gaps):
                continue
            if width > width_limits(found, lines, right, left, limits, gaps)[1]:
                continue
            if width <= to_left[right]:
                to_left[right], lefts[right] = width, left
            if width <= to_right[left]:
                to_right[left], rights[left] = width, right
    return rights, lefts


@compiled
def face_each_other(
    found: Records, p_robot: Array, lines: Lines, right: int, left: int, limits: Record, gaps: Record
) -> bool:
    """True when a wall ends at `right` or begins at `left`, and what is at the other is the end of a wall in its line.

    That wall may be at an angle to the first; and it may be too short to be one: then a concave corner is seen in its
    place, where it joins another wall, with one face on the line and the other turned to the gap.
    """
    ending, beginning = found[right].border[0], found[left].border[1]
    if ending >= 0 and beginning >= 0:
        turn = abs(wrap_angle(lines.line[ending, 0] - lines.line[beginning, 0]))
        off_ending, off_beginning = off_line(lines, ending, p_robot[left]), off_line(lines, beginning, p_robot[right])
        if turn <= limits.min_angle_rad:
            return bool(max(off_ending, off_beginning) <= limits.line_m)
        return bool(turn <= gaps.oblique_rad and min(off_ending, off_beginning) <= limits.line_m)
    segment, corner, opposite = (ending, left, right) if beginning < 0 else (beginning, right, left)
    if found[corner].convex or off_line(lines, segment, p_robot[corner]) > limits.line_m:
        return False
    dx, dy = p_robot[opposite, 0] - p_robot[corner, 0], p_robot[opposite, 1] - p_robot[corner, 1]
    across, stub, normals = math.atan2(dy, dx), False, found[corner].normals
    for face in range(2):
        along = abs(wrap_angle(normals[face] - lines.line[segment, 0] - math.pi))
        aside = abs(wrap_angle(normals[1 - face] - across))
        stub = stub or (along <= limits.min_angle_rad and aside <= limits.min_angle_rad)
    return stub


@compiled
def off_line(lines: Lines, segment: int, p: Array) -> float:
    """Distance of p from the line of a segment."""
    alpha, rho = lines.line[segment, 0], lines.line[segment, 1]
    return float(abs(p[0] * math.cos(alpha) + p[1] * math.sin(alpha) - rho))


@compiled
def width_limits(
    found: Records, lines: Lines, right: int, left: int, limits: Record, gaps: Record
) -> tuple[float, float, int]:
    """How wide a gap is a door without, and with the floor seen to get wider behind it, m, and on how many sides."""
    ending, beginning = found[right].border[0], found[left].border[1]
    if ending < 0 or beginning < 0:
        return 0.0, gaps.plain_width_m, 1
    if abs(wrap_angle(lines.line[ending, 0] - lines.line[beginning, 0])) > limits.min_angle_rad:
        return 0.0, gaps.plain_width_m, 2
    shorter = min(lines.length[ending], lines.length[beginning])
    return gaps.plain_width_m, math.inf if shorter >= 2.0 * limits.detail_m else gaps.plain_width_m, 1


@compiled
def gap_end(found: Records, p_robot: Array, corner: int, opposite: int, limits: Record) -> Point:
    """x, y where a gap begins: at its corner, or `detail_m` nearer to the `opposite` one where that is concave."""
    dx, dy = p_robot[opposite, 0] - p_robot[corner, 0], p_robot[opposite, 1] - p_robot[corner, 1]
    share = 0.0 if found[corner].convex else min(limits.detail_m / math.hypot(dx, dy), 0.5)
    return p_robot[corner, 0] + share * dx, p_robot[corner, 1] + share * dy


@compiled
def passes_through(
    found: Records,
    scan: RolledScan,
    lines: Lines,
    jambs: tuple[int, int],
    ends: tuple[Point, Point],
    limits: Record,
    gaps: Record,
) -> bool:
    """True when enough of the beams between the two walls beside the gap go on behind it, deeper than any wall."""
    (right, left), (a, b), size = jambs, ends, scan.polar.shape[1]
    ending, beginning = found[right].border[0], found[left].border[1]
    last = lines.last[ending] if ending >= 0 else lines.first[beginning] - size + 1
    first = lines.first[beginning] if beginning >= 0 else last - 1
    start = math.atan2(a[1], a[0])
    turn = wrap_angle(math.atan2(b[1], b[0]) - start)
    between, deep = 0, 0
    for k in range(1, (first - last) % size):
        q = (last + k) % size
        ahead = wrap_angle(scan.polar[1, q] - start)
        if ahead <= 0.0 or ahead >= turn:
            continue
        p = (scan.polar[0, q] * math.cos(scan.polar[1, q]), scan.polar[0, q] * math.sin(scan.polar[1, q]))
        depth = depth_behind(a, b, p) if scan.hit[q] else math.inf
        between, deep = between + 1, deep + (depth > limits.wall_thickness_m)
    return between > 0 and deep >= gaps.deep_share * between


@compiled
def widening(scan: RolledScan, a: Point, b: Point, limits: Record, gaps: Record, noise: Noise) -> int:
    """On how many sides the floor behind the gap from a to b gets wider than the gap; -1: on none, 0: not to be seen.

    Looked at are beams through the gap that cross the line square to it at a jamb, just deeper than any wall. Behind
    a door they go on, at least on one side; in the mouth of a corridor and in a niche they end there, on both sides.
    """
    width = math.hypot(b[0] - a[0], b[1] - a[1])
    ux, uy = (b[0] - a[0]) / width, (b[1] - a[1]) / width
    along, depth = -(a[0] * ux + a[1] * uy), a[1] * ux - a[0] * uy  # of the robot
    passed, stopped = np.zeros(2, np.int64), np.zeros(2, np.int64)
    start = math.atan2(a[1], a[0])
    turn = wrap_angle(math.atan2(b[1], b[0]) - start)
    for q in range(scan.polar.shape[1]):
        if not 0.0 < wrap_angle(scan.polar[1, q] - start) < turn:
            continue  # its direction is not needed
        x, y = math.cos(scan.polar[1, q]), math.sin(scan.polar[1, q])
        sideways, onward = x * ux + y * uy, x * uy - y * ux
        if onward <= 1e-6 or abs(sideways) <= 1e-6 or not 0.0 < along - depth / onward * sideways < width:
            continue
        side = 1 if sideways > 0.0 else 0
        reach = ((width if side == 1 else 0.0) - along) / sideways
        if not 0.0 <= depth + reach * onward - limits.wall_thickness_m <= limits.detail_m:
            continue
        outside = (scan.polar[0, q] - reach) * abs(sideways)
        passed[side] += (not scan.hit[q]) or outside > limits.line_m
        stopped[side] += scan.hit[q] and abs(outside) <= limits.line_m
    wider = 0
    for side in range(2):
        wider += passed[side] >= noise.edge and passed[side] > stopped[side]
    return -1 if wider == 0 and min(stopped[0], stopped[1]) >= noise.edge else wider


@compiled
def depth_behind(a: Point, b: Point, p: Point) -> float:
    """How far (m) p is beyond the line through a and b, as seen from the robot."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    return (dy * (p[0] - a[0]) - dx * (p[1] - a[1])) / math.hypot(dx, dy)


@compiled
def mark_beyond(found: Records, p_robot: Array, jambs: Ints, least: float) -> Ints:
    """(n,) the farthest gap behind which each corner is, by `least` metres or more, as index into `jambs`, or -1."""
    n = found.shape[0]
    beyond = np.empty(n, np.int64)
    for c in range(n):
        beyond[c], farthest = -1, 0.0
        for g in range(jambs.shape[0]):
            right, left = jambs[g, 0], jambs[g, 1]
            turn = wrap_angle(found[left].z[1] - found[right].z[1])
            ahead = wrap_angle(found[c].z[1] - found[right].z[1])
            distance = found[right].z[0] + found[left].z[0]
            if not 0.0 < ahead < turn or distance < farthest:
                continue
            a, b = (p_robot[right, 0], p_robot[right, 1]), (p_robot[left, 0], p_robot[left, 1])
            if depth_behind(a, b, (p_robot[c, 0], p_robot[c, 1])) > least:
                beyond[c], farthest = g, distance
    return beyond
