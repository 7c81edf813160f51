"""Point features of one scan (III-A.1): crossings, free ends and door jambs, with their joint covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import CornerConfig, SensorModel
from mecp_env.slam.frontend.door_gaps import JAMB, DoorRules, find_doorways, mark_beyond
from mecp_env.slam.frontend.line_ends import add_end
from mecp_env.slam.frontend.line_intersections import (
    MAX_REST,
    Found,
    Rules,
    Sight,
    Walls,
    add_crossing,
    empty_found,
    spread_of,
)
from mecp_env.slam.frontend.noise import Noise, noise_of, roll_beams, roll_hits
from mecp_env.slam.messages import Corners, Doorways, MergedScan, Segments

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
FACE_EVIDENCE = 12.0  # chi-square that a face too short for a segment must save, to be believed
TWIN_M, TWIN_RAD = 0.25, math.radians(45.0)  # how far apart two finds of one corner may lie and their faces may look


def extract_corners(beams: MergedScan, segments: Segments, config: CornerConfig, sensor: SensorModel) -> Corners:
    """The corners of a scan in order of bearing, with joint covariance, signature and the doorways among them.

    A corner is the crossing of two consecutive segments, or the end of one that is followed by something farther
    (III-A.1). Differs from the paper: its constant sigmas are replaced by the covariance of the lines, shared by the
    corners of one wall, and the two ends facing each other across a gap of door width are marked as jambs.
    """
    noise = noise_of(sensor)
    z, cov, kind, convex, normals, beyond, sites, jambs, width, good = find_corners(
        (beams.ranges, beams.bearings, beams.count, beams.hit, beams.raw_ranges, beams.raw_bearings),
        (segments.points, segments.line, segments.cov, segments.cluster, segments.first, segments.last),
        segments.roll,
        _rules(config, noise[0]),
        _doors(config),
        noise,
    )
    if config.covariance == "sensor":  # IV: sigma_r and sigma_theta of the laser, for every corner alike
        cov = np.diag(np.tile([noise[0] ** 2, noise[1] ** 2], len(z)))
    return Corners(z, cov, kind, convex, normals, beyond, sites, Doorways(jambs, width, good))


def _rules(config: CornerConfig, range_sigma_m: float) -> tuple[float, float, float, float, float]:
    """The fields of `Rules`."""
    return (
        math.radians(config.min_angle_deg),
        config.end_jump_m + config.end_jump_sigmas * range_sigma_m,
        config.max_sigma_m**2,
        config.floor_share * range_sigma_m,
        FACE_EVIDENCE if config.short_faces else math.inf,
    )


def _doors(config: CornerConfig) -> tuple[float, float, float, float]:
    """The fields of `DoorRules`."""
    return (*config.door_width_m, config.door_range_m, math.cos(math.radians(config.door_incidence_deg)))


@compiled
def find_corners(
    beams: tuple[Array, Array, Ints, Bools, Array, Array],
    segments: tuple[Array, Array, Array, Ints, Ints, Ints],
    roll: int,
    options: tuple[float, float, float, float, float],
    doors: tuple[float, float, float, float],
    sigmas: tuple[float, float],
) -> tuple[Array, Array, Ints, Bools, Array, Ints, Bools, Ints, Array, Bools]:
    """The fields of `Corners` and, in place of the doorways, those of `Doorways`.

    Given are range, bearing, count, hit, raw range and raw bearing of the beams, the fields of `Walls`, the beam at
    position 0, and the fields of `Rules`, `DoorRules` and `Noise`.
    """
    ranges, bearings, count, hit, raw_ranges, raw_bearings = beams
    polar, hits = roll_beams(ranges, bearings, count, roll), roll_hits(hit, roll)
    sight, walls = Sight(polar, hits, raw_ranges, raw_bearings, roll), Walls(*segments)
    raw = empty_found(2 * walls.line.shape[0] + 2)
    n = add_corners(raw, sight, walls, (Rules(*options), Noise(*sigmas)))
    found = in_order(raw, one_each(raw, n, walls))
    jambs, width, good = find_doorways(found, found.z.shape[0], sight, walls, DoorRules(*doors))
    beyond = mark_beyond(found, found.z.shape[0], jambs)
    for gap in range(jambs.shape[0]):
        for side in range(2):
            if found.convex[jambs[gap, side]]:  # a concave one is the corner of a room
                found.kind[jambs[gap, side]] = JAMB
    sites = np.empty(found.z.shape[0], np.bool_)
    for k in range(sites.shape[0]):
        sites[k] = found.kind[k] != JAMB and beyond[k] < 0
    cov = joint_covariance(found, walls.cov)
    return found.z, cov, found.kind, found.convex, found.normals, beyond, sites, jambs, width, good


@compiled
def add_corners(raw: Found, sight: Sight, walls: Walls, rules_and_noise: tuple[Rules, Noise]) -> int:
    """Fills `raw` with what stands at each end of each segment; returns how many corners that is."""
    n, size, beams = 0, walls.line.shape[0], sight.polar.shape[1]
    for segment in range(size):
        following = (segment + 1) % size
        rest = (walls.first[following] - walls.last[segment] - 1) % beams
        known = n
        if size > 1 and rest <= MAX_REST and walls.cluster[segment] == walls.cluster[following]:
            n = add_crossing(raw, n, sight, walls, (segment, following), rules_and_noise[0])
        if n == known:
            n = add_end(raw, n, sight, walls, (segment, 1), rules_and_noise)
            n = add_end(raw, n, sight, walls, (following, -1), rules_and_noise)
    return n


@compiled
def one_each(raw: Found, n: int, walls: Walls) -> Ints:
    """The rows of the first n that are left when a corner found from both its faces counts once."""
    chosen, kept = np.empty(n, np.int64), 0
    for i in range(n):
        twin = -1
        for j in range(kept):
            if is_twin(raw, i, chosen[j]):
                twin = j
        if twin < 0:
            chosen[kept] = i
            kept += 1
        elif spread_of(raw, i, walls) < spread_of(raw, chosen[twin], walls):
            chosen[twin] = i
    return chosen[:kept]


@compiled
def is_twin(found: Found, i: int, j: int) -> bool:
    """True when two corners are one: near each other, of one convexity, with no face that contradicts."""
    turn = wrap_angle(found.z[i, 1] - found.z[j, 1])
    distance = math.hypot(found.z[i, 0] - found.z[j, 0], found.z[j, 0] * turn)
    if found.convex[i] != found.convex[j] or distance > TWIN_M:
        return False
    before = abs(wrap_angle(found.normals[i, 0] - found.normals[j, 0]))
    after = abs(wrap_angle(found.normals[i, 1] - found.normals[j, 1]))
    return not (before > TWIN_RAD or after > TWIN_RAD)  # nan, a face unseen, contradicts nothing


@compiled
def in_order(raw: Found, chosen: Ints) -> Found:
    """The rows `chosen` of `raw`, by bearing."""
    for n in range(1, chosen.shape[0]):
        row, at = chosen[n], n
        while at > 0 and raw.z[chosen[at - 1], 1] > raw.z[row, 1]:
            chosen[at] = chosen[at - 1]
            at -= 1
        chosen[at] = row
    found = empty_found(chosen.shape[0])
    for k in range(chosen.shape[0]):
        copy_row(raw, chosen[k], found, k)
    return found


@compiled
def copy_row(source: Found, i: int, target: Found, k: int) -> None:
    """Row i of `source` becomes row k of `target`."""
    target.kind[k], target.convex[k] = source.kind[i], source.convex[i]
    for a in range(2):
        target.z[k, a], target.normals[k, a] = source.z[i, a], source.normals[i, a]
        target.lines[k, a], target.border[k, a] = source.lines[i, a], source.border[i, a]
        for b in range(2):
            target.own[k, a, b] = source.own[i, a, b]
            for c in range(2):
                target.jacobian[k, a, b, c] = source.jacobian[i, a, b, c]


@compiled
def joint_covariance(found: Found, line_cov: Array) -> Array:
    """(2n,2n) covariance of all z: each corner's own part, and J C J^T of the lines two corners share."""
    size = found.z.shape[0]
    cov = np.zeros((2 * size, 2 * size))
    for a in range(size):
        for b in range(a + 1):
            add_shared(cov, a, b, found, line_cov)
        for u in range(2):
            for v in range(u + 1):
                cov[2 * a + u, 2 * a + v] += found.own[a, u, v]
    for row in range(2 * size):
        for column in range(row):
            cov[column, row] = cov[row, column]
    return cov


@compiled
def add_shared(cov: Array, a: int, b: int, found: Found, line_cov: Array) -> None:
    """Adds J C J^T to the block of corners a and b for each line that both hang on."""
    for k in range(4):
        line = found.lines[a, k // 2]
        if line < 0 or line != found.lines[b, k % 2]:
            continue
        left, right, C = found.jacobian[a, k // 2], found.jacobian[b, k % 2], line_cov[line]
        for entry in range(4):
            u, v = entry // 2, entry % 2
            cov[2 * a + u, 2 * b + v] += left[u, 0] * (C[0, 0] * right[v, 0] + C[0, 1] * right[v, 1])
            cov[2 * a + u, 2 * b + v] += left[u, 1] * (C[1, 0] * right[v, 0] + C[1, 1] * right[v, 1])
