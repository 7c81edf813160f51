"""Compiled functions for the corners of lines (III-A.1): where two consecutive ones intersect, and where one ends.

At an end, what follows does not occlude it, or a second face is seen that is too short for a segment of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Record, row_type
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.beams import Lines, Noise, Records, RolledScan
from mecp_env.slam.messages import CornerKind

SMEAR = 1.0 / math.sqrt(math.pi)  # integral of Phi (1 - Phi): a transition blurred by the bearing noise
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


class LineEnd(NamedTuple):
    """One end of a segment, and the beams that follow it."""

    alpha: float
    rho: float
    position: int  # of the segment's last beam on this side
    side: int  # +1: ccw end, -1: beginning
    inner: int  # beams of the segment to look at
    rest: int  # beams after it before something else begins
    free: bool  # the scan jumps back there; False: something nearer follows, or no end is in reach


class EndBearing(NamedTuple):
    """The bearing of a line end, and how much speaks for a second face there."""

    bearing: float
    variance: float
    evidence: float


@compiled
def add_end(
    found: Record, scan: RolledScan, lines: Lines, segment: int, side: int, limits: Record, noise: Noise
) -> bool:
    """True when a segment ends in a corner on a side (+1: ccw end, -1: its beginning); it is in row `found` then.

    Either something farther follows (the line end of III-A.1), or a second face at a right angle is seen that is too
    short for a segment of its own; it recedes at a convex corner and comes nearer at a concave one.
    """
    last = (lines.first, lines.last)[(side + 1) // 2][segment]
    range_m = max(noise.range_m, noise.share * scan.polar[0, last])  # the beams beside an end are about as far
    noise = Noise(range_m, *noise[1:])
    jump = limits.detail_m + noise.outlier * noise.range_m
    end = end_of(scan, lines, segment, side, jump, limits, noise)
    if not end.free and end.rest < noise.edge:
        return False
    recedes = side * math.tan(scan.polar[1, end.position] - end.alpha) < 0.0
    plain = end.free and not recedes and end.rest <= noise.edge
    if recedes:  # a beam after the end that hits something in front of the wall may hide the end
        for k in range(1, end.rest + 1):
            q = (end.position + side * k) % scan.polar.shape[1]
            ahead = scan.polar[0, q] * math.cos(scan.polar[1, q] - end.alpha) - end.rho
            if ahead < -noise.outlier * noise.range_m:
                return False
    ray = counted_end(scan, end, limits, noise) if plain else weighted_end(scan, end, limits, noise)
    seen = limits.short_faces and ray.evidence > noise.face_gain
    if not (seen or plain or (end.free and recedes)):
        return False
    if math.cos(ray.bearing - end.alpha) < noise.least_cosine:
        return False
    write_end(found, segment, (end.alpha, end.rho), ray)
    floor, slot = limits.floor_share * noise.range_m, 0 if side > 0 else 1
    if spread_of(found, lines.cov) + floor**2 > limits.max_sigma_m**2:
        return False
    found.kind, found.convex = CornerKind.CROSSING if seen else CornerKind.FREE_END, not seen or recedes
    second = wrap_angle(end.alpha + (side if recedes else -side) * 0.5 * math.pi)
    found.normals[slot], found.normals[1 - slot] = wrap_angle(end.alpha + math.pi), second if seen else np.nan
    found.border[slot], found.border[1 - slot] = segment if found.convex else -1, -1
    add_floor(found, floor)
    return True


@compiled
def end_of(
    scan: RolledScan, lines: Lines, segment: int, side: int, jump: float, limits: Record, noise: Noise
) -> LineEnd:
    """The end of a segment on a side, with the beams that follow up to a jump (m).

    A beam that may have hit the extension of the segment's line, as uncertain as that is, is no jump. Where that line
    leaves the laser's range, is too slanting to return a beam, or the field of view ends, no end is in reach: the wall
    may go on unseen. Where a laser loses beams, those without return say nothing: what follows them decides, and it may
    be nearer; an end is free when only such beams follow.
    """
    alpha, rho, cov = lines.line[segment, 0], lines.line[segment, 1], lines.cov[segment]
    position = lines.last[segment] if side > 0 else lines.first[segment]
    inner = min(limits.reach_beams, lines.last[segment] - lines.first[segment] - 2)
    end_range = rho / math.cos(scan.polar[1, position] - alpha)
    previous, far, silent, loses = end_range, 0, 0, noise.grazing < math.pi
    in_range = scan.max_range - noise.outlier * max(noise.range_m, noise.share * scan.max_range)
    steepest = noise.grazing - noise.gate * math.sqrt(cov[0, 0]) - noise.edge * scan.step
    for k in range(1, limits.reach_beams + noise.edge + 1):
        q = (position + side * k) % scan.polar.shape[1]
        r, turn = scan.polar[0, q], scan.polar[1, q] - alpha
        behind, cosine = r - end_range > jump, math.cos(turn)
        blind = abs(wrap_angle(scan.polar[1, q] - scan.polar[1, (q - side) % scan.polar.shape[1]])) > 2.0 * scan.step
        if blind or not (scan.hit[q] or (rho < cosine * in_range and abs(wrap_angle(turn)) < steepest)):
            return LineEnd(alpha, rho, position, side, inner, k - 1 - far - silent, False)
        if loses and not scan.hit[q]:
            silent += 1
            continue
        if behind and cosine >= noise.least_cosine:
            expected = rho / cosine
            slant = expected * math.tan(turn)
            variance = noise.range_m**2 + (slant * noise.bearing) ** 2
            variance += slant * slant * cov[0, 0] - 2.0 * slant / cosine * cov[0, 1] + cov[1, 1] / (cosine * cosine)
            behind = not r - expected < limits.line_m + noise.outlier * math.sqrt(variance)
        if behind or not scan.hit[q]:
            far += 1
            if far == noise.edge:
                return LineEnd(alpha, rho, position, side, inner, k - noise.edge - silent, True)
            continue
        if abs(r - previous) > limits.step_share * previous + noise.outlier * noise.range_m:
            return LineEnd(alpha, rho, position, side, inner, k - 1 - far - silent, False)
        far, previous = 0, r  # a lone far beam: bearing noise mixes the beams beside an edge
    only_silent = silent == limits.reach_beams + noise.edge
    return LineEnd(alpha, rho, position, side, inner, 0 if only_silent else limits.reach_beams, only_silent)


@compiled
def write_end(found: Record, segment: int, line: tuple[float, float], ray: EndBearing) -> None:
    """Writes the point of the line (alpha, rho) at a bearing, and its derivatives."""
    tangent, cosine = math.tan(ray.bearing - line[0]), math.cos(ray.bearing - line[0])
    r = line[1] / cosine
    found.z[0], found.z[1] = r, wrap_angle(ray.bearing)
    found.lines[0], found.lines[1] = segment, -1
    found.jacobian[0, 0, 0], found.jacobian[0, 0, 1] = -r * tangent, 1.0 / cosine
    found.jacobian[0, 1, 0], found.jacobian[0, 1, 1] = 0.0, 0.0
    by_bearing = r * tangent
    found.own[0, 0], found.own[1, 1] = by_bearing * by_bearing * ray.variance, ray.variance
    found.own[0, 1] = found.own[1, 0] = by_bearing * ray.variance


@compiled
def counted_end(scan: RolledScan, end: LineEnd, limits: Record, noise: Noise) -> EndBearing:
    """Bearing of a plain end from the number of raw beams on the line around the transition.

    Bearing noise makes beams beside the edge hit or miss at random; the count stays unbiased, its variance is the
    smear plus the square of half the spacing: the end is within that of the count, but where it is repeats from scan to
    scan while the robot moves less than a beam, so that the mean square, a third of it, is too little. A beam is on the
    line unless it is nearer to what is seen behind: a closer bound would miss beams of a wall seen at a grazing angle,
    whose ranges scatter by decimetres, and put its end too near.
    """
    total, size = scan.raw_ranges.shape[0], scan.polar.shape[1]
    sweeps, gap = total // size, scan.max_range
    for k in range(end.rest + 1, end.rest + noise.edge + 1):
        q = (end.position + end.side * k) % size
        turn = scan.polar[1, q] - end.alpha
        if not scan.hit[q] or math.cos(turn) < noise.least_cosine:
            continue
        expected = end.rho / math.cos(turn)
        sigma = math.hypot(noise.range_m, expected * math.tan(turn) * noise.bearing)
        beyond = scan.polar[0, q] - expected
        if beyond > limits.line_m + noise.outlier * sigma:  # a beam of the wall may follow those that were lost
            gap = min(gap, beyond)
    spacing = (scan.raw_bearings[total - 1] - scan.raw_bearings[0]) / (total - 1)
    beam = (end.position - end.side * noise.edge + scan.roll) % size
    first = beam * sweeps if end.side > 0 else beam * sweeps + sweeps - 1
    on_line = 0
    for k in range((2 * noise.edge + 1 + end.rest) * sweeps):
        raw = (first + end.side * k) % total
        cosine = math.cos(scan.raw_bearings[raw] - end.alpha)
        if cosine < noise.least_cosine:
            continue
        slant = end.rho * math.sqrt(1.0 - min(cosine * cosine, 1.0)) / (cosine * cosine)
        allowed = min(noise.outlier * math.hypot(noise.range_m, slant * noise.bearing), 0.5 * gap)
        on_line += abs(scan.raw_ranges[raw] - end.rho / cosine) < allowed
    bearing = scan.raw_bearings[first] + end.side * (on_line - 0.5) * spacing
    return EndBearing(bearing, SMEAR * spacing * noise.bearing + spacing * spacing / 4.0, 0.0)


@compiled
def weighted_end(scan: RolledScan, end: LineEnd, limits: Record, noise: Noise) -> EndBearing:
    """Bearing of an end beside which a face at a right angle to the wall may be seen.

    Its beams are so near the wall's extension that no single one can be told apart; the mean and variance over all
    places of the corner (half a beam apart), weighted by their likelihood, can.
    """
    step, zero = scan.step, scan.polar[1, end.position]
    table = beam_table(scan, end, limits, noise)
    costs, best = place_costs(table, end, (zero - end.alpha, step), noise)
    weight, first, second = 0.0, 0.0, 0.0
    for k in range(costs.shape[0]):
        likelihood = math.exp(-0.5 * (costs[k] - costs[best]))
        offset = place_of(k, end, step)
        weight, first, second = weight + likelihood, first + likelihood * offset, second + likelihood * offset * offset
    mean = first / weight
    spacing = step * scan.polar.shape[1] / scan.raw_ranges.shape[0]
    variance = second / weight - mean * mean + SMEAR * spacing * noise.bearing + spacing * spacing / 4.0
    offset = place_of(best, end, step)
    evidence = face_evidence(table, end, (offset, zero + end.side * offset - end.alpha, step), limits, noise)
    return EndBearing(zero + end.side * mean, variance, evidence)


@compiled
def place_of(k: int, end: LineEnd, step: float) -> float:
    """Offset (rad) from the segment's last beam of the k-th place where the corner may be, half a beam apart."""
    return (0.5 * k + 0.25 - end.inner) * step


