"""Kernels for a corner where a line ends and what follows does not occlude it (III-A.1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.crossings import Found, Rules, Sight, Walls, add_floor, spread_of
from mecp_env.slam.data import CornerKind
from mecp_env.slam.geometry import wrap_angle
from mecp_env.slam.lines import STEEPEST
from mecp_env.slam.noise import Noise

Array = NDArray[np.float64]
FREE_END = int(CornerKind.FREE_END)
REACH = 14  # beams beside an end that are looked at
COUNT_BEAMS = 3  # beams on either side of the transition in which raw beams are counted
PLAIN_REST = 2  # beams after an end that belong to neither side, where no face can be seen
COLLINEAR_M, SIGMAS = 0.1, 4.0
COST_CAP, COST_FAR = 9.0, 2.0  # chi-square of a beam that fits neither face, of one that passes the end
SMEAR = 0.5642  # integral of Phi (1 - Phi): a transition blurred by the bearing noise


@kernel
def add_free_end(
    found: Found, n: int, sight: Sight, walls: Walls, end: tuple[int, int], rules_and_noise: tuple[Rules, Noise]
) -> int:
    """n + 1 when segment end[0] ends freely on side end[1] (+1: ccw end, -1: its beginning), written to row n."""
    rules, noise = rules_and_noise
    segment, side = end
    position = walls.last[segment] if side > 0 else walls.first[segment]
    line = (walls.line[segment, 0], walls.line[segment, 1])
    rest = beams_to_jump(sight, line, position, side, rules_and_noise)
    if rest < 0:
        return n
    face_visible = side * math.tan(sight.polar[position, 1] - line[0]) < 0.0  # seen at a right angle to the wall
    if face_visible:
        inner = min(REACH, walls.last[segment] - walls.first[segment] - 2)
        bearing, variance = kink_bearing(sight, line, (position, side, inner, rest), noise)
    elif rest <= PLAIN_REST:
        bearing, variance = counted_bearing(sight, line, (position, side, rest), rules_and_noise)
    else:
        return n
    cosine = math.cos(bearing - line[0])
    if cosine < STEEPEST:
        return n
    write_end(found, n, segment, line, (bearing, variance))
    if spread_of(found, n, walls) + rules.floor**2 > rules.max_variance:
        return n
    found.kind[n], found.convex[n] = FREE_END, True
    slot = 0 if side > 0 else 1
    found.normals[n, slot], found.normals[n, 1 - slot] = wrap_angle(line[0] + math.pi), np.nan
    found.border[n, slot], found.border[n, 1 - slot] = segment, -1
    add_floor(found, n, rules.floor)
    return n + 1


@kernel
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


@kernel
def beams_to_jump(
    sight: Sight, line: tuple[float, float], position: int, side: int, rules_and_noise: tuple[Rules, Noise]
) -> int:
    """How many beams follow the end before the scan jumps back; -1 when it does not, or something nearer follows."""
    rules, noise = rules_and_noise
    size = sight.polar.shape[0]
    end_range = line[1] / math.cos(sight.polar[position, 1] - line[0])
    far = 0
    for k in range(1, REACH + 2):
        q = (position + side * k) % size
        cosine, r = math.cos(sight.polar[q, 1] - line[0]), sight.polar[q, 0]
        if not sight.hit[q]:
            far += 1
        elif r * cosine - line[1] < -SIGMAS * noise.range_m:
            return -1
        elif r - end_range > rules.jump and not collinear(line, r, cosine, noise):
            far += 1
        elif far > 0:
            return -1
        if far == 2:
            return k - 2
    return -1


@kernel
def collinear(line: tuple[float, float], r: float, cosine: float, noise: Noise) -> bool:
    """True when a beam of range r at cosine of incidence may have hit the line's extension."""
    if cosine < STEEPEST:
        return False
    expected = line[1] / cosine
    slant = expected * math.sqrt(1.0 - min(cosine * cosine, 1.0)) / cosine
    return r - expected < COLLINEAR_M + SIGMAS * math.hypot(noise.range_m, slant * noise.bearing)


