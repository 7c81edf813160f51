"""Kernels for a corner where a line ends and what follows does not occlude it (III-A.1)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.frontend.line_fit import STEEPEST
from mecp_env.slam.frontend.line_intersections import Found, Rules, Sight, Walls, add_floor, spread_of
from mecp_env.slam.frontend.noise import Noise
from mecp_env.slam.messages import CornerKind

Array = NDArray[np.float64]
CROSSING, FREE_END = int(CornerKind.CROSSING), int(CornerKind.FREE_END)
REACH = 14  # beams on either side of an end that are looked at
COUNT_BEAMS, FAR_BEAMS = 3, 2  # beams before and after a transition that make sure of it
PLAIN_REST = 2  # beams after an end that belong to neither side, where no face can be seen
COLLINEAR_M, SIGMAS, STEP_SHARE = 0.1, 4.0, 0.1
COST_CAP, COST_FAR = 9.0, 2.0  # chi-square of a beam that fits neither face, of one that passes the end
FACE_BEAMS = 2  # beams of a second face, at least, without a jump behind it
MISFIT = 3.5  # mean chi-square of its beams at most
SMEAR = 0.5642  # integral of Phi (1 - Phi): a transition blurred by the bearing noise
FAR, OTHER = 1, 2  # what follows the beams beside an end


class End(NamedTuple):
    """One end of a segment, and the beams that follow it."""

    alpha: float
    rho: float
    position: int  # of the segment's last beam on this side
    side: int  # +1: ccw end, -1: beginning
    inner: int  # beams of the segment to look at
    rest: int  # beams after it before something else begins
    follows: int  # FAR: the scan jumps back there; OTHER: something nearer, or no end in reach


class Ray(NamedTuple):
    """Where an end lies, and how much speaks for a second face there."""

    bearing: float
    variance: float
    evidence: float


@compiled
def add_end(
    found: Found, n: int, sight: Sight, walls: Walls, end: tuple[int, int], rules_and_noise: tuple[Rules, Noise]
) -> int:
    """n + 1 when segment end[0] ends in a corner on side end[1] (+1: ccw end, -1: its beginning), in row n; else n.

    Either something farther follows (the free end of III-A.1), or a second face at a right angle is seen that is too
    short for a segment of its own; it recedes at a convex corner and comes nearer at a concave one.
    """
    rules, noise = rules_and_noise
    segment, side = end
    what = end_of(sight, walls, end, rules_and_noise)
    if what.follows != FAR and what.rest < FACE_BEAMS:
        return n
    tangent = side * math.tan(sight.polar[1, what.position] - what.alpha)
    if tangent >= 0.0 and what.follows == FAR and what.rest <= PLAIN_REST:
        ray = counted_ray(sight, what, rules_and_noise)
    elif tangent >= 0.0 or not comes_nearer(sight, what, noise):
        ray = kink_ray(sight, what, noise)
    else:
        return n
    seen = ray.evidence > rules.evidence
    if not seen and (what.follows != FAR or (tangent >= 0.0 and what.rest > PLAIN_REST)):
        return n
    if math.cos(ray.bearing - what.alpha) < STEEPEST:
        return n
    write_end(found, n, segment, (what.alpha, what.rho), (ray.bearing, ray.variance))
    if spread_of(found, n, walls) + rules.floor**2 > rules.max_variance:
        return n
    slot = 0 if side > 0 else 1
    found.kind[n], found.convex[n] = CROSSING if seen else FREE_END, not seen or tangent < 0.0
    found.normals[n, slot] = wrap_angle(what.alpha + math.pi)
    second = wrap_angle(what.alpha - math.copysign(0.5 * math.pi, side * tangent))
    found.normals[n, 1 - slot] = second if seen else np.nan
    found.border[n, slot], found.border[n, 1 - slot] = segment if found.convex[n] else -1, -1
    add_floor(found, n, rules.floor)
    return n + 1


@compiled
def end_of(sight: Sight, walls: Walls, end: tuple[int, int], rules_and_noise: tuple[Rules, Noise]) -> End:
    """The end of segment end[0] on side end[1], with the beams that follow up to a jump."""
    rules, noise = rules_and_noise
    segment, side = end
    alpha, rho = walls.line[segment, 0], walls.line[segment, 1]
    position = walls.last[segment] if side > 0 else walls.first[segment]
    inner = min(REACH, walls.last[segment] - walls.first[segment] - 2)
    end_range = rho / math.cos(sight.polar[1, position] - alpha)
    previous, far = end_range, 0
    for k in range(1, REACH + FAR_BEAMS + 1):
        q = (position + side * k) % sight.polar.shape[1]
        r = sight.polar[0, q]
        behind = r - end_range > rules.jump and not collinear(walls, segment, r, sight.polar[1, q], noise)
        if behind or not sight.hit[q]:
            far += 1
            if far == FAR_BEAMS:
                return End(alpha, rho, position, side, inner, k - FAR_BEAMS, FAR)
            continue
        if abs(r - previous) > STEP_SHARE * previous + SIGMAS * noise.range_m:
            return End(alpha, rho, position, side, inner, k - 1 - far, OTHER)
        far, previous = 0, r  # a lone far beam: bearing noise mixes the beams beside an edge
    return End(alpha, rho, position, side, inner, REACH, OTHER)


@compiled
def comes_nearer(sight: Sight, end: End, noise: Noise) -> bool:
    """True when a beam after the end hits something in front of the wall: it may hide the end."""
    for k in range(1, end.rest + 1):
        q = (end.position + end.side * k) % sight.polar.shape[1]
        if sight.polar[0, q] * math.cos(sight.polar[1, q] - end.alpha) - end.rho < -SIGMAS * noise.range_m:
            return True
    return False


@compiled
def write_end(found: Found, n: int, segment: int, line: tuple[float, float], ray: tuple[float, float]) -> None:
    """Writes the point of the line at bearing ray[0] (variance ray[1]) and its derivatives."""
    tangent, cosine = math.tan(ray[0] - line[0]), math.cos(ray[0] - line[0])
    r = line[1] / cosine
    found.z[n, 0], found.z[n, 1] = r, wrap_angle(ray[0])
    found.lines[n, 0], found.lines[n, 1] = segment, -1
    found.jacobian[n, 0, 0, 0], found.jacobian[n, 0, 0, 1] = -r * tangent, 1.0 / cosine
    found.jacobian[n, 0, 1, 0], found.jacobian[n, 0, 1, 1] = 0.0, 0.0
    by_bearing = r * tangent
    found.own[n, 0, 0], found.own[n, 1, 1] = by_bearing * by_bearing * ray[1], ray[1]
    found.own[n, 0, 1] = found.own[n, 1, 0] = by_bearing * ray[1]


@compiled
def collinear(walls: Walls, segment: int, r: float, bearing: float, noise: Noise) -> bool:
    """True when a beam of range r may have hit the extension of the segment's line, as uncertain as that is."""
    alpha, rho = walls.line[segment, 0], walls.line[segment, 1]
    cosine = math.cos(bearing - alpha)
    if cosine < STEEPEST:
        return False
    expected = rho / cosine
    slant = expected * math.tan(bearing - alpha)
    cov = walls.cov[segment]
    variance = noise.range_m**2 + (slant * noise.bearing) ** 2
    variance += slant * slant * cov[0, 0] - 2.0 * slant / cosine * cov[0, 1] + cov[1, 1] / (cosine * cosine)
    return bool(r - expected < COLLINEAR_M + SIGMAS * math.sqrt(variance))


