"""Point features of one scan (III-A.1): line intersections, line ends and door jambs, with joint covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Record, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points, wrap_angle
from mecp_env.slam.frontend.beams import (
    Beams,
    Lines,
    Noise,
    Pieces,
    Records,
    RolledScan,
    laser_noise,
    roll_beams,
    step_of,
)
from mecp_env.slam.frontend.door_gaps import find_doorways, mark_beyond
from mecp_env.slam.frontend.line_corners import FOUND, add_end, add_intersection, empty_corners, spread_of
from mecp_env.slam.messages import CornerKind


class Found(NamedTuple):
    """The fields of `Corners`, and of its `Doorways`, in their order."""

    z: Array  # (n,2) m, rad
    cov: Array  # (2n,2n)
    kind: Ints  # (n,)
    convex: Bools  # (n,)
    normals: Array  # (n,2) rad
    beyond: Ints  # (n,)
    sites: Bools  # (n,)
    jambs: Ints  # (g,2)
    width: Array  # (g,) m
    confirmable: Bools  # (g,)


@compiled
def extract_corners(beams: Beams, pieces: Pieces, config: Rows, gap_config: Rows, sensor: Rows) -> Found:
    """The corners of a scan in order of bearing, with joint covariance, descriptor and the doorways among them.

    A corner is the intersection of two consecutive segments, or the end of one that is followed by something farther
    (III-A.1). Differs from the paper: its constant sigmas are replaced by the covariance of the lines, shared by the
    corners of one wall, and the two ends facing each other across a gap of door width are marked as jambs.
    """
    limits, noise, (points, line, line_cov, cluster, first, last, roll) = config[0], laser_noise(sensor), pieces
    length = np.empty(line.shape[0])
    for k in range(line.shape[0]):
        length[k] = math.hypot(points[k, 1, 0] - points[k, 0, 0], points[k, 1, 1] - points[k, 0, 1])
    lines = Lines(line, line_cov, cluster, first, last, length)
    polar, hit = roll_beams(beams, roll), np.roll(beams.hit, -roll)
    scan = RolledScan(polar, hit, beams.raw_ranges, beams.raw_bearings, roll, step_of(beams.bearings), beams.max_range)
    count, size, width = 0, line.shape[0], scan.polar.shape[1]
    ends = empty_corners(2 * size + 2)  # the corners at each end of each segment, of which several may be one corner
    for k in range(size):
        following, known = (k + 1) % size, count
        rest = (first[following] - last[k] - 1) % width
        if size > 1 and rest <= 2 * noise.edge and cluster[k] == cluster[following]:
            count += add_intersection(ends[count], scan, lines, (k, following), limits, noise)
        if count == known:
            count += add_end(ends[count], scan, lines, k, 1, limits, noise)
            count += add_end(ends[count], scan, lines, following, -1, limits, noise)
    found = one_each(ends[:count], line_cov, limits)
    z, n = found["z"].copy(), found.shape[0]
    p_robot = polar_to_points(z)
    jambs, gap_width, confirmable = find_doorways(found, p_robot, scan, lines, limits, gap_config[0], noise)
    beyond = mark_beyond(found, p_robot, jambs, limits.line_m)
    for jamb in jambs.ravel():
        if found[jamb].convex:  # a concave one is the corner of a room
            found[jamb].kind = CornerKind.JAMB
    sites = np.empty(n, np.bool_)
    for k in range(n):
        sites[k] = found[k].kind != CornerKind.JAMB and beyond[k] < 0
    cov = sensor_covariance(z, noise) if limits.is_constant else joint_covariance(found, line_cov)
    rows = found["kind"].copy(), found["convex"].copy(), found["normals"].copy()
    return Found(z, cov, rows[0], rows[1], rows[2], beyond, sites, jambs, gap_width, confirmable)


@compiled
def sensor_covariance(z: Array, noise: Noise) -> Array:
    """(2n,2n) sigma_r and sigma_theta of the laser, for every corner z (n,2) alike (IV)."""
    cov = np.zeros((z.size, z.size))
    for k in range(z.shape[0]):
        cov[2 * k, 2 * k] = max(noise.range_m, noise.share * z[k, 0]) ** 2
        cov[2 * k + 1, 2 * k + 1] = noise.bearing**2
    return cov


@compiled
def one_each(rows: Records, line_cov: Array, limits: Record) -> Records:
    """The rows by bearing; of two near each other and of one convexity the one that is more certain."""
    chosen, kept = np.empty(rows.shape[0], np.int64), 0
    for i in range(rows.shape[0]):
        twin = -1
        for j in range(kept):
            other = rows[chosen[j]]
            across = other.z[0] * wrap_angle(rows[i].z[1] - other.z[1])
            near = math.hypot(rows[i].z[0] - other.z[0], across) <= limits.detail_m
            twin = j if near and rows[i].convex == other.convex else twin
        if twin < 0:
            chosen[kept] = i
            kept += 1
        elif spread_of(rows[i], line_cov) < spread_of(rows[chosen[twin]], line_cov):
            chosen[twin] = i
    found = np.empty(kept, FOUND)
    for n in range(kept):
        row, at = chosen[n], n
        while at > 0 and found[at - 1].z[1] > rows[row].z[1]:
            found[at] = found[at - 1]
            at -= 1
        found[at] = rows[row]
    return found


@compiled
def joint_covariance(found: Records, line_cov: Array) -> Array:
    """(2n,2n) covariance of all z: each corner's own part, and J C J^T of the lines two corners share."""
    size = found.shape[0]
    cov = np.zeros((2 * size, 2 * size))
    for a in range(size):
        for b in range(a + 1):
            add_shared(cov[2 * a : 2 * a + 2, 2 * b : 2 * b + 2], found[a], found[b], line_cov)
        for entry in range(3):
            u, v = (entry + 1) // 2, entry // 2
            cov[2 * a + u, 2 * a + v] += found[a].own[u, v]
    for row in range(2 * size):
        for column in range(row):
            cov[column, row] = cov[row, column]
    return cov


@compiled
def add_shared(block: Array, a: Record, b: Record, line_cov: Array) -> None:
    """Adds J C J^T to the block (2,2) of corners a and b for each line that determines both."""
    for k in range(4):
        line = a.lines[k // 2]
        if line < 0 or line != b.lines[k % 2]:
            continue
        left, right, C = a.jacobian[k // 2], b.jacobian[k % 2], line_cov[line]
        for entry in range(4):
            u, v = entry // 2, entry % 2
            block[u, v] += left[u, 0] * (C[0, 0] * right[v, 0] + C[0, 1] * right[v, 1])
            block[u, v] += left[u, 1] * (C[1, 0] * right[v, 0] + C[1, 1] * right[v, 1])