@compiled
def beam_table(scan: RolledScan, end: LineEnd, limits: Record, noise: Noise) -> Array:
    """(7,n): for each beam beside the end, by what its place on the wall or on the face is judged.

    Rows: offset from the end's last beam (rad), cost on the line, sine, cotangent, range, count, and the cost of
    passing the face: little, since it ends; but what hits the wall cannot have passed a face that comes nearer.
    """
    size, most = scan.polar.shape[1], noise.gate * noise.gate
    table = np.empty((7, end.inner + end.rest + (noise.edge if end.free else 0) + 1))
    recedes = end.side * math.tan(scan.polar[1, end.position] - end.alpha) < 0.0
    for m in range(table.shape[1]):
        q = (end.position + end.side * (m - end.inner)) % size
        turn, r = scan.polar[1, q] - end.alpha, scan.polar[0, q]
        cosine, sine = math.cos(turn), math.sin(turn)
        cost = most
        if cosine > noise.least_cosine and scan.hit[q]:
            expected = end.rho / cosine
            variance = noise.range_m**2 + (expected * sine / cosine * noise.bearing) ** 2
            cost = min(cost, (r - expected) ** 2 / variance * scan.polar[2, q])
        table[0, m] = wrap_angle(scan.polar[1, q] - scan.polar[1, end.position]) * end.side
        table[1, m], table[2, m] = cost, sine
        table[3, m] = cosine / sine if abs(sine) > 1e-6 else 0.0
        table[4, m], table[5, m] = r if scan.hit[q] else math.inf, scan.polar[2, q]
        table[6, m] = limits.passing_cost if recedes or cost >= most else most
    return table


