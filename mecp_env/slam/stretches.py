"""Kernels that cut a cluster into straight stretches: Ramer-Douglas-Peucker (III-A.1), then chi-square on the breaks.

A stretch is a run of positions; `ends` holds the last position of each stretch of a cluster, in order. Prefix sums of
moments and of the points' own covariance give the chi-square of any stretch in constant time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.noise import Noise

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
MIN_STRETCH = 3  # positions; a break is not moved nearer to its neighbour
SMALL_TURN = 0.02  # rad: the series below is exact to the last digit
SLIVER = 8  # positions; a stretch shorter than this may be shared out between its neighbours


@kernel
def beam_points(polar: Array, noise: Noise) -> tuple[Array, Array]:
    """Points (B,4): x, y, variances along and across the ray; prefix sums (B+1,8) of x, y, xx, xy, yy, covariance."""
    size = polar.shape[0]
    points, sums = np.empty((size, 4)), np.zeros((size + 1, 8))
    c, s, bearing = 1.0, 0.0, math.inf
    for i in range(size):
        c, s = turned_by(c, s, bearing, polar[i, 1])
        r, bearing = polar[i, 0], polar[i, 1]
        along = noise.range_m**2 / polar[i, 2]
        across = (r * noise.bearing) ** 2 / polar[i, 2]
        x, y = r * c, r * s
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = x, y, along, across
        sums[i + 1, 0], sums[i + 1, 1] = sums[i, 0] + x, sums[i, 1] + y
        sums[i + 1, 2], sums[i + 1, 3], sums[i + 1, 4] = sums[i, 2] + x * x, sums[i, 3] + x * y, sums[i, 4] + y * y
        sums[i + 1, 5] = sums[i, 5] + along * c * c + across * s * s
        sums[i + 1, 6] = sums[i, 6] + (along - across) * c * s
        sums[i + 1, 7] = sums[i, 7] + along * s * s + across * c * c
    return points, sums


@kernel
def turned_by(c: float, s: float, bearing: float, following: float) -> tuple[float, float]:
    """Cosine and sine of `following`, from those of the bearing before it: a small turn needs no trigonometry."""
    turn = following - bearing
    if not abs(turn) < SMALL_TURN:
        return math.cos(following), math.sin(following)
    q = turn * turn
    ct, st = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0)), turn * (1.0 - q / 6.0 * (1.0 - q / 20.0))
    return c * ct - s * st, s * ct + c * st


@kernel
def scatter(sums: Array, first: int, last: int) -> tuple[float, float, float]:
    """Central second moments sxx, sxy, syy (sums, not means) of positions first to last."""
    n = last - first + 1
    x, y = sums[last + 1, 0] - sums[first, 0], sums[last + 1, 1] - sums[first, 1]
    sxx = sums[last + 1, 2] - sums[first, 2] - x * x / n
    sxy = sums[last + 1, 3] - sums[first, 3] - x * y / n
    syy = sums[last + 1, 4] - sums[first, 4] - y * y / n
    return sxx, sxy, syy


@kernel
def stretch_cost(sums: Array, first: int, last: int) -> float:
    """Chi-square of the total-least-squares line through positions first to last: n S_normal / sum of variances."""
    n = last - first + 1
    if n < 3:
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


@kernel
def break_cluster(points: Array, first: int, last: int, sigmas: float, ends: Ints) -> int:
    """Ramer-Douglas-Peucker with a tolerance of `sigmas` standard deviations: fills `ends`, returns how many."""
    stack = np.empty((last - first + 2, 2), np.int64)
    stack[0, 0], stack[0, 1] = first, last
    depth, size = 1, 0
    while depth > 0:
        depth -= 1
        low, high = stack[depth, 0], stack[depth, 1]
        split = farthest_point(points, low, high, sigmas)
        if split < 0:
            ends[size] = high
            size += 1
        else:  # the left half is popped first, so that ends come in order
            stack[depth, 0], stack[depth, 1] = split, high
            stack[depth + 1, 0], stack[depth + 1, 1] = low, split
            depth += 2
    return size


@kernel
def farthest_point(points: Array, low: int, high: int, sigmas: float) -> int:
    """The position strictly between low and high farthest off their chord in sigmas, or -1 when none is too far."""
    dx, dy = points[high, 0] - points[low, 0], points[high, 1] - points[low, 1]
    length2 = dx * dx + dy * dy
    closed = length2 < 1e-12  # a ring starts where it ends: no chord
    farthest, worst = -1, sigmas * sigmas
    for i in range(low + 1, high):
        x, y = points[i, 0], points[i, 1]
        px, py = x - points[low, 0], y - points[low, 1]
        cross, ahead = dx * py - dy * px, dx * y - dy * x
        distance2 = px * px + py * py if closed else cross * cross  # all times length2, to save divisions
        steep = 1.0 if closed else ahead * ahead / (x * x + y * y)
        variance = points[i, 2] * steep + points[i, 3] * (length2 - steep)
        if distance2 > worst * variance:
            farthest, worst = i, distance2 / variance
    return farthest


@kernel
def merge_stretches(sums: Array, first: int, ends: Ints, size: int, gain: float) -> int:
    """Joins neighbouring stretches, the most alike first, while a break between them saves less than `gain`."""
    costs, saved = np.empty(size), np.empty(size)
    for k in range(size):
        costs[k] = stretch_cost(sums, start_of(first, ends, k), ends[k])
    for k in range(size - 1):
        saved[k] = stretch_cost(sums, start_of(first, ends, k), ends[k + 1]) - costs[k] - costs[k + 1]
    while size > 1:
        least = 0
        for k in range(1, size - 1):
            if saved[k] < saved[least]:
                least = k
        if saved[least] >= gain:
            break
        costs[least] += saved[least] + costs[least + 1]
        for k in range(least, size - 1):
            ends[k] = ends[k + 1]
            if k > least:
                costs[k] = costs[k + 1]
                saved[k] = saved[k + 1]
        size -= 1
        for k in range(max(least - 1, 0), min(least + 1, size - 1)):
            saved[k] = stretch_cost(sums, start_of(first, ends, k), ends[k + 1]) - costs[k] - costs[k + 1]
    return size


@kernel
def start_of(first: int, ends: Ints, k: int) -> int:
    """First position of stretch k of a cluster that begins at `first`."""
    return first if k == 0 else int(ends[k - 1]) + 1


@kernel
def refine_breaks(sums: Array, first: int, ends: Ints, size: int, window: int) -> None:
    """Moves each break, at most `window` positions, to where the two lines beside it fit best."""
    for k in range(size - 1):
        low, high = start_of(first, ends, k), ends[k + 1]
        best, best_cost = ends[k], math.inf
        start = max(low + MIN_STRETCH - 1, ends[k] - window)
        for last in range(start, min(high - MIN_STRETCH, ends[k] + window) + 1):
            cost = stretch_cost(sums, low, last) + stretch_cost(sums, last + 1, high)
            if cost < best_cost:
                best, best_cost = last, cost
        ends[k] = best


@kernel
def absorb_slivers(sums: Array, first: int, ends: Ints, size: int, gain: float) -> int:
    """Shares the few positions between two longer stretches out between them, where that costs less than `gain`."""
    k = 1
    while k < size - 1:
        low, start, high = start_of(first, ends, k - 1), ends[k - 1] + 1, ends[k + 1]
        apart = stretch_cost(sums, low, start - 1) + stretch_cost(sums, start, ends[k])
        apart += stretch_cost(sums, ends[k] + 1, high)
        best, best_cost = -1, apart + gain
        for last in range(start - 1, ends[k] + 1 if ends[k] - start < SLIVER else start - 1):
            cost = stretch_cost(sums, low, last) + stretch_cost(sums, last + 1, high)
            if cost < best_cost:
                best, best_cost = last, cost
        if best < 0:
            k += 1
            continue
        ends[k - 1] = best
        for m in range(k, size - 1):
            ends[m] = ends[m + 1]
        size -= 1
    return size


@kernel
def straighten(sums: Array, first: int, ends: Ints, size: int, gain: float) -> int:
    """Merges and refines: coarse breaks first, then fine ones."""
    size = merge_stretches(sums, first, ends, size, gain)
    refine_breaks(sums, first, ends, size, 8)
    size = absorb_slivers(sums, first, ends, size, gain)
    size = merge_stretches(sums, first, ends, size, gain)
    refine_breaks(sums, first, ends, size, 3)
    return size
