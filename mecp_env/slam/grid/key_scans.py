"""Kernels of the key scans: the outline of a scan, the walls in it, and where its landmarks have carried it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

MOVED, CAME, WENT = 1, 2, 4  # what can happen to landmarks


@compiled
def free_and_walls(
    beams: tuple[Array, Array, Bools],
    segments: tuple[Array, Array, Ints, Ints, int],
    margin: float,
    reach: float,
    depth: float,
) -> tuple[Array, Array]:
    """Outline (m,2) of the free space and strips (s,4,2) of wall of a scan, m, robot frame.

    `beams`: ranges, bearings and hit (B,); `segments`: points (L,2,2), lines (L,2), first and last position (L,), roll.
    Free space ends `margin` before a hit on no line; nothing counts beyond `reach`; walls are `depth` deep.
    """
    ranges, bearings, hit = beams
    points, line, first, last, roll = segments
    fitted, owner = fitted_ranges(ranges, bearings, line, first, last, roll)
    outline = scan_outline(fitted, bearings, hit, owner, (margin, reach))
    walls = wall_strips(points, depth, reach)
    loose = loose_strips(fitted, bearings, hit, owner, depth, reach)
    strips = np.empty((walls.shape[0] + loose.shape[0], 4, 2))
    for i in range(strips.shape[0]):
        strip = walls[i] if i < walls.shape[0] else loose[i - walls.shape[0]]
        for k in range(4):
            strips[i, k, 0], strips[i, k, 1] = strip[k, 0], strip[k, 1]
    return outline, strips


@compiled
def fitted_ranges(
    ranges: Array, bearings: Array, line: Array, first: Ints, last: Ints, roll: int
) -> tuple[Array, Ints]:
    """Ranges (B,) put onto the fitted lines (L,2) where there is one, and the line of each beam (-1: none)."""
    count = ranges.shape[0]
    fitted = ranges.copy()
    owner = np.full(count, -1, np.int64)
    for i in range(line.shape[0]):
        for position in range(first[i], last[i] + 1):
            beam = (roll + position) % count
            incidence = math.cos(bearings[beam] - line[i, 0])
            if incidence > 0.01 and abs(line[i, 1] / incidence - ranges[beam]) < 0.3:
                fitted[beam] = line[i, 1] / incidence
                owner[beam] = i
    return fitted, owner


@compiled
def scan_outline(ranges: Array, bearings: Array, hit: Bools, owner: Ints, short_reach: tuple[float, float]) -> Array:
    """Outline (m,2) of the free space of a scan, robot frame; the beams along one line leave only its two ends.

    `short_reach`: how far a hit off any line is kept back (m), and how far a beam is trusted (m).
    """
    count, kept = ranges.shape[0], 0
    outline = np.empty((count, 2))
    for i in range(count):
        after = (i + 1) % count
        reach = ranges[i] if owner[i] >= 0 or not hit[i] else ranges[i] - short_reach[0]
        clipped = reach >= short_reach[1] or ranges[i - 1] >= short_reach[1] or ranges[after] >= short_reach[1]
        if owner[i] >= 0 and owner[i - 1] == owner[i] and owner[after] == owner[i] and not clipped:
            continue
        reach = max(min(reach, short_reach[1]), 0.0)
        outline[kept, 0] = reach * math.cos(bearings[i])
        outline[kept, 1] = reach * math.sin(bearings[i])
        kept += 1
    return outline[:kept].copy()


@compiled
def loose_strips(ranges: Array, bearings: Array, hit: Bools, owner: Ints, depth: float, reach: float) -> Array:
    """Strips (s,4,2) behind neighbouring hits that lie on no line (a post, a leg), robot frame."""
    count, kept = ranges.shape[0], 0
    strips = np.empty((count, 4, 2))
    for i in range(count):
        j = i - 1 if i > 0 else count - 1
        near = hit[i] and hit[j] and (owner[i] < 0 or owner[j] < 0) and max(ranges[i], ranges[j]) < reach
        step = math.sin(0.5 * abs(bearings[i] - bearings[j])) * (ranges[i] + ranges[j])
        if not near or abs(ranges[i] - ranges[j]) > depth + step:
            continue
        for k in range(4):
            beam = j if k in (0, 3) else i
            radius = ranges[beam] + (depth if k >= 2 else 0.0)
            strips[kept, k, 0] = radius * math.cos(bearings[beam])
            strips[kept, k, 1] = radius * math.sin(bearings[beam])
        kept += 1
    return strips[:kept].copy()


@compiled
def clip_to_circle(points: Array, reach: float) -> Array:
    """Shares (2,) of a segment (2,2) at which it lies within `reach` of the origin; (1, 0): nowhere."""
    dx, dy = points[1, 0] - points[0, 0], points[1, 1] - points[0, 1]
    a = max(dx * dx + dy * dy, 1e-12)
    b = points[0, 0] * dx + points[0, 1] * dy
    root = b * b - a * (points[0, 0] ** 2 + points[0, 1] ** 2 - reach * reach)
    shares = np.array([1.0, 0.0])
    if root > 0.0:
        shares[0] = max((-b - math.sqrt(root)) / a, 0.0)
        shares[1] = min((-b + math.sqrt(root)) / a, 1.0)
    return shares


@compiled
def turns_into_room(points: Array, i: int, j: int, gap: float) -> bool:
    """True when segment j of (L,2,2) follows i at an inner corner of a room: the wall goes on behind both faces."""
    if math.hypot(points[j, 0, 0] - points[i, 1, 0], points[j, 0, 1] - points[i, 1, 1]) > gap:
        return False
    ax, ay = points[i, 1, 0] - points[i, 0, 0], points[i, 1, 1] - points[i, 0, 1]
    bx, by = points[j, 1, 0] - points[j, 0, 0], points[j, 1, 1] - points[j, 0, 1]
    return bool(ax * by - ay * bx > 0.3 * math.hypot(ax, ay) * math.hypot(bx, by))


@compiled
def wall_strips(points: Array, depth: float, reach: float) -> Array:
    """Strips (s,4,2), `depth` deep, behind the segments (L,2,2) as far as `reach`, robot frame."""
    count, kept = points.shape[0], 0
    strips = np.empty((count, 4, 2))
    for i in range(count):
        share = clip_to_circle(points[i], reach)
        length = math.hypot(points[i, 1, 0] - points[i, 0, 0], points[i, 1, 1] - points[i, 0, 1])
        if share[0] >= share[1] or length < 1e-6:
            continue
        ux, uy = (points[i, 1, 0] - points[i, 0, 0]) / length, (points[i, 1, 1] - points[i, 0, 1]) / length
        start, end = share[0] * length, share[1] * length
        if share[0] == 0.0 and turns_into_room(points, i - 1 if i > 0 else count - 1, i, 2.0 * depth):
            start -= depth
        if share[1] == 1.0 and turns_into_room(points, i, (i + 1) % count, 2.0 * depth):
            end += depth
        for k in range(4):  # counter-clockwise about the robot: behind is on the right of start -> end
            along, behind = (start if k in (0, 3) else end), (depth if k >= 2 else 0.0)
            strips[kept, k, 0] = points[i, 0, 0] + along * ux + behind * uy
            strips[kept, k, 1] = points[i, 0, 1] + along * uy - behind * ux
        kept += 1
    return strips[:kept].copy()


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
def look(ids: Ints, p_map: Array, p_before: Array, limit: float) -> tuple[Array, int]:
    """The `landmark_table` of the landmarks (N,), (N,2), and its `landmark_changes` since (F',2)."""
    table = landmark_table(ids, p_map, p_before.shape[0])
    return table, landmark_changes(table, p_before, limit)


@compiled
def landmark_changes(p_map: Array, p_before: Array, limit: float) -> int:
    """What happened to the landmarks (F,2) since (F',2), nan: not there; a sum of MOVED (by `limit`), CAME, WENT."""
    moved, came, went = 0, 0, 0
    for i in range(p_map.shape[0]):
        known = not math.isnan(p_map[i, 0])
        was = i < p_before.shape[0] and not math.isnan(p_before[i, 0])
        if known and was and math.hypot(p_map[i, 0] - p_before[i, 0], p_map[i, 1] - p_before[i, 1]) > limit:
            moved = MOVED
        if known and not was:
            came = CAME
        if was and not known:
            went = WENT
    return moved + came + went


@compiled
def ring_shifts(p_map: Array, ids: Ints, p_painted: Array, first: Ints) -> Array:
    """(P,) how far a vertex of each ring moved: `ids` (V,) now and as painted (V,2); ring i starts at first[i]."""
    shifts = np.zeros(first.shape[0])
    ring = 0
    for i in range(ids.shape[0]):
        while ring + 1 < first.shape[0] and i >= first[ring + 1]:
            ring += 1
        distance = math.hypot(p_map[ids[i], 0] - p_painted[i, 0], p_map[ids[i], 1] - p_painted[i, 1])
        shifts[ring] = max(shifts[ring], distance)
    return shifts


@compiled
def any_near(points: Array, x: float, y: float, clear: float) -> bool:
    """True when one of the points (n,2) lies within `clear` of (x, y)."""
    near = False
    for i in range(points.shape[0]):
        near = near or math.hypot(points[i, 0] - x, points[i, 1] - y) < clear
    return near


@compiled
def landmark_table(ids: Ints, p_map: Array, least: int) -> Array:
    """(F,2) m: the landmark positions (N,2) by id, nan where an id is none; `least` rows or more."""
    rows = least
    for i in range(ids.shape[0]):
        rows = max(rows, ids[i] + 1)
    table = np.full((rows, 2), np.nan)
    for i in range(ids.shape[0]):
        table[ids[i], 0], table[ids[i], 1] = p_map[i, 0], p_map[i, 1]
    return table


@compiled
def hang_up(scans: tuple[Ints, Array, Array], p_landmark: Array, matched: Ints, belief: tuple[Ints, Array]) -> None:
    """Hang the scans that hang on nothing on the surest of the landmarks `matched` (m,), two or more.

    `scans`: anchors (n,k), where they are seen (n,k,2), poses (n,3); the first two are written. `p_landmark` (F,2) by
    id; `belief`: ids (N,) and covariances (N,2,2).
    """
    anchor, p_robot, T_map_robot = scans
    loose = False
    for i in range(anchor.shape[0]):
        loose = loose or anchor[i, 0] < 0
    if not loose or matched.shape[0] < 2:
        return
    best = surest(matched, belief[0], belief[1], anchor.shape[1])
    for i in range(anchor.shape[0] if best.shape[0] > 1 else 0):
        if anchor[i, 0] >= 0:
            continue
        c, s = math.cos(T_map_robot[i, 2]), math.sin(T_map_robot[i, 2])
        for j in range(best.shape[0]):
            dx, dy = p_landmark[best[j], 0] - T_map_robot[i, 0], p_landmark[best[j], 1] - T_map_robot[i, 1]
            anchor[i, j], p_robot[i, j, 0], p_robot[i, j, 1] = best[j], c * dx + s * dy, -s * dx + c * dy


@compiled
def surest(matched: Ints, ids: Ints, covs: Array, count: int) -> Ints:
    """Those `count` of the landmarks `matched` (m,) that the belief (N,), covariances (N,2,2), knows best."""
    chosen, spread = np.empty(count, np.int64), np.full(count, math.inf)
    n = 0
    for row in range(ids.shape[0]):
        known = False
        for i in range(matched.shape[0]):
            known = known or matched[i] == ids[row]
        size = covs[row, 0, 0] + covs[row, 1, 1]
        if not known or size >= spread[count - 1]:
            continue
        n = min(n + 1, count)
        at = n - 1
        while at > 0 and spread[at - 1] > size:
            spread[at], chosen[at] = spread[at - 1], chosen[at - 1]
            at -= 1
        spread[at], chosen[at] = size, ids[row]
    return chosen[:n].copy()


@compiled
def nearest_of_room(T_map_robot: Array, room: Ints, x: float, y: float, wanted: int) -> float:
    """Distance from (x, y) to the nearest of the poses (n,3) taken in the room `wanted`; inf without one."""
    best = math.inf
    for i in range(T_map_robot.shape[0]):
        if room[i] == wanted:
            best = min(best, math.hypot(T_map_robot[i, 0] - x, T_map_robot[i, 1] - y))
    return best


@compiled
def door_quads(p_landmark: Array, jambs: Ints, depth: Array, rim: float) -> Array:
    """(d,4,2) m: of each door the right and left jamb, then the left and right one of the other face, and a rim.

    `p_landmark` (F,2) by id; `jambs` (d,4): right and left of the first face, and of the other; `depth` (d,) m from
    those of the other face on.
    """
    quads = np.empty((jambs.shape[0], 4, 2))
    for i in range(jambs.shape[0]):
        right, left = p_landmark[jambs[i, 0]], p_landmark[jambs[i, 1]]
        length = max(math.hypot(left[0] - right[0], left[1] - right[1]), 1e-9)
        onward_x, onward_y = (left[1] - right[1]) / length, -((left[0] - right[0]) / length)
        for k in range(4):
            p_jamb = p_landmark[jambs[i, (0, 1, 3, 2)[k]]]
            deep, beyond = (-rim, 0.0) if k < 2 else (depth[i], rim)
            quads[i, k, 0] = p_jamb[0] + deep * onward_x + beyond * onward_x
            quads[i, k, 1] = p_jamb[1] + deep * onward_y + beyond * onward_y
    return quads
