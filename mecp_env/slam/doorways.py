"""Kernels for door jambs: two convex ends of collinear walls that face each other across a gap (III, doors)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.crossings import Found, Sight, Walls
from mecp_env.slam.data import CornerKind
from mecp_env.slam.geometry import wrap_angle

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
JAMB = int(CornerKind.JAMB)
PARALLEL_RAD, OFFSET_M = math.radians(15.0), 0.15  # how far the two wall faces beside a door may be from one line
BEYOND_M, BEYOND_SHARE = 0.25, 0.6  # of the beams between the jambs, this share passes this far beyond their line
BEHIND_M = 0.1  # a corner this far beyond the gap's line belongs to the next room


class DoorRules(NamedTuple):
    """Which gaps are doors, and which of them are seen well."""

    narrowest: float  # m
    widest: float  # m
    range: float  # m
    cosine: float  # of the largest incidence


@kernel
def find_doorways(found: Found, n: int, sight: Sight, walls: Walls, rules: DoorRules) -> tuple[Ints, Array, Bools]:
    """Jambs (g,2), right then left, widths (g,) and whether seen well (g,)."""
    jambs, width, good = np.empty((n, 2), np.int64), np.empty(n), np.empty(n, np.bool_)
    size = 0
    for right in range(n):
        if found.border[right, 0] < 0:
            continue
        left = facing_end(found, n, right, walls, rules)
        if left < 0 or not passes_through(found, sight, walls, (right, left)):
            continue
        jambs[size, 0], jambs[size, 1] = right, left
        (ax, ay), (bx, by) = point_of(found, right), point_of(found, left)
        width[size] = math.hypot(bx - ax, by - ay)
        mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
        distance = math.hypot(mx, my)
        across = abs(mx * (by - ay) - my * (bx - ax)) / width[size]
        good[size] = distance <= rules.range and across >= rules.cosine * distance
        size += 1
    return jambs[:size], width[:size], good[:size]


@kernel
def facing_end(found: Found, n: int, right: int, walls: Walls, rules: DoorRules) -> int:
    """The corner ccw of `right` that begins a wall collinear with the one ending there, in door width; or -1."""
    best, best_width = -1, rules.widest
    ending = found.border[right, 0]
    for left in range(n):
        beginning = found.border[left, 1]
        turn = wrap_angle(found.z[left, 1] - found.z[right, 1])
        if beginning < 0 or turn <= 0.0:
            continue
        if abs(wrap_angle(walls.line[ending, 0] - walls.line[beginning, 0])) > PARALLEL_RAD:
            continue
        a, b = point_of(found, right), point_of(found, left)
        if max(off_line(walls.line[ending], b), off_line(walls.line[beginning], a)) > OFFSET_M:
            continue
        width = math.hypot(b[0] - a[0], b[1] - a[1])
        if rules.narrowest <= width <= best_width:
            best, best_width = left, width
    return best


@kernel
def point_of(found: Found, n: int) -> tuple[float, float]:
    """x, y of corner n."""
    return found.z[n, 0] * math.cos(found.z[n, 1]), found.z[n, 0] * math.sin(found.z[n, 1])


@kernel
def off_line(line: Array, p: tuple[float, float]) -> float:
    """Distance of p from the line (alpha, rho)."""
    return float(abs(p[0] * math.cos(line[0]) + p[1] * math.sin(line[0]) - line[1]))


@kernel
def passes_through(found: Found, sight: Sight, walls: Walls, gap: tuple[int, int]) -> bool:
    """True when most beams between the two walls beside the gap pass well beyond the line through its jambs."""
    a, b = point_of(found, gap[0]), point_of(found, gap[1])
    size = sight.polar.shape[1]
    last, first = walls.last[found.border[gap[0], 0]], walls.first[found.border[gap[1], 1]]
    turn = wrap_angle(found.z[gap[1], 1] - found.z[gap[0], 1])
    between, beyond = 0, 0
    for k in range(1, (first - last) % size):
        q = (last + k) % size
        r, bearing = sight.polar[0, q], sight.polar[1, q]
        ahead = wrap_angle(bearing - found.z[gap[0], 1])
        if ahead <= 0.0 or ahead >= turn:
            continue
        between += 1
        beyond += (not sight.hit[q]) or depth_behind(a, b, (r * math.cos(bearing), r * math.sin(bearing))) > BEYOND_M
    return between > 0 and beyond >= BEYOND_SHARE * between


@kernel
def depth_behind(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> float:
    """How far (m) p lies beyond the line through a and b, as seen from the robot."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    return (dy * (p[0] - a[0]) - dx * (p[1] - a[1])) / math.hypot(dx, dy)


@kernel
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