@compiled
def place_costs(table: Array, end: LineEnd, turn_and_step: tuple[float, float], noise: Noise) -> tuple[Array, int]:
    """Chi-square of all beams for each place of the corner, and the best place.

    Beams before the place belong to the wall, the others to the face. Beam by beam, so that the compiler can take
    several places at once.
    """
    size, beams = 2 * (end.inner + end.rest) + 1, table.shape[1]
    costs, along, wall = np.empty(size), np.empty(size), np.empty(size, np.int64)
    start, before = 0, 0.0
    for k in range(size):
        offset = place_of(k, end, turn_and_step[1])
        along[k] = end.rho * math.tan(turn_and_step[0] + end.side * offset)
        while start < beams and table[0, start] < offset:
            before, start = before + table[1, start], start + 1
        costs[k], wall[k] = before, start
    places = 0
    for m in range(beams):
        while places < size and wall[places] <= m:
            places += 1
        beam = (table[2, m], table[3, m], table[4, m], table[5, m], table[6, m])
        for k in range(places):
            costs[k] += face_cost(along[k], beam, noise)
    best = 0
    for k in range(1, size):
        if costs[k] < costs[best]:
            best = k
    return costs, best


@compiled
def face_cost(along: float, beam: tuple[float, float, float, float, float], noise: Noise) -> float:
    """Chi-square of a beam (rows 2 to 6 of beam_table) on the face at a right angle, `along` metres along the wall."""
    (sine, cotangent, measured, count, passing), most = beam, noise.gate * noise.gate
    if measured == math.inf:
        return passing
    expected = along / sine
    residual = measured - expected
    variance = noise.range_m**2 + (expected * cotangent * noise.bearing) ** 2
    cost = min(residual * residual * count / variance, passing if residual > 0.0 else most)
    return most if along * sine <= 1e-9 else cost