@kernel
def counted_bearing(
    sight: Sight,
    line: tuple[float, float],
    end: tuple[int, int, int],
    rules_and_noise: tuple[Rules, Noise],
) -> tuple[float, float]:
    """Bearing of the end and its variance from the number of raw beams on the line around the transition.

    Bearing noise makes beams beside the edge hit or miss at random; the count stays unbiased, its variance is the
    smear plus spacing^2 / 12.
    """
    position, side, rest = end
    total, size = sight.raw_ranges.shape[0], sight.polar.shape[0]
    sweeps = total // size
    spacing = (sight.raw_bearings[total - 1] - sight.raw_bearings[0]) / (total - 1)
    beam = (position - side * COUNT_BEAMS + sight.roll) % size
    first = beam * sweeps if side > 0 else beam * sweeps + sweeps - 1
    on_line = 0
    limit = 0.5 * rules_and_noise[0].jump
    for k in range((2 * COUNT_BEAMS + 1 + rest) * sweeps):
        raw = (first + side * k) % total
        cosine = math.cos(sight.raw_bearings[raw] - line[0])
        if cosine < STEEPEST:
            continue
        slant = line[1] * math.sqrt(1.0 - min(cosine * cosine, 1.0)) / (cosine * cosine)
        allowed = min(SIGMAS * math.hypot(rules_and_noise[1].range_m, slant * rules_and_noise[1].bearing), limit)
        on_line += sight.raw_ranges[raw] - line[1] / cosine < allowed
    bearing = sight.raw_bearings[first] + side * (on_line - 0.5) * spacing
    return bearing, SMEAR * spacing * rules_and_noise[1].bearing + spacing * spacing / 12.0


@kernel
def kink_bearing(
    sight: Sight, line: tuple[float, float], end: tuple[int, int, int, int], noise: Noise
) -> tuple[float, float]:
    """Bearing of the end and its variance where the face beyond, at a right angle to the wall, may be seen.

    Its beams lie so near the wall's extension that no single one can be told apart; the mean and variance over all
    places of the corner (half a beam apart), weighted by their likelihood, can.
    """
    position, side, inner, rest = end
    size = sight.polar.shape[0]
    step = 2.0 * math.pi / size
    origin = sight.polar[position, 1]
    weight, first, second, best = 0.0, 0.0, 0.0, math.inf
    costs = np.empty(2 * (inner + rest + 2))
    for k in range(costs.shape[0]):
        offset = (0.5 * k + 0.25 - inner) * step
        costs[k] = 0.0
        for m in range(-inner, rest + 3):
            q = (position + side * m) % size
            turn = wrap_angle(sight.polar[q, 1] - origin) * side
            behind = turn > offset
            costs[k] += beam_cost(sight, line, q, (behind, origin + side * offset), noise)
        best = min(best, costs[k])
    for k in range(costs.shape[0]):
        offset = (0.5 * k + 0.25 - inner) * step
        likelihood = math.exp(-0.5 * (costs[k] - best))
        weight, first, second = weight + likelihood, first + likelihood * offset, second + likelihood * offset * offset
    mean = first / weight
    spacing = step * sight.polar.shape[0] / sight.raw_ranges.shape[0]
    variance = second / weight - mean * mean + SMEAR * spacing * noise.bearing + spacing * spacing / 12.0
    return origin + side * mean, variance


@kernel
def beam_cost(
    sight: Sight, line: tuple[float, float], q: int, corner: tuple[bool, float], noise: Noise
) -> float:
    """Chi-square of averaged beam q: on the wall, or (corner[0]) behind the corner at bearing corner[1]."""
    cosine, sine = math.cos(sight.polar[q, 1] - line[0]), math.sin(sight.polar[q, 1] - line[0])
    r = sight.polar[q, 0]
    if not corner[0]:
        if cosine < STEEPEST or not sight.hit[q]:
            return COST_CAP
        expected, slope = line[1] / cosine, sine / cosine
    else:
        if not sight.hit[q]:
            return COST_FAR
        along = line[1] * math.tan(corner[1] - line[0])
        if along * sine <= 1e-9:
            return COST_FAR if r * cosine > line[1] + SIGMAS * noise.range_m else COST_CAP
        expected, slope = along / sine, cosine / sine
    residual = r - expected
    variance = (noise.range_m**2 + (expected * slope * noise.bearing) ** 2) / sight.polar[q, 2]
    cost = residual * residual / variance
    if corner[0] and residual > 0.0:
        return min(cost, COST_FAR)
    return min(cost, COST_CAP)
