"""Compiled functions that lay the surfaces of a scan over past ones: nearest points, from point to line (PLICP)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import solve3
from mecp_env.core.se2 import to_map, wrap_angle

Points = tuple[Array, Array, Array]  # points (n,2) m, normals (n,2) or 0, sigmas (n,) m: a `Surfaces` as a plain tuple


class Index(NamedTuple):
    """Points in square cells, row by row: those of cell i are `order[first[i]:first[i + 1]]`."""

    low: Array  # (2,) m, the least coordinates
    side_m: float  # of a cell
    columns: int
    rows: int
    first: Ints  # (rows * columns + 1,)
    order: Ints  # (n,)


@compiled
def index_of(points: Array) -> Index:
    """The cells of points (n,2), at least one; along the longer side there are as many as the root of n, and one."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(points.shape[0]):
        for axis in range(2):
            low[axis], high[axis] = min(low[axis], points[i, axis]), max(high[axis], points[i, axis])
    side_m = max(high[0] - low[0], high[1] - low[1]) / math.sqrt(points.shape[0])
    side_m = side_m if side_m > 0.0 else 1.0
    columns, rows = int((high[0] - low[0]) / side_m) + 1, int((high[1] - low[1]) / side_m) + 1
    cell, first = np.empty(points.shape[0], np.int64), np.zeros(rows * columns + 1, np.int64)
    for i in range(points.shape[0]):
        cell[i] = int((points[i, 1] - low[1]) / side_m) * columns + int((points[i, 0] - low[0]) / side_m)
        first[cell[i] + 1] += 1
    for i in range(rows * columns):
        first[i + 1] += first[i]
    order, free = np.empty(points.shape[0], np.int64), first.copy()
    for i in range(points.shape[0]):
        order[free[cell[i]]] = i
        free[cell[i]] += 1
    return Index(low, side_m, columns, rows, first, order)


@compiled
def nearest(points: Array, index: Index, x: float, y: float, reach_m: float) -> int:
    """The one of the indexed points that is nearest to (x, y), and nearer than `reach_m`; -1 without one.

    Rings of cells are looked at around that of (x, y), until the next one can only be farther.
    """
    best, square = -1, reach_m * reach_m
    column, row = math.floor((x - index.low[0]) / index.side_m), math.floor((y - index.low[1]) / index.side_m)
    for ring in range(math.ceil(reach_m / index.side_m) + 1):
        if (ring - 1) * index.side_m > math.sqrt(square):
            break
        for r in range(max(row - ring, 0), min(row + ring, index.rows - 1) + 1):
            step = 1 if abs(r - row) == ring else max(2 * ring, 1)  # between them, all columns or the two at the sides
            for c in range(column - ring, column + ring + 1, step):
                if not 0 <= c < index.columns:
                    continue
                for k in range(index.first[r * index.columns + c], index.first[r * index.columns + c + 1]):
                    i = index.order[k]
                    far = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
                    if far < square:
                        best, square = i, far
    return best


@compiled
def paired(past: Points, index: Index, there: Points, reach_m: float, facing: float) -> Ints:
    """(n,) for each point now the nearest of the past, nearer than `reach_m`, if both face the same way; else -1."""
    points, normals, _ = there
    pairs = np.empty(points.shape[0], np.int64)
    for i in range(points.shape[0]):
        j = nearest(past[0], index, points[i, 0], points[i, 1], reach_m)
        pairs[i] = j
        if j >= 0:
            u, v, p, q = normals[i, 0], normals[i, 1], past[1][j, 0], past[1][j, 1]
            loose = (u == 0.0 and v == 0.0) or (p == 0.0 and q == 0.0)
            pairs[i] = j if loose or u * p + v * q > facing else -1
    return pairs


@compiled
def add_rows(
    past: Points, there: Points, pairs: Ints, T: Array, reach_m: float, information: Array, push: Array
) -> None:
    """Add J^T W J (3,3) and J^T W r (3,) of the distances along the normals, and in x and y where there are none."""
    (points, _, sigmas), (others, normals, past_sigmas), J = there, past, np.empty(3)
    for i in range(points.shape[0]):
        j = pairs[i]
        if j < 0:
            continue
        sigma = math.hypot(sigmas[i], past_sigmas[j])
        loose = normals[j, 0] == 0.0 and normals[j, 1] == 0.0
        for row in range(2 if loose else 1):
            J[0], J[1] = (1.0 - row, 1.0 * row) if loose else (normals[j, 0], normals[j, 1])
            J[2] = J[1] * (points[i, 0] - T[0]) - J[0] * (points[i, 1] - T[1])
            off = J[0] * (points[i, 0] - others[j, 0]) + J[1] * (points[i, 1] - others[j, 1])
            weight = 1.0 / (sigma**2 + (off * sigma / max(sigma, reach_m / 3.0)) ** 2)  # Cauchy
            for a in range(3):
                push[a] += J[a] * weight * off
                for b in range(3):
                    information[a, b] += J[a] * weight * J[b]


@compiled
def align(
    past: Points,
    index: Index,
    now: Points,
    start: Array,
    prior: tuple[Array, Array],
    reaches: tuple[float, float],
    limits: tuple[float, int],
) -> tuple[Array, Array, Bools]:
    """Gauss-Newton from a start T_past_now (3,): the pose, its information (3,3), and which points (n,) are paired.

    `prior` is T_past_now (3,) with the inverse (3,3) of its covariance, which is no part of the information. Pairs are
    no farther apart than `reaches`, at first and at last: halved in two steps, then four more. `limits` are the least
    cosine between the normals of a pair, and the least number of pairs; with fewer, none is paired.
    """
    T, (reach_m, near_m), (facing, least) = start.copy(), reaches, limits
    information, pairs = np.zeros((3, 3)), np.full(now[0].shape[0], -1)
    for _ in range(2 * math.ceil(math.log2(reach_m / near_m)) + 4):
        turn = np.array([0.0, 0.0, T[2]])
        there = to_map(T, now[0]), to_map(turn, now[1]), now[2]
        pairs = paired(past, index, there, reach_m, facing)
        if (pairs >= 0).sum() < least:
            pairs[:] = -1
            break
        off = T - prior[0]
        off[2] = wrap_angle(off[2])
        information, push = np.zeros((3, 3)), np.zeros(3)
        add_rows(past, there, pairs, T, reach_m, information, push)
        total = information + prior[1]
        for a in range(3):
            for b in range(3):
                push[a] += prior[1][a, b] * off[b]
        solve3(total, push)
        T -= push
        reach_m = max(near_m, reach_m * math.sqrt(0.5))
    T[2] = wrap_angle(T[2])
    return T, information, pairs >= 0


@compiled
def count_against(points: Array, alone: Bools, bearings: Array, ranges: Array, inside_m: float) -> int:
    """How many of the points (n,2) that are `alone` lie on floor that a scan with these beams (B,) saw free."""
    against = 0
    for i in range(points.shape[0]):
        bearing = math.atan2(points[i, 1], points[i, 0])
        if not (alone[i] and bearings[0] < bearing < bearings[-1]):
            continue
        k = np.searchsorted(bearings, bearing)
        share = (bearing - bearings[k - 1]) / (bearings[k] - bearings[k - 1])
        seen = ranges[k - 1] + share * (ranges[k] - ranges[k - 1])
        against += math.hypot(points[i, 0], points[i, 1]) < seen - inside_m
    return against