@compiled
def counted_ray(sight: Sight, end: End, rules_and_noise: tuple[Rules, Noise]) -> Ray:
    """Bearing of a plain end from the number of raw beams on the line around the transition.

    Bearing noise makes beams beside the edge hit or miss at random; the count stays unbiased, its variance is the
    smear plus spacing^2 / 12.
    """
    rules, noise = rules_and_noise
    total, size = sight.raw_ranges.shape[0], sight.polar.shape[1]
    sweeps = total // size
    spacing = (sight.raw_bearings[total - 1] - sight.raw_bearings[0]) / (total - 1)
    beam = (end.position - end.side * COUNT_BEAMS + sight.roll) % size
    first = beam * sweeps if end.side > 0 else beam * sweeps + sweeps - 1
    on_line = 0
    for k in range((COUNT_BEAMS + 1 + end.rest + FAR_BEAMS) * sweeps):
        raw = (first + end.side * k) % total
        cosine = math.cos(sight.raw_bearings[raw] - end.alpha)
        if cosine < STEEPEST:
            continue
        slant = end.rho * math.sqrt(1.0 - min(cosine * cosine, 1.0)) / (cosine * cosine)
        allowed = min(SIGMAS * math.hypot(noise.range_m, slant * noise.bearing), 0.5 * rules.jump)
        on_line += abs(sight.raw_ranges[raw] - end.rho / cosine) < allowed
    bearing = sight.raw_bearings[first] + end.side * (on_line - 0.5) * spacing
    return Ray(bearing, SMEAR * spacing * noise.bearing + spacing * spacing / 12.0, 0.0)


@compiled
def kink_ray(sight: Sight, end: End, noise: Noise) -> Ray:
    """Bearing of an end beside which a face at a right angle to the wall may be seen.

    Its beams lie so near the wall's extension that no single one can be told apart; the mean and variance over all
    places of the corner (half a beam apart), weighted by their likelihood, can.
    """
    step, zero = 2.0 * math.pi / sight.polar.shape[1], sight.polar[1, end.position]
    table = beam_table(sight, end, end.rest + (FAR_BEAMS if end.follows == FAR else 0), noise)
    costs, best = place_costs(table, end, (zero - end.alpha, step), noise)
    weight, first, second = 0.0, 0.0, 0.0
    for k in range(costs.shape[0]):
        likelihood = math.exp(-0.5 * (costs[k] - costs[best]))
        offset = place_of(k, end, step)
        weight, first, second = weight + likelihood, first + likelihood * offset, second + likelihood * offset * offset
    mean = first / weight
    spacing = step * sight.polar.shape[1] / sight.raw_ranges.shape[0]
    variance = second / weight - mean * mean + SMEAR * spacing * noise.bearing + spacing * spacing / 12.0
    offset = place_of(best, end, step)
    turn = zero + end.side * offset - end.alpha
    width = step * end.rho / math.cos(turn) ** 2  # between two beams along the wall, m
    along = face_place(table, offset - step, (end.rho * math.tan(turn), width), noise)
    evidence = face_evidence(table, (end.inner, end.inner + end.rest + 1), (offset, along), noise)
    return Ray(zero + end.side * mean, variance, evidence)