@compiled
def face_evidence(table: Array, end: LineEnd, place: tuple[float, float, float], limits: Record, noise: Noise) -> float:
    """How much chi-square a second face saves, over the wall going on; 0 when its beams do not fit it.

    `place` is the corner's offset from the segment's last beam and from the wall's normal, and the step between beams
    (rad). Where along the wall the face is: the mean of the beams from the corner on that the wall does not explain,
    within a beam's width (then less) and noise of it. Those on the face, and all after the segment's end, must fit.
    """
    offset, turn, step = place
    along = guess = end.rho * math.tan(turn)
    width = step * end.rho / math.cos(turn) ** 2  # between two beams along the wall, m
    for _ in range(3):
        weight, total = 0.0, 0.0
        for m in range(table.shape[1]):
            if table[0, m] < offset - step or table[4, m] == math.inf or table[1, m] < noise.gate * noise.gate:
                continue
            beside, cosine = table[4, m] * table[2, m], table[3, m] * table[2, m]
            variance = (noise.range_m * table[2, m]) ** 2 + (table[4, m] * cosine * noise.bearing) ** 2
            variance /= table[5, m]
            if abs(beside - along) < width + noise.outlier * math.sqrt(variance):
                weight, total = weight + 1.0 / variance, total + beside / variance
        if weight == 0.0:
            along = guess
            break
        along, width = total / weight, 0.25 * width
    saved, misfit, beams = 0.0, 0.0, 0
    for m in range(end.inner + end.rest + 1):
        cost = table[1, m]
        if table[0, m] >= offset:
            cost = face_cost(along, (table[2, m], table[3, m], table[4, m], table[5, m], table[6, m]), noise)
            if cost == limits.passing_cost:  # it passes the face and is no evidence of it
                continue
            saved += table[1, m] - cost
        if table[0, m] >= offset or m > end.inner:
            misfit, beams = misfit + cost, beams + 1
    return saved if misfit <= limits.misfit * beams else 0.0
