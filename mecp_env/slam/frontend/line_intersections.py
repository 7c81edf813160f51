"""Compiled functions for a corner where two consecutive lines intersect (III-A.1); the rows of all corner finders."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, row_type
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.beams import Noise, Record, Records
from mecp_env.slam.messages import CornerKind

FOUND = row_type(
    [
        ("z", np.float64, 2),  # m, rad
        ("own", np.float64, (2, 2)),  # covariance of z that no other corner shares
        ("lines", np.int64, 2),  # the segments that determine the corner, or -1
        ("jacobian", np.float64, (2, 2, 2)),  # derivative of z by alpha, rho of each of them: [slot, row, parameter]
        ("kind", np.int64),
        ("normals", np.float64, 2),  # rad
        ("border", np.int64, 2),  # the segment that may end at a gap here, the one that may begin after it, or -1
        ("convex", np.bool_),
    ]
)  # one corner


class RolledScan(NamedTuple):
    """The beams of a scan from a gap on, and the raw beams behind them."""

    polar: Array  # (3,B) m, rad, number of raw beams
    hit: Bools  # (B,)
    raw_ranges: Array  # (K*B,) m
    raw_bearings: Array  # (K*B,) rad
    roll: int
    step: float  # rad, between two beams
    max_range: float  # m


class Lines(NamedTuple):
    """The segments, as in `Segments`, and how long they are."""

    line: Array  # (L,2)
    cov: Array  # (L,2,2)
    cluster: Ints  # (L,)
    first: Ints  # (L,)
    last: Ints  # (L,)
    length: Array  # (L,) m


@compiled
def empty_corners(size: int) -> Records:
    """Rows (size,) FOUND that nothing is known of."""
    rows = np.zeros(size, FOUND)
    for k in range(size):
        for slot in range(2):
            rows[k].lines[slot] = rows[k].border[slot] = -1
            rows[k].normals[slot] = np.nan
    return rows


@compiled
def add_intersection(
    found: Record, scan: RolledScan, lines: Lines, pair: tuple[int, int], limits: Record, noise: Noise
) -> bool:
    """True when the lines of the consecutive segments `pair` intersect at a corner; it is in row `found` then."""
    before, after = pair
    turn = wrap_angle(lines.line[after, 0] - lines.line[before, 0])
    doubt = noise.gate * math.sqrt(lines.cov[before, 0, 0] + lines.cov[after, 0, 0])
    if not limits.min_angle_rad + doubt < abs(turn) < math.pi - limits.min_angle_rad - doubt:
        return False
    x, y = write_intersection(found, lines.line, pair)
    if found.z[0] < 1e-3:  # at the robot
        return False
    floor, far = limits.floor_share * max(noise.range_m, noise.share * found.z[0]), 0.0
    variance = spread_of(found, lines.cov) + floor**2
    for slot in range(2):  # along each line, from the end of its segment, less what beam spacing explains
        alpha, rho = lines.line[pair[slot], 0], lines.line[pair[slot], 1]
        bearing = scan.polar[1, lines.last[before] if slot == 0 else lines.first[after]] - alpha
        along = y * math.cos(alpha) - x * math.sin(alpha)
        spacing = rho * scan.step / math.cos(bearing) ** 2
        gap = abs(along - rho * math.tan(bearing)) - noise.edge * spacing
        far = max(far, gap)
        found.normals[slot] = wrap_angle(alpha + math.pi)
    if variance > limits.max_sigma_m**2 or far > limits.line_m + noise.gate * math.sqrt(variance):
        return False
    found.kind, found.convex = CornerKind.CROSSING, math.sin(turn) < 0.0
    if found.convex and lines.length[after] < limits.wall_thickness_m:
        found.border[0] = before
    if found.convex and lines.length[before] < limits.wall_thickness_m:
        found.border[1] = after
    add_floor(found, floor)
    return True


@compiled
def write_intersection(found: Record, line: Array, pair: tuple[int, int]) -> tuple[float, float]:
    """x, y where the lines `pair` intersect; writes range, bearing and, off the origin, their derivatives."""
    (i, j), sine = pair, math.sin(line[pair[1], 0] - line[pair[0], 0])
    ci, si, cj, sj = math.cos(line[i, 0]), math.sin(line[i, 0]), math.cos(line[j, 0]), math.sin(line[j, 0])
    determinant = ci * sj - si * cj
    x, y = (line[i, 1] * sj - line[j, 1] * si) / determinant, (ci * line[j, 1] - cj * line[i, 1]) / determinant
    r = math.hypot(x, y)
    found.z[0], found.z[1] = r, math.atan2(y, x)
    for slot in range(2):
        own, other = line[pair[slot], 0], line[pair[1 - slot], 0]
        sign = 1.0 if slot == 0 else -1.0
        dx, dy = sign * math.sin(other) / sine, -sign * math.cos(other) / sine  # of the point by rho
        along = y * math.cos(own) - x * math.sin(own)  # n dp = drho - along dalpha
        by_rho_r, by_rho_b = (x * dx + y * dy) / r, (x * dy - y * dx) / (r * r)
        found.lines[slot] = pair[slot]
        found.own[slot, 0] = found.own[slot, 1] = 0.0  # a line end that was tried before has left its own
        found.jacobian[slot, 0, 0], found.jacobian[slot, 0, 1] = -along * by_rho_r, by_rho_r
        found.jacobian[slot, 1, 0], found.jacobian[slot, 1, 1] = -along * by_rho_b, by_rho_b
    return x, y


@compiled
def spread_of(found: Record, line_cov: Array) -> float:
    """Variance (m^2, sum over both directions) of a corner."""
    r = found.z[0]
    total = found.own[0, 0] + r * r * found.own[1, 1]
    for slot in range(2):
        segment = found.lines[slot]
        if segment < 0:
            continue
        for row in range(2):
            a, b = found.jacobian[slot, row, 0], found.jacobian[slot, row, 1]
            scale = 1.0 if row == 0 else r * r
            cov = line_cov[segment]
            total += scale * (a * a * cov[0, 0] + 2.0 * a * b * cov[0, 1] + b * b * cov[1, 1])
    return float(total)


@compiled
def add_floor(found: Record, floor: float) -> None:
    """Adds an independent error of `floor` metres in both directions to a corner."""
    found.own[0, 0] += floor * floor
    found.own[1, 1] += (floor / found.z[0]) ** 2