@compiled
def place_of(k: int, end: End, step: float) -> float:
    """Offset (rad) from the segment's last beam of the k-th place where the corner may be, half a beam apart."""
    return (0.5 * k + 0.25 - end.inner) * step


@compiled
def place_costs(table: Array, end: End, turn_and_step: tuple[float, float], noise: Noise) -> tuple[Array, int]:
    """Chi-square of all beams for each place of the corner, and the best place.

    MergedScan before the place belong to the wall, the others to the face. Beam by beam, so that the compiler can take
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
def face_place(table: Array, offset: float, guess: tuple[float, float], noise: Noise) -> float:
    """Where along the wall (m) the second face stands: the mean of its beams, or guess[0] when there is none.

    They are the beams after `offset`, none of the wall's, within guess[1] metres (then less) and noise of it.
    """
    along, width = guess
    for _ in range(3):
        weight, total = 0.0, 0.0
        for m in range(table.shape[1]):
            if table[0, m] < offset or table[4, m] == math.inf or table[1, m] < COST_CAP:
                continue
            place, cosine = table[4, m] * table[2, m], table[3, m] * table[2, m]
            variance = (noise.range_m * table[2, m]) ** 2 + (table[4, m] * cosine * noise.bearing) ** 2
            variance /= table[5, m]
            if abs(place - along) < width + SIGMAS * math.sqrt(variance):
                weight, total = weight + 1.0 / variance, total + place / variance
        if weight == 0.0:
            return guess[0]
        along, width = total / weight, 0.25 * width
    return along


@compiled
def beam_table(sight: Sight, end: End, after: int, noise: Noise) -> Array:
    """(7,n): for each beam beside the end, by what its place on the wall or on the face is judged.

    Rows: offset from the end's last beam (rad), cost on the line, sine, cotangent, range, count, and the cost of
    passing the face: little, since it ends; but what hits the wall cannot have passed a face that comes nearer.
    """
    size = sight.polar.shape[1]
    table = np.empty((7, end.inner + after + 1))
    recedes = end.side * math.tan(sight.polar[1, end.position] - end.alpha) < 0.0
    for m in range(table.shape[1]):
        q = (end.position + end.side * (m - end.inner)) % size
        turn, r = sight.polar[1, q] - end.alpha, sight.polar[0, q]
        cosine, sine = math.cos(turn), math.sin(turn)
        cost = COST_CAP
        if cosine > STEEPEST and sight.hit[q]:
            expected = end.rho / cosine
            variance = noise.range_m**2 + (expected * sine / cosine * noise.bearing) ** 2
            cost = min(cost, (r - expected) ** 2 / variance * sight.polar[2, q])
        table[0, m] = wrap_angle(sight.polar[1, q] - sight.polar[1, end.position]) * end.side
        table[1, m], table[2, m] = cost, sine
        table[3, m] = cosine / sine if abs(sine) > 1e-6 else 0.0
        table[4, m], table[5, m] = r if sight.hit[q] else math.inf, sight.polar[2, q]
        table[6, m] = COST_FAR if recedes or cost >= COST_CAP else COST_CAP
    return table


@compiled
def face_cost(along: float, beam: tuple[float, float, float, float, float], noise: Noise) -> float:
    """Chi-square of a beam (rows 2 to 6 of beam_table) on the face at a right angle, `along` metres along the wall."""
    sine, cotangent, measured, count, passing = beam
    if measured == math.inf:
        return passing
    expected = along / sine
    residual = measured - expected
    variance = noise.range_m**2 + (expected * cotangent * noise.bearing) ** 2
    cost = min(residual * residual * count / variance, passing if residual > 0.0 else COST_CAP)
    return COST_CAP if along * sine <= 1e-9 else cost


@compiled
def face_evidence(table: Array, rows: tuple[int, int], corner: tuple[float, float], noise: Noise) -> float:
    """How much chi-square a second face from the offset corner[0] on saves, over the wall going on; 0: no good fit.

    `rows`: the beam of the segment's end, and how many there are. Those on the face and all after the end must fit.
    """
    offset, along = corner
    saved, misfit, beams = 0.0, 0.0, 0
    for m in range(rows[1]):
        cost = table[1, m]
        if table[0, m] >= offset:
            cost = face_cost(along, (table[2, m], table[3, m], table[4, m], table[5, m], table[6, m]), noise)
            if cost == COST_FAR:  # it passes the face and says nothing about it
                continue
            saved += table[1, m] - cost
        if table[0, m] >= offset or m > rows[0]:
            misfit, beams = misfit + cost, beams + 1
    return saved if misfit <= MISFIT * beams else 0.0
