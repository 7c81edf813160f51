"""What stands where the map has seen free floor: somebody walks there, and no corner of his is a landmark.

Not in the paper, whose world is static. A run of beams that end on floor seen free before, well away from all that is
not, comes from something that moved in since; a line fitted to such beams is no wall, and its beams paint none. Where
nothing moves a hit lies on a wall, beside which the map knows no free floor: nothing is left out there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.config import TransientConfig
from mecp_env.slam.messages import Belief, Bools, Corners, Decision, Match, MergedScan, Reason, Segments, SemanticGrid

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

FREE, DOOR = 1, 3  # as in mecp_env.slam.messages.Cell
NEW, IGNORED, TRANSIENT = int(Decision.NEW), int(Decision.IGNORED), int(Reason.TRANSIENT)
SIGMAS = 2.0  # of the place of a hit in the map, that the margin is widened by
BODY_M = 0.45  # of the middle of what is seen of somebody, all of him
SHY_M = 0.25  # a new corner as near to somebody may be his
SHARE = 0.5  # of the beams of a segment or a cluster that must be transient for it to be


def find_transient(
    beams: MergedScan, segments: Segments, belief: Belief, grid: SemanticGrid, config: TransientConfig
) -> Bools | None:
    """(B,) which beams end on something that stands where the map has seen free floor; None where none does.

    MergedScan on segments longer than `longest_m` are not asked: they are on walls, whatever the map says.
    """
    if not config.margin_m or not grid.label.size:
        return None
    marked = np.zeros(len(beams.ranges), np.bool_)
    lines = segments.points, segments.first, segments.last, segments.roll
    open_beams = beams_off_walls(beams.hit, *lines, config.longest_m)
    pose = belief.T_map_robot, np.ascontiguousarray(belief.pose_cov)
    limits = config.margin_m, config.most_sigma_m, config.range_m, config.beams
    seen = beams.ranges, beams.bearings, open_beams
    found = mark_transient(seen, pose, (grid.label, grid.origin, grid.resolution_m), limits, marked)
    return whole_bodies(beams.ranges, beams.bearings, beams.hit, marked) if found else None


def without_transients(segments: Segments, transient: Bools | None) -> Segments:
    """The segments but for those whose beams are mostly transient."""
    if transient is None or not len(segments.first):
        return segments
    kept = standing(segments.first, segments.last, segments.roll, transient)
    if kept.all():
        return segments
    return replace(
        segments,
        points=segments.points[kept],
        line=segments.line[kept],
        cov=segments.cov[kept],
        cluster=segments.cluster[kept],
        first=segments.first[kept],
        last=segments.last[kept],
    )


def passing(beams: MergedScan, transient: Bools | None) -> MergedScan:
    """The beams as they are to be painted: free floor up to what is transient, no wall there."""
    return beams if transient is None else replace(beams, hit=beams.hit & ~transient)


def shun_transients(match: Match, corners: Corners, beams: MergedScan, transient: Bools | None) -> Match:
    """The match, in which no new corner as near to something transient is worth a second look; in place."""
    if transient is not None and len(corners):
        _shun(corners.z, beams.ranges, beams.bearings, transient, match.decision, match.reason)
    return match


@compiled
def _shun(z: Array, ranges: Array, bearings: Array, transient: Bools, decision: Ints, reason: Ints) -> None:
    """Ignores the corners z (n,2) still NEW that lie near the end of a transient beam (B,)."""
    for i in range(z.shape[0]):
        near = False
        for k in range(ranges.shape[0] if decision[i] == NEW else 0):
            if transient[k]:
                square = z[i, 0] ** 2 + ranges[k] ** 2 - 2.0 * z[i, 0] * ranges[k] * math.cos(z[i, 1] - bearings[k])
                near = near or square < SHY_M * SHY_M
        if near:
            decision[i], reason[i] = IGNORED, TRANSIENT


@compiled
def whole_bodies(ranges: Array, bearings: Array, hit: Bools, marked: Bools) -> Bools:
    """(B,) the marked beams, and those beside each run of them that end near its middle: the rim of the same body."""
    size = ranges.shape[0]
    whole = marked.copy()
    for i in range(size):
        if not marked[i] or marked[i - 1]:
            continue
        count, x, y = 0, 0.0, 0.0
        while count < size and marked[(i + count) % size]:
            k = (i + count) % size
            x, y, count = x + ranges[k] * math.cos(bearings[k]), y + ranges[k] * math.sin(bearings[k]), count + 1
        x, y = x / count, y / count
        for side in range(2):
            k = i - 1 if side == 0 else i + count
            while hit[k % size] and not whole[k % size] and ends_near(ranges[k % size], bearings[k % size], x, y):
                whole[k % size] = True
                k += 2 * side - 1
    return whole


@compiled
def ends_near(r: float, bearing: float, x: float, y: float) -> bool:
    """True when a beam ends near (x, y), robot frame."""
    return math.hypot(r * math.cos(bearing) - x, r * math.sin(bearing) - y) < BODY_M


@compiled
def beams_off_walls(hit: Bools, points: Array, first: Ints, last: Ints, roll: int, longest: float) -> Bools:
    """(B,) the hits but for those on segments that are longer than `longest` m."""
    size, asked = hit.shape[0], hit.copy()
    for k in range(first.shape[0]):
        if math.hypot(points[k, 1, 0] - points[k, 0, 0], points[k, 1, 1] - points[k, 0, 1]) > longest:
            for position in range(first[k] + roll, last[k] + roll + 1):
                asked[position if position < size else position - size] = False
    return asked


@compiled
def mark_transient(
    beams: tuple[Array, Array, Bools],
    pose: tuple[Array, Array],
    map_of_floor: tuple[Bytes, Array, float],
    limits: tuple[float, float, float, int],
    transient: Bools,
) -> bool:
    """Marks (B,) runs of beams that end on free floor; says whether there are any.

    Given are range and bearing of the beams, and which of them are asked; the pose (3,) and its covariance; labels
    (H,W), origin and resolution of the grid; margin (m), largest sigma of a hit's place (m), largest range (m) and the
    least run.
    """
    ranges, bearings, asked = beams
    (x, y, heading), cov = pose[0], pose[1]
    least, run, found = limits[3], 0, False
    place_sigma, turn_sigma = math.sqrt(max(cov[0, 0] + cov[1, 1], 0.0)), math.sqrt(max(cov[2, 2], 0.0))
    for i in range(ranges.shape[0]):
        sigma = place_sigma + ranges[i] * turn_sigma
        on_floor = asked[i] and ranges[i] < limits[2] and sigma < limits[1]
        if on_floor:
            p_x, p_y = x + ranges[i] * math.cos(heading + bearings[i]), y + ranges[i] * math.sin(heading + bearings[i])
            on_floor = is_floor(map_of_floor, p_x, p_y, limits[0] + SIGMAS * sigma)
        run = run + 1 if on_floor else 0
        if run >= least:
            found = True
            for k in range(least):
                transient[i - k] = True
    return found


@compiled
def is_floor(map_of_floor: tuple[Bytes, Array, float], x: float, y: float, margin: float) -> bool:
    """True when every cell within `margin` of (x, y) is known to be free."""
    label, origin, resolution = map_of_floor
    column, row, near = (x - origin[0]) / resolution, (y - origin[1]) / resolution, margin / resolution
    low_r, high_r, low_c, high_c = math.floor(row - near), math.floor(row + near), 0, 0
    low_c, high_c = math.floor(column - near), math.floor(column + near)
    if low_r < 0 or low_c < 0 or high_r >= label.shape[0] or high_c >= label.shape[1]:
        return False
    centre = label[math.floor(row), math.floor(column)]
    if centre != FREE and centre != DOOR:
        return False
    for r in range(low_r, high_r + 1):
        for c in range(low_c, high_c + 1):
            if label[r, c] != FREE and label[r, c] != DOOR and math.hypot(c + 0.5 - column, r + 0.5 - row) < near:
                return False
    return True


@compiled
def standing(first: Ints, last: Ints, roll: int, transient: Bools) -> Bools:
    """(L,) which segments stand: those of whose beams few are transient."""
    kept = np.ones(first.shape[0], np.bool_)
    for k in range(first.shape[0]):
        count = 0
        for position in range(first[k], last[k] + 1):
            count += transient[(position + roll) % transient.shape[0]]
        kept[k] = count <= SHARE * (last[k] - first[k] + 1)
    return kept
