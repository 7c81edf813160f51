"""Compiled functions of the key scans: free space and walls of a scan, and where its landmarks have carried it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.config import GridConfig, SensorModel
from mecp_env.slam.messages import MergedScan, Segments

MOVED, CAME, WENT = (1 << bit for bit in range(3))  # what can happen to landmarks


def free_and_walls(scan: MergedScan, segments: Segments, config: GridConfig) -> tuple[Array, Array]:
    """Outline (m,2) of the free space and strips (s,4,2) of wall of a scan, m, robot frame.

    Free space ends, and walls begin, at the fitted lines, not at the noisy ranges; a strip is one cell deep. Free space
    ends half a cell before a hit that lies on no line; nothing counts beyond `paint_range_m`.
    """
    beams = (scan.ranges, scan.bearings, scan.hit, scan.blind)
    lines = (segments.points, segments.line, segments.first, segments.last, segments.roll)
    outline, strips = _free_and_walls(beams, lines, config.record)
    return outline, strips


def seen_floor(scan: MergedScan, sensor: SensorModel) -> MergedScan:
    """The scan as it clears floor: beams of a weak laser that do not return clear only what it sees for sure."""
    most = sensor.free_without_return_m
    if most >= scan.max_range_m:
        return scan
    empty = ~scan.hit & (scan.ranges >= scan.max_range_m)
    return replace(scan, ranges=np.where(empty, most, scan.ranges))


@compiled
def _free_and_walls(
    beams: tuple[Array, Array, Bools, bool], lines: tuple[Array, Array, Ints, Ints, int], config: Rows
) -> tuple[Array, Array]:
    """See `free_and_walls`; the beams that fit a line are put onto it."""
    ranges, bearings, hit, blind = beams
    points, line, first, last, roll = lines
    count, tolerance = ranges.shape[0], 2.0 * config[0].resolution_m
    fitted, owner = ranges.copy(), np.full(count, -1, np.int64)  # the line of each beam, -1: none
    for i in range(line.shape[0]):
        for position in range(first[i], last[i] + 1):
            beam = (roll + position) % count
            incidence = math.cos(bearings[beam] - line[i, 0])
            if incidence > 0.01 and abs(line[i, 1] / incidence - ranges[beam]) < tolerance:
                fitted[beam] = line[i, 1] / incidence
                owner[beam] = i
    strips = np.empty((points.shape[0] + count, 4, 2))
    n = wall_strips(points, strips, config)
    n = loose_strips(fitted, bearings, (hit, blind), owner, strips, n, config)
    outline, kept, most = np.empty((count + 1, 2)), 0, config[0].paint_range_m
    for i in range(count):  # the beams along one line leave only its two ends
        after = (i + 1) % count
        reach = fitted[i] if owner[i] >= 0 or not hit[i] else fitted[i] - 0.5 * config[0].resolution_m
        clipped = reach >= most or fitted[i - 1] >= most or fitted[after] >= most or (blind and i in (0, count - 1))
        if owner[i] >= 0 and owner[i - 1] == owner[i] and owner[after] == owner[i] and not clipped:
            continue
        reach = max(min(reach, most), 0.0)
        outline[kept, 0] = reach * math.cos(bearings[i])
        outline[kept, 1] = reach * math.sin(bearings[i])
        kept += 1
    if blind:  # the outline closes at the laser
        outline[kept, 0], outline[kept, 1], kept = 0.0, 0.0, kept + 1
    return outline[:kept].copy(), strips[:n].copy()


@compiled
def loose_strips(
    ranges: Array, bearings: Array, hit_and_blind: tuple[Bools, bool], owner: Ints, strips: Array, n: int, config: Rows
) -> int:
    """Write strips (.,4,2) behind neighbouring hits that lie on no line (a post, a leg), from row n; the next row."""
    count, depth, reach = ranges.shape[0], config[0].resolution_m, config[0].paint_range_m
    hit, blind = hit_and_blind
    for i in range(1 if blind else 0, count):
        j = i - 1 if i > 0 else count - 1
        near = hit[i] and hit[j] and (owner[i] < 0 or owner[j] < 0) and max(ranges[i], ranges[j]) < reach
        step = math.sin(0.5 * abs(bearings[i] - bearings[j])) * (ranges[i] + ranges[j])
        if not near or abs(ranges[i] - ranges[j]) > depth + step:
            continue
        for k in range(4):
            beam = j if k in (0, 3) else i
            radius = ranges[beam] + (depth if k >= 2 else 0.0)
            strips[n, k, 0] = radius * math.cos(bearings[beam])
            strips[n, k, 1] = radius * math.sin(bearings[beam])
        n += 1
    return n


@compiled
def turns_into_room(points: Array, i: int, j: int, gap: float) -> bool:
    """True when segment j of (L,2,2) follows i at an inner corner of a room: the wall goes on behind both faces."""
    if math.hypot(points[j, 0, 0] - points[i, 1, 0], points[j, 0, 1] - points[i, 1, 1]) > gap:
        return False
    ax, ay = points[i, 1, 0] - points[i, 0, 0], points[i, 1, 1] - points[i, 0, 1]
    bx, by = points[j, 1, 0] - points[j, 0, 0], points[j, 1, 1] - points[j, 0, 1]
    return bool(ax * by - ay * bx > 0.3 * math.hypot(ax, ay) * math.hypot(bx, by))


@compiled
def wall_strips(points: Array, strips: Array, config: Rows) -> int:
    """Write strips (.,4,2) one cell deep behind the segments (L,2,2), as far as they are painted; how many."""
    count, n, depth, reach = points.shape[0], 0, config[0].resolution_m, config[0].paint_range_m
    for i in range(count):
        dx, dy = points[i, 1, 0] - points[i, 0, 0], points[i, 1, 1] - points[i, 0, 1]
        a, b = max(dx * dx + dy * dy, 1e-12), points[i, 0, 0] * dx + points[i, 0, 1] * dy
        root, length = b * b - a * (points[i, 0, 0] ** 2 + points[i, 0, 1] ** 2 - reach * reach), math.hypot(dx, dy)
        if not root > 0.0 or length < 1e-6:
            continue
        first, last = max((-b - math.sqrt(root)) / a, 0.0), min((-b + math.sqrt(root)) / a, 1.0)
        if first >= last:
            continue
        ux, uy, start, end = dx / length, dy / length, first * length, last * length
        if first == 0.0 and turns_into_room(points, i - 1 if i > 0 else count - 1, i, 2.0 * depth):
            start -= depth
        if last == 1.0 and turns_into_room(points, i, (i + 1) % count, 2.0 * depth):
            end += depth
        for k in range(4):  # counter-clockwise about the robot: behind is on the right of start -> end
            along, behind = (start if k in (0, 3) else end), (depth if k >= 2 else 0.0)
            strips[n, k, 0] = points[i, 0, 0] + along * ux + behind * uy
            strips[n, k, 1] = points[i, 0, 1] + along * uy - behind * ux
        n += 1
    return n


@compiled
def anchored_poses(anchor: Ints, p_robot: Array, T_map_robot: Array, p_map: Array) -> tuple[Array, Ints]:
    """Poses (n,3) that lay the anchors (n,k,2) of a scan over their landmarks p_map (F,2), and the count of anchors.

    Rigid least squares over the anchors (n,k) that are still in the map (-1: none, nan: gone): the heading from two or
    more, with one the old heading, without any the old pose.
    """
    poses, present = T_map_robot.copy(), np.zeros(anchor.shape[0], np.int64)
    for i in range(anchor.shape[0]):
        sums = np.zeros(4)
        for j in range(anchor.shape[1]):
            if anchor[i, j] >= 0 and not math.isnan(p_map[anchor[i, j], 0]):
                present[i] += 1
                sums[0] += p_robot[i, j, 0]
                sums[1] += p_robot[i, j, 1]
                sums[2] += p_map[anchor[i, j], 0]
                sums[3] += p_map[anchor[i, j], 1]
        if present[i] == 0:
            continue
        sums /= present[i]
        cosine, sine = 0.0, 0.0
        for j in range(anchor.shape[1]):
            if present[i] > 1 and anchor[i, j] >= 0 and not math.isnan(p_map[anchor[i, j], 0]):
                ax, ay = p_robot[i, j, 0] - sums[0], p_robot[i, j, 1] - sums[1]
                bx, by = p_map[anchor[i, j], 0] - sums[2], p_map[anchor[i, j], 1] - sums[3]
                cosine += ax * bx + ay * by
                sine += ax * by - ay * bx
        heading = math.atan2(sine, cosine) if present[i] > 1 else T_map_robot[i, 2]
        poses[i, 2] = heading
        poses[i, 0] = sums[2] - math.cos(heading) * sums[0] + math.sin(heading) * sums[1]
        poses[i, 1] = sums[3] - math.sin(heading) * sums[0] - math.cos(heading) * sums[1]
    return poses, present


@compiled
def compare_landmarks(ids: Ints, p_map: Array, p_before: Array, limit: float) -> tuple[Array, int]:
    """(F,2) m: the landmarks (N,2) by id, nan where an id is none; and what happened to them since (F',2).

    That is a sum of MOVED (by more than `limit`), CAME and WENT.
    """
    rows = p_before.shape[0]
    for i in range(ids.shape[0]):
        rows = max(rows, ids[i] + 1)
    table = np.full((rows, 2), np.nan)
    for i in range(ids.shape[0]):
        table[ids[i], 0], table[ids[i], 1] = p_map[i, 0], p_map[i, 1]
    moved, came, went = 0, 0, 0
    for i in range(rows):
        known = not math.isnan(table[i, 0])
        was = i < p_before.shape[0] and not math.isnan(p_before[i, 0])
        if known and was and math.hypot(table[i, 0] - p_before[i, 0], table[i, 1] - p_before[i, 1]) > limit:
            moved = MOVED
        if known and not was:
            came = CAME
        if was and not known:
            went = WENT
    return table, moved + came + went


@compiled
def nearest_of_group(places: Array, group: Ints, wanted: int, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the places (n,2) or poses (n,3) of a group (n,); inf without one."""
    best = math.inf
    for i in range(places.shape[0]):
        if group[i] == wanted:
            distance = math.hypot(places[i, 0] - x, places[i, 1] - y)
            best = min(best, distance)  # nan is never near
    return best


@compiled
def anchor_scans(
    anchor: Ints, p_robot: Array, T_map_robot: Array, p_landmark: Array, matched: Ints, ids: Ints, covs: Array
) -> None:
    """Anchor the scans that have no anchors at the most certain of the landmarks `matched` (m,), two or more.

    Of the scans: anchors (n,k) and where they are seen (n,k,2), which are written, and poses (n,3). `p_landmark` (F,2)
    by id; the belief's `ids` (N,) and covariances (N,2,2) rank the landmarks.
    """
    loose = False
    for i in range(anchor.shape[0]):
        loose = loose or anchor[i, 0] < 0
    if not loose or matched.shape[0] < 2:
        return
    most, n = anchor.shape[1], 0
    surest, spread = np.empty(most, np.int64), np.full(most, math.inf)
    for row in range(ids.shape[0]):
        known = False
        for i in range(matched.shape[0]):
            known = known or matched[i] == ids[row]
        size = covs[row, 0, 0] + covs[row, 1, 1]
        if not known or size >= spread[most - 1]:
            continue
        n = min(n + 1, most)
        at = n - 1
        while at > 0 and spread[at - 1] > size:
            spread[at], surest[at] = spread[at - 1], surest[at - 1]
            at -= 1
        spread[at], surest[at] = size, ids[row]
    for i in range(anchor.shape[0] if n > 1 else 0):
        if anchor[i, 0] >= 0:
            continue
        c, s = math.cos(T_map_robot[i, 2]), math.sin(T_map_robot[i, 2])
        for j in range(n):
            dx, dy = p_landmark[surest[j], 0] - T_map_robot[i, 0], p_landmark[surest[j], 1] - T_map_robot[i, 1]
            anchor[i, j], p_robot[i, j, 0], p_robot[i, j, 1] = surest[j], c * dx + s * dy, -s * dx + c * dy
