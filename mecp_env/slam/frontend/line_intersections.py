"""Kernels for a corner where two consecutive lines cross (III-A.1), and the rows all corner finders write to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.messages import CornerKind

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
CROSSING = int(CornerKind.CROSSING)
TURN_SIGMAS = 3.0
NEAR_M, NEAR_SIGMAS, NEAR_BEAMS = 0.08, 3.0, 2.0  # how far a crossing may lie from the break between its segments
MAX_REST = 4  # beams between two segments that still cross
POST_M = 0.4  # a face shorter than this may be the end of a wall


class Rules(NamedTuple):
    """What makes a crossing or a free end a corner."""

    min_angle: float  # rad, between two lines
    jump: float  # m, to what lies behind a free end
    max_variance: float  # m^2
    floor: float  # m, least sigma
    evidence: float  # chi-square that a face too short for a segment must save, to be believed


class Sight(NamedTuple):
    """The beams of a scan, rolled to a gap, and the raw beams behind them."""

    polar: Array  # (3,B) m, rad, number of raw beams
    hit: Bools  # (B,)
    raw_ranges: Array  # (K*B,) m
    raw_bearings: Array  # (K*B,) rad
    roll: int


class Walls(NamedTuple):
    """The segments, as in `Segments`."""

    points: Array
    line: Array
    cov: Array
    cluster: Ints
    first: Ints
    last: Ints


class Found(NamedTuple):
    """Rows of corners, filled up to a count that is passed along."""

    z: Array  # (n,2) m, rad
    own: Array  # (n,2,2) covariance of z that no other corner shares
    lines: Ints  # (n,2) the segments the corner hangs on, or -1
    jacobian: Array  # (n,2,2,2) derivative of z by alpha, rho of each of them: [corner, slot, row, parameter]
    kind: Ints  # (n,)
    convex: Bools  # (n,)
    normals: Array  # (n,2) rad
    border: Ints  # (n,2) the segment that may end at a gap here, the one that may begin after a gap here, or -1


@compiled
def empty_found(size: int) -> Found:
    """Room for `size` corners."""
    lines, border, normals = np.empty((size, 2), np.int64), np.empty((size, 2), np.int64), np.empty((size, 2))
    for k in range(size):
        for a in range(2):
            lines[k, a] = border[k, a] = -1
            normals[k, a] = np.nan
    own, jacobian = np.zeros((size, 2, 2)), np.zeros((size, 2, 2, 2))
    return Found(
        np.zeros((size, 2)), own, lines, jacobian, np.zeros(size, np.int64), np.zeros(size, np.bool_), normals, border
    )


@compiled
def add_crossing(found: Found, n: int, sight: Sight, walls: Walls, pair: tuple[int, int], rules: Rules) -> int:
    """n + 1 when the lines of the consecutive segments `pair` cross at a corner, written to row n; else n."""
    before, after = pair
    turn = wrap_angle(walls.line[after, 0] - walls.line[before, 0])
    doubt = TURN_SIGMAS * math.sqrt(walls.cov[before, 0, 0] + walls.cov[after, 0, 0])
    if not rules.min_angle + doubt < abs(turn) < math.pi - rules.min_angle - doubt:
        return n
    x, y = cross_lines(walls.line, before, after)
    if not write_crossing(found, n, walls, pair, (x, y)):
        return n
    variance = spread_of(found, n, walls) + rules.floor**2
    far = max(
        gap_to_break(sight, walls, before, walls.last[before], (x, y)),
        gap_to_break(sight, walls, after, walls.first[after], (x, y)),
    )
    if variance > rules.max_variance or far > NEAR_M + NEAR_SIGMAS * math.sqrt(variance):
        return n
    found.kind[n] = CROSSING
    found.convex[n] = math.sin(turn) < 0.0
    found.normals[n, 0] = wrap_angle(walls.line[before, 0] + math.pi)
    found.normals[n, 1] = wrap_angle(walls.line[after, 0] + math.pi)
    if found.convex[n] and length_of(walls.points, after) < POST_M:
        found.border[n, 0] = before
    if found.convex[n] and length_of(walls.points, before) < POST_M:
        found.border[n, 1] = after
    add_floor(found, n, rules.floor)
    return n + 1


@compiled
def cross_lines(line: Array, i: int, j: int) -> tuple[float, float]:
    """x, y where lines i and j cross."""
    ci, si, cj, sj = math.cos(line[i, 0]), math.sin(line[i, 0]), math.cos(line[j, 0]), math.sin(line[j, 0])
    determinant = ci * sj - si * cj
    return (line[i, 1] * sj - line[j, 1] * si) / determinant, (ci * line[j, 1] - cj * line[i, 1]) / determinant


@compiled
def write_crossing(found: Found, n: int, walls: Walls, pair: tuple[int, int], p: tuple[float, float]) -> bool:
    """Writes range, bearing and their derivatives by both lines; False when the crossing is at the robot."""
    x, y = p
    r = math.hypot(x, y)
    if r < 1e-3:
        return False
    found.z[n, 0], found.z[n, 1] = r, math.atan2(y, x)
    sine = math.sin(walls.line[pair[1], 0] - walls.line[pair[0], 0])
    for slot in range(2):
        own, other = walls.line[pair[slot], 0], walls.line[pair[1 - slot], 0]
        sign = 1.0 if slot == 0 else -1.0
        dx, dy = sign * math.sin(other) / sine, -sign * math.cos(other) / sine  # of the crossing by rho
        along = y * math.cos(own) - x * math.sin(own)  # n dp = drho - along dalpha
        by_rho_r, by_rho_b = (x * dx + y * dy) / r, (x * dy - y * dx) / (r * r)
        found.lines[n, slot] = pair[slot]
        found.jacobian[n, slot, 0, 0], found.jacobian[n, slot, 0, 1] = -along * by_rho_r, by_rho_r
        found.jacobian[n, slot, 1, 0], found.jacobian[n, slot, 1, 1] = -along * by_rho_b, by_rho_b
    return True


@compiled
def gap_to_break(sight: Sight, walls: Walls, segment: int, position: int, p: tuple[float, float]) -> float:
    """Metres along the wall from p to the segment's end at `position`, less what beam spacing explains."""
    alpha, rho = walls.line[segment]
    bearing = sight.polar[1, position] - alpha
    along = p[1] * math.cos(alpha) - p[0] * math.sin(alpha)
    step = 2.0 * math.pi / sight.polar.shape[1]
    spacing = rho * step / math.cos(bearing) ** 2
    return float(abs(along - rho * math.tan(bearing)) - NEAR_BEAMS * spacing)


@compiled
def spread_of(found: Found, n: int, walls: Walls) -> float:
    """Variance (m^2, sum over both directions) of corner n."""
    r = found.z[n, 0]
    total = found.own[n, 0, 0] + r * r * found.own[n, 1, 1]
    for slot in range(2):
        segment = found.lines[n, slot]
        if segment < 0:
            continue
        for row in range(2):
            a, b = found.jacobian[n, slot, row, 0], found.jacobian[n, slot, row, 1]
            scale = 1.0 if row == 0 else r * r
            cov = walls.cov[segment]
            total += scale * (a * a * cov[0, 0] + 2.0 * a * b * cov[0, 1] + b * b * cov[1, 1])
    return float(total)


@compiled
def add_floor(found: Found, n: int, floor: float) -> None:
    """Adds an independent error of `floor` metres in both directions to corner n."""
    found.own[n, 0, 0] += floor * floor
    found.own[n, 1, 1] += (floor / found.z[n, 0]) ** 2


@compiled
def length_of(points: Array, segment: int) -> float:
    """Length (m) of a segment."""
    return math.hypot(points[segment, 1, 0] - points[segment, 0, 0], points[segment, 1, 1] - points[segment, 0, 1])
