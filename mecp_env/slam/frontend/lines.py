"""Compiled functions that cut a cluster into lines: Ramer-Douglas-Peucker (III-A.1), then chi-square on the breaks.

`breaks` holds the position before the first line of a cluster and the last position of each line, in order. Prefix
sums of moments and of the points' own covariance give the chi-square of any run of positions in constant time. What is
known of each beam is in rows of an array, so that the compiler can take several beams at once. A line (alpha, rho) is
the maximum-likelihood line through averaged beams, with its covariance.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Ints, Record
from mecp_env.core.jit import compiled
from mecp_env.slam.frontend.beams import Noise

ITERATIONS = 2


@compiled
def rough_line(sums: Array, first: int, last: int) -> tuple[float, float]:
    """alpha and rho (>= 0) of the total-least-squares line through positions first to last."""
    n = last - first + 1
    sxx, sxy, syy = scatter(sums, first, last)
    alpha = 0.5 * math.atan2(2.0 * sxy, sxx - syy) + 0.5 * math.pi
    x, y = (sums[last + 1, 0] - sums[first, 0]) / n, (sums[last + 1, 1] - sums[first, 1]) / n
    rho = x * math.cos(alpha) + y * math.sin(alpha)
    return (alpha, rho) if rho >= 0.0 else (alpha + math.pi, -rho)


@compiled
def without_end_face(
    points: Array, sums: Array, first: int, last: int, limits: Record, noise: Noise
) -> tuple[int, int]:
    """First and last position of the wall itself, where beams of its end face, at a right angle, are taken for it.

    Seen along the wall, the face at its near end is within the noise; its few beams turn the line.
    """
    alpha, _ = rough_line(sums, first, last)  # coordinates along the wall, from the foot of the perpendicular on:
    begins = -(points[1, first] * math.cos(alpha) - points[0, first] * math.sin(alpha))
    ends = points[1, last] * math.cos(alpha) - points[0, last] * math.sin(alpha)
    if begins >= 0.0 and ends >= 0.0:
        return first, last  # the robot is in front of the wall: its end faces are turned away
    best, best_cost = (first, last), line_cost(sums, first, last) - noise.face_gain
    most = min(limits.shift_beams, last - first + 1 - limits.min_beams)
    kept = (first + most, last) if begins < 0.0 else (first, last - most)
    if line_cost(sums, kept[0], kept[1]) >= best_cost:
        return first, last
    for dropped in range(1, most + 1):
        low, high = (first + dropped, last) if begins < 0.0 else (first, last - dropped)
        face = (first, low - 1) if begins < 0.0 else (high + 1, last)
        cost = line_cost(sums, low, high)
        if cost < best_cost:
            cost += face_spread(points, face, rough_line(sums, low, high)[0])
        if cost < best_cost:
            best, best_cost = (low, high), cost
    return best


@compiled
def face_spread(points: Array, span: tuple[int, int], alpha: float) -> float:
    """Chi-square of the points about one face at a right angle to a wall with normal alpha."""
    ca, sa = math.cos(alpha), math.sin(alpha)
    weight, first, second = 0.0, 0.0, 0.0
    for i in range(span[0], span[1] + 1):
        along = points[1, i] * ca - points[0, i] * sa
        steep = along * along / (points[0, i] ** 2 + points[1, i] ** 2)
        w = 1.0 / (points[2, i] * steep + points[3, i] * (1.0 - steep))
        weight, first, second = weight + w, first + w * along, second + w * along * along
    return max(second - first * first / weight, 0.0)


@compiled
def fit_line(
    ranges: Array, points: Array, sums: Array, span: tuple[int, int], noise: Noise, terms: Array
) -> tuple[float, float, float, float, float, float]:
    """alpha, rho, their variances and covariance (aa, ar, rr) and the chi-square: Gauss-Newton from the rough line.

    The residual r cos(theta - alpha) - rho has the variance sigma_r^2 cos^2 + (r sin sigma_theta)^2. The coordinate
    along the wall is taken from the line, not from the noisy range: with the measured one short oblique faces
    come out centimetres too long. The same holds for a sigma_r that is a share of the range: by the measured one, beams
    that are too short count for more, and all walls come nearer by twice the square of the share. aa is inf when the
    beams do not carry a line. `terms` (3,B) is work space for the coordinate along the line, residual and weight of
    each beam; the weight is -1 where the ray does not meet the line.
    """
    first, last = span
    (alpha, rho), (haa, har, hrr, cost) = rough_line(sums, first, last), (1.0, 0.0, 1.0, 0.0)
    r, x, y = ranges[first : last + 1], points[0, first : last + 1], points[1, first : last + 1]
    along_ray, across_ray = points[2, first : last + 1], points[3, first : last + 1]
    along, residual, weight, outlier2 = terms[0], terms[1], terms[2], noise.outlier * noise.outlier
    share, least = noise.share, noise.range_m
    for _ in range(ITERATIONS):
        ca, sa = math.cos(alpha), math.sin(alpha)
        for i in range(r.shape[0]):  # each beam by itself: several at once
            ahead, r2 = x[i] * ca + y[i] * sa, r[i] * r[i]
            t = rho * (y[i] * ca - x[i] * sa) / ahead  # rho tan(theta - alpha)
            e = ahead - rho
            expected = max(share * rho * r[i], least * ahead) / max(share * r[i], least)  # of sigma_r, times ahead
            variance_r2 = along_ray[i] * expected * expected + across_ray[i] * t * t
            w = r2 / max(variance_r2, r2 * e * e / outlier2)
            along[i], residual[i], weight[i] = t, e, -1.0 if ahead < noise.least_cosine * r[i] else w
        haa, har, hrr, ga, gr, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(r.shape[0]):
            t, e, w = along[i], residual[i], weight[i]
            if w < 0.0:
                continue
            haa, har, hrr = haa + w * t * t, har - w * t, hrr + w
            cost += w * e * e
            ga, gr = ga + w * t * e, gr - w * e
        determinant = haa * hrr - har * har
        if not determinant > 1e-9 * haa * hrr:
            return alpha, rho, math.inf, 0.0, math.inf, cost
        alpha -= (hrr * ga - har * gr) / determinant
        rho -= (haa * gr - har * ga) / determinant
    determinant = haa * hrr - har * har
    return alpha, rho, hrr / determinant, -har / determinant, haa / determinant, cost


FEWEST = 3  # positions of a line: two have no residual
ROUNDING = 1 << 32  # units in the last place, 1e-6: far more than rounding errors make


@compiled
def beam_points(polar: Array, noise: Noise) -> tuple[Array, Array]:
    """Points (5,B): x, y, variances along and across the ray, and a row to work in; prefix sums (B+1,8).

    The sums are those of x, y, xx, xy, yy and of the points' covariance: xx, xy, yy.
    """
    size = polar.shape[1]
    points, sums = np.empty((5, size)), np.empty((size + 1, 8))
    ranges, bearings, count = polar[0], polar[1], polar[2]
    cosine, sine, along_ray, across_ray = points[0], points[1], points[2], points[3]
    for i in range(1, size):  # of the turn from the beam before, where it is small: without trigonometry
        turn = bearings[i] - bearings[i - 1]
        q = turn * turn
        cosine[i] = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0))
        sine[i] = turn * (1.0 - q / 6.0 * (1.0 - q / 20.0))
    for i in range(size):
        along_ray[i] = max(noise.range_m, noise.share * ranges[i]) ** 2 / count[i]
        across_ray[i] = (ranges[i] * noise.bearing) ** 2 / count[i]
    for k in range(8):
        sums[0, k] = 0.0
    c, s = 1.0, 0.0
    for i in range(size):
        r, along, across = polar[0, i], points[2, i], points[3, i]
        if i > 0 and abs(polar[1, i] - polar[1, i - 1]) < 0.02:  # rad: the series below is exact to the last digit
            c, s = c * points[0, i] - s * points[1, i], s * points[0, i] + c * points[1, i]
        else:
            c, s = math.cos(polar[1, i]), math.sin(polar[1, i])
        x, y = r * c, r * s
        points[0, i], points[1, i] = x, y
        sums[i + 1, 0], sums[i + 1, 1] = sums[i, 0] + x, sums[i, 1] + y
        sums[i + 1, 2], sums[i + 1, 3], sums[i + 1, 4] = sums[i, 2] + x * x, sums[i, 3] + x * y, sums[i, 4] + y * y
        sums[i + 1, 5] = sums[i, 5] + along * c * c + across * s * s
        sums[i + 1, 6] = sums[i, 6] + (along - across) * c * s
        sums[i + 1, 7] = sums[i, 7] + along * s * s + across * c * c
    return points, sums


@compiled
def scatter(sums: Array, first: int, last: int) -> tuple[float, float, float]:
    """Central second moments sxx, sxy, syy (sums, not means) of positions first to last."""
    n = last - first + 1
    x, y = sums[last + 1, 0] - sums[first, 0], sums[last + 1, 1] - sums[first, 1]
    sxx = sums[last + 1, 2] - sums[first, 2] - x * x / n
    sxy = sums[last + 1, 3] - sums[first, 3] - x * y / n
    syy = sums[last + 1, 4] - sums[first, 4] - y * y / n
    return sxx, sxy, syy


@compiled
def line_cost(sums: Array, first: int, last: int) -> float:
    """Chi-square of the total-least-squares line through positions first to last: n S_normal / sum of variances."""
    n = last - first + 1
    if n < FEWEST:
        return 0.0
    sxx, sxy, syy = scatter(sums, first, last)
    spread = math.sqrt((sxx - syy) ** 2 + 4.0 * sxy * sxy)
    if spread <= 0.0:
        return 0.0
    cos2, sin2 = (sxx - syy) / spread, 2.0 * sxy / spread  # of twice the direction of the line
    cxx, cxy = sums[last + 1, 5] - sums[first, 5], sums[last + 1, 6] - sums[first, 6]
    cyy = sums[last + 1, 7] - sums[first, 7]
    variance = 0.5 * (cxx * (1.0 - cos2) + cyy * (1.0 + cos2)) - cxy * sin2
    return float(0.5 * n * max(sxx + syy - spread, 0.0) / variance)


@compiled
def split_cluster(points: Array, first: int, last: int, sigmas: float, breaks: Ints) -> int:
    """Ramer-Douglas-Peucker with a tolerance of `sigmas` standard deviations: fills `breaks`; the number of lines."""
    stack = np.empty((last - first + 2, 2), np.int64)
    stack[0, 0], stack[0, 1], breaks[0] = first, last, first - 1
    depth, size = 1, 0
    while depth > 0:
        depth -= 1
        low, high = stack[depth, 0], stack[depth, 1]
        split = farthest_point(points, low, high, sigmas)
        if split < 0:
            size += 1
            breaks[size] = high
        else:  # the left half is popped first, so that breaks come in order
            stack[depth, 0], stack[depth, 1] = split, high
            stack[depth + 1, 0], stack[depth + 1, 1] = low, split
            depth += 2
    return size


@compiled
def farthest_point(points: Array, low: int, high: int, sigmas: float) -> int:
    """The position strictly between low and high farthest off their chord in sigmas, or -1 when none is too far.

    Mispredicted branches cost more than arithmetic: the squared distances of all come first (row 4, several at once,
    with as few divisions as can be), and only those that equal the largest but for rounding are looked at. Where low
    and high are one point, there is no chord, and the distance from that point counts.
    """
    x0, y0, dx, dy = points[0, low], points[1, low], points[0, high] - points[0, low], points[1, high] - points[1, low]
    x, y = points[0, low + 1 : high], points[1, low + 1 : high]
    along, across = points[2, low + 1 : high], points[3, low + 1 : high]
    farthest, worst, length2 = -1, sigmas * sigmas, dx * dx + dy * dy
    if length2 < 1e-12:
        for i in range(x.shape[0]):
            ratio = ((x[i] - x0) ** 2 + (y[i] - y0) ** 2) / (along[i] + across[i])
            if ratio > worst:
                farthest, worst = low + 1 + i, ratio
        return farthest
    sigmas2 = points[4, low + 1 : high]
    for i in range(x.shape[0]):
        cross, ahead = dx * (y[i] - y0) - dy * (x[i] - x0), dx * y[i] - dy * x[i]
        r2, steep = x[i] * x[i] + y[i] * y[i], ahead * ahead
        sigmas2[i] = cross * cross * r2 / (along[i] * steep + across[i] * (length2 * r2 - steep))
    bits, largest = sigmas2.view(np.int64), 0  # numbers >= 0 are ordered as their bits are
    for i in range(x.shape[0]):
        largest = max(largest, bits[i])
    for i in range(x.shape[0]):
        if bits[i] < largest - ROUNDING:
            continue
        cross, ahead = dx * (y[i] - y0) - dy * (x[i] - x0), dx * y[i] - dy * x[i]
        steep = ahead * ahead / (x[i] * x[i] + y[i] * y[i])
        distance2, variance = cross * cross, along[i] * steep + across[i] * (length2 - steep)
        if distance2 > worst * variance:
            farthest, worst = low + 1 + i, distance2 / variance
    return farthest


@compiled
def merge_lines(sums: Array, breaks: Ints, size: int, gain: float) -> int:
    """Joins neighbouring lines, the most alike first, while a break between them saves less than `gain` (0: none)."""
    costs, saved = np.empty(size), np.empty(size)
    for k in range(size):
        costs[k] = line_cost(sums, breaks[k] + 1, breaks[k + 1])
    for k in range(size - 1):
        saved[k] = line_cost(sums, breaks[k] + 1, breaks[k + 2]) - costs[k] - costs[k + 1]
    while size > 1 and gain > 0.0:
        least = 0
        for k in range(1, size - 1):
            if saved[k] < saved[least]:
                least = k
        if saved[least] >= gain:
            break
        costs[least] += saved[least] + costs[least + 1]
        for k in range(least, size - 1):
            breaks[k + 1] = breaks[k + 2]
            if k > least:
                costs[k] = costs[k + 1]
                saved[k] = saved[k + 1]
        size -= 1
        for k in range(max(least - 1, 0), min(least + 1, size - 1)):
            saved[k] = line_cost(sums, breaks[k] + 1, breaks[k + 2]) - costs[k] - costs[k + 1]
    return size


@compiled
def refine_breaks(sums: Array, breaks: Ints, size: int, window: int) -> None:
    """Moves each break, at most `window` positions, to where the two lines beside it fit best."""
    for k in range(1, size):
        low, high, best, best_cost = breaks[k - 1] + 1, breaks[k + 1], breaks[k], math.inf
        start = max(low + FEWEST - 1, breaks[k] - window)
        for last in range(start, min(high - FEWEST, breaks[k] + window) + 1):
            cost = line_cost(sums, low, last) + line_cost(sums, last + 1, high)
            if cost < best_cost:
                best, best_cost = last, cost
        breaks[k] = best


@compiled
def absorb_slivers(sums: Array, breaks: Ints, size: int, gain: float, longest: int) -> int:
    """Divides a line of at most `longest` positions between its neighbours, where that costs less than `gain`."""
    k = 1
    while k < size - 1:
        low, start, end, high = breaks[k - 1] + 1, breaks[k] + 1, breaks[k + 1], breaks[k + 2]
        apart = line_cost(sums, low, start - 1) + line_cost(sums, start, end)
        apart += line_cost(sums, end + 1, high)
        best, best_cost = -1, apart + gain
        for last in range(start - 1, end + 1 if end - start < longest else start - 1):
            cost = line_cost(sums, low, last) + line_cost(sums, last + 1, high)
            if cost < best_cost:
                best, best_cost = last, cost
        if best < 0:
            k += 1
            continue
        breaks[k] = best
        for m in range(k + 1, size):
            breaks[m] = breaks[m + 1]
        size -= 1
    return size
