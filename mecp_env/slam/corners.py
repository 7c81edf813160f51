"""Point features of one scan (III-A.1): crossings, free ends and door jambs, with their joint covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.config import CornerConfig, SensorModel
from mecp_env.slam.crossings import MAX_REST, Found, Rules, Sight, Walls, add_crossing, empty_found, spread_of
from mecp_env.slam.data import Beams, Corners, Doorways, Segments
from mecp_env.slam.doorways import JAMB, DoorRules, find_doorways, mark_beyond
from mecp_env.slam.free_ends import add_end
from mecp_env.slam.geometry import wrap_angle
from mecp_env.slam.noise import Noise, noise_of, roll_beams, roll_hits

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
FACE_EVIDENCE = 12.0  # chi-square that a face too short for a segment must save, to be believed
TWIN_M, TWIN_RAD = 0.25, math.radians(45.0)  # how far apart two finds of one corner may lie and their faces may look


def extract_corners(beams: Beams, segments: Segments, config: CornerConfig, sensor: SensorModel) -> Corners:
    """The corners of a scan in order of bearing, with joint covariance, signature and the doorways among them.

    A corner is the crossing of two consecutive segments, or the end of one that is followed by something farther
    (III-A.1). Differs from the paper: its constant sigmas are replaced by the covariance of the lines, shared by the
    corners of one wall, and the two ends facing each other across a gap of door width are marked as jambs.
    """
    noise = Noise(*noise_of(sensor))
    sight = Sight(
        roll_beams(beams.ranges, beams.bearings, beams.count, segments.roll),
        roll_hits(beams.hit, segments.roll),
        beams.raw_ranges,
        beams.raw_bearings,
        segments.roll,
    )
    walls = Walls(segments.points, segments.line, segments.cov, segments.cluster, segments.first, segments.last)
    (z, cov, kind, convex, normals, beyond, sites), (jambs, width, good) = find_corners(
        sight, walls, _rules(config, noise), _doors(config), noise
    )
    if config.covariance == "sensor":  # IV: sigma_r and sigma_theta of the laser, for every corner alike
        cov = np.diag(np.tile([noise.range_m**2, noise.bearing**2], len(z)))
    return Corners(z, cov, kind, convex, normals, beyond, sites, Doorways(jambs, width, good))


def _rules(config: CornerConfig, noise: Noise) -> Rules:
    return Rules(
        math.radians(config.min_angle_deg),
        config.end_jump_m + config.end_jump_sigmas * noise.range_m,
        config.max_sigma_m**2,
        config.floor_share * noise.range_m,
        FACE_EVIDENCE if config.short_faces else math.inf,
    )


def _doors(config: CornerConfig) -> DoorRules:
    return DoorRules(*config.door_width_m, config.door_range_m, math.cos(math.radians(config.door_incidence_deg)))


@kernel
def find_corners(
    sight: Sight, walls: Walls, rules: Rules, doors: DoorRules, noise: Noise
) -> tuple[tuple[Array, Array, Ints, Bools, Array, Ints, Bools], tuple[Ints, Array, Bools]]:
    """The fields of `Corners`, doorways apart, and those of `Doorways`."""
    size, beams = walls.line.shape[0], sight.polar.shape[1]
    raw = empty_found(2 * size + 2)
    n = 0
    for segment in range(size):
        following = (segment + 1) % size
        rest = (walls.first[following] - walls.last[segment] - 1) % beams
        known = n
        if size > 1 and rest <= MAX_REST and walls.cluster[segment] == walls.cluster[following]:
            n = add_crossing(raw, n, sight, walls, (segment, following), rules)
        if n == known:
            n = add_end(raw, n, sight, walls, (segment, 1), (rules, noise))
            n = add_end(raw, n, sight, walls, (following, -1), (rules, noise))
    found = sorted_by_bearing(raw, drop_twins(raw, n, walls))
    n = found.z.shape[0]
    doorways = find_doorways(found, n, sight, walls, doors)
    beyond = mark_beyond(found, n, doorways[0])
    sites = np.ones(n, np.bool_)
    for jamb in doorways[0].ravel():
        found.kind[jamb] = JAMB
    for k in range(n):
        sites[k] = found.kind[k] != JAMB and beyond[k] < 0
    cov = joint_covariance(found, walls.cov)
    return (found.z, cov, found.kind, found.convex, found.normals, beyond, sites), doorways


@kernel
def drop_twins(raw: Found, n: int, walls: Walls) -> int:
    """Number of corners left, moved to the front, when a corner found from both its faces counts once."""
    kept = 0
    for i in range(n):
        twin = -1
        for j in range(kept):
            if is_twin(raw, i, j):
                twin = j
        if twin < 0:
            copy_row(raw, i, raw, kept)
            kept += 1
        elif spread_of(raw, i, walls) < spread_of(raw, twin, walls):
            copy_row(raw, i, raw, twin)
    return kept


@kernel
def is_twin(found: Found, i: int, j: int) -> bool:
    """True when two corners are one: near each other, of one convexity, with no face that contradicts."""
    turn = wrap_angle(found.z[i, 1] - found.z[j, 1])
    distance = math.hypot(found.z[i, 0] - found.z[j, 0], found.z[j, 0] * turn)
    if found.convex[i] != found.convex[j] or distance > TWIN_M:
        return False
    before = abs(wrap_angle(found.normals[i, 0] - found.normals[j, 0]))
    after = abs(wrap_angle(found.normals[i, 1] - found.normals[j, 1]))
    return not (before > TWIN_RAD or after > TWIN_RAD)  # nan, a face unseen, contradicts nothing


@kernel
def copy_row(source: Found, i: int, target: Found, k: int) -> None:
    """Row i of `source` becomes row k of `target`."""
    target.z[k], target.own[k], target.lines[k] = source.z[i], source.own[i], source.lines[i]
    target.jacobian[k], target.normals[k], target.border[k] = source.jacobian[i], source.normals[i], source.border[i]
    target.kind[k], target.convex[k] = source.kind[i], source.convex[i]


@kernel
def sorted_by_bearing(raw: Found, n: int) -> Found:
    """The first n rows of `raw` in order of bearing."""
    found = empty_found(n)
    order = np.argsort(raw.z[:n, 1])
    for k in range(n):
        copy_row(raw, order[k], found, k)
    return found


@kernel
def joint_covariance(found: Found, line_cov: Array) -> Array:
    """(2n,2n) covariance of all z: each corner's own part, and J C J^T of the lines two corners share."""
    size = 2 * found.z.shape[0]
    cov = np.empty((size, size))
    for a in range(size):
        for b in range(a + 1):
            total = shared_covariance(found, a, b, line_cov)
            if a // 2 == b // 2:
                total += found.own[a // 2, a % 2, b % 2]
            cov[a, b] = cov[b, a] = total
    return cov


@kernel
def shared_covariance(found: Found, a: int, b: int, line_cov: Array) -> float:
    """Covariance of entries a and b of all z in a row, through the lines both corners hang on."""
    total = 0.0
    for k in range(4):
        i, j = k // 2, k % 2
        line = found.lines[a // 2, i]
        if line >= 0 and line == found.lines[b // 2, j]:
            left, right, cov = found.jacobian[a // 2, i, a % 2], found.jacobian[b // 2, j, b % 2], line_cov[line]
            total += left[0] * (cov[0, 0] * right[0] + cov[0, 1] * right[1])
            total += left[1] * (cov[1, 0] * right[0] + cov[1, 1] * right[1])
    return total
