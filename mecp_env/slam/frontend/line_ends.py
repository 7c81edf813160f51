"""Compiled functions for a corner where a line ends and what follows does not occlude it (III-A.1)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.beams import Noise, Record
from mecp_env.slam.frontend.line_intersections import Lines, RolledScan, add_floor, spread_of
from mecp_env.slam.messages import CornerKind

SMEAR = 1.0 / math.sqrt(math.pi)  # integral of Phi (1 - Phi): a transition blurred by the bearing noise


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
    noise = Noise(
        *(range_m, noise.share, noise.bearing, noise.gate, noise.outlier, noise.least_cosine, noise.edge),
        *(noise.face_gain, noise.grazing),
    )
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
    ray = counted_end(scan, end, jump, limits, noise) if plain else weighted_end(scan, end, limits, noise)
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
def counted_end(scan: RolledScan, end: LineEnd, jump: float, limits: Record, noise: Noise) -> EndBearing:
    """Bearing of a plain end from the number of raw beams on the line around the transition.

    Bearing noise makes beams beside the edge hit or miss at random; the count stays unbiased, its variance is the
    smear plus the square of half the spacing: the end is within that of the count, but where it is repeats from scan to
    scan while the robot moves less than a beam, so that the mean square, a third of it, is too little.
    """
    total, size = scan.raw_ranges.shape[0], scan.polar.shape[1]
    sweeps = total // size
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
        allowed = min(noise.outlier * math.hypot(noise.range_m, slant * noise.bearing), 0.5 * jump)
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
