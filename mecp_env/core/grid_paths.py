"""Compiled functions of the grid planner: clearance, cost of cells, cost to go, paths. Grids are [row, column]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.jit import compiled

Costs = NDArray[np.int32]
Distances = NDArray[np.float32]

UNKNOWN, FREE, OCCUPIED, DOOR = 0, 1, 2, 3  # as in mecp_env.slam.messages.Cell
HALF_LENGTH = np.array([5, 5, 5, 5, 7, 7, 7, 7])  # of the steps, in tenths of a cell
OPEN_COST = 10  # of a tenth of a cell far from walls; more near them
MAX_COST = 250
FAR = 2**30
ONE = np.uint16(1)
BUCKETS = 4096  # a power of two, more than a step can cost
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@compiled
def clearance(label: Bytes, reach: float) -> Distances:
    """(H,W) distance of each cell to the nearest OCCUPIED one, centre to centre, in cells, up to `reach`."""
    (height, width), near = label.shape, math.ceil(reach)
    assert near < 180  # the sum of two squares of near + 1 fits into 16 bits
    far = np.uint16(near + 1)
    away = np.empty((height, width), np.uint16)  # rows to the nearest OCCUPIED cell of the column, up to near + 1
    for column in range(width if height else 0):
        away[0, column] = np.uint16(0) if label[0, column] == OCCUPIED else far
    for row in range(1, height):
        labels, own, above = label[row], away[row], away[row - 1]
        for column in range(width):
            own[column] = np.uint16(0) if labels[column] == OCCUPIED else min(np.uint16(above[column] + ONE), far)
    for i in range(1, height):
        own, below = away[height - 1 - i], away[height - i]
        for column in range(width):
            own[column] = min(own[column], np.uint16(below[column] + ONE))
    roots = np.empty(2 * (near + 1) ** 2 + 1, np.float32)  # of a sum of two squares, up to `reach`
    for i in range(near + 2):
        for j in range(near + 2):
            roots[i * i + j * j] = min(math.hypot(i, j), reach)
    distance = np.empty((height, width), np.float32)
    squares, least = np.full(width + 2 * near, far * far, np.uint16), np.empty(width, np.uint16)
    inner = squares[near : near + width]
    for row in range(height):
        own, found = away[row], distance[row]
        for column in range(width):
            inner[column] = own[column] * own[column]
            least[column] = inner[column]
        for i in range(2 * near + 1):
            aside, shifted = np.uint16((i - near) ** 2), squares[i : i + width]
            for column in range(width):  # of short integers, so that many cells are done at a time
                least[column] = min(least[column], np.uint16(shifted[column] + aside))
        for column in range(width):
            found[column] = roots[np.uint32(least[column])]
    return distance


@compiled
def cell_costs(label: Bytes, distance: Distances, least: float, comfort: float, wall_cost: float) -> Bytes:
    """(H,W) cost of a tenth of a cell: OPEN_COST in the open, more by `wall_cost` times that at `least`; 0: barred.

    `distance` as from `clearance`; `least` and `comfort` in cells. Unknown cells are barred.
    """
    height, width = label.shape
    cost = np.zeros((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            free = label[row, column] == FREE or label[row, column] == DOOR
            if not free or distance[row, column] < least:
                continue
            share = max(comfort - distance[row, column], 0.0) / max(comfort - least, 1e-9)
            cost[row, column] = min(int(OPEN_COST * (1.0 + wall_cost * share * share)), MAX_COST)
    return cost


def open_start(
    cost: Bytes, label: Bytes, distance: Distances, cell: tuple[int, int], radius: float, body: float
) -> None:
    """Let a robot at a cell (row, column) out: over the unknown cells under its body, which a laser may not see.

    If it stands too near to a wall, also over free cells within `radius`. None is more than a cell nearer to walls than
    the robot is; that cell is for the way round: past a barred cell there is no diagonal step. Lengths are in cells.
    """
    (row, column), reach = cell, int(max(radius, body))
    barred = cost[row, column] == 0
    around = slice(max(row - reach, 0), row + reach + 1), slice(max(column - reach, 0), column + reach + 1)
    rows, columns = np.arange(cost.shape[0])[around[0], None], np.arange(cost.shape[1])[around[1]]
    square = (rows - row) ** 2 + (columns - column) ** 2
    opened = (square <= body * body) & (label[around] == UNKNOWN)
    if barred:
        cost[row, column] = MAX_COST
        opened |= (square <= radius * radius) & ((label[around] == FREE) | (label[around] == DOOR))
    away = distance[around].astype(np.float64) >= float(distance[row, column]) - 1.0
    cost[around][opened & away & (cost[around] == 0)] = MAX_COST


@compiled
def cost_to_go(cost: Bytes, row: int, column: int) -> tuple[Costs, Bytes]:
    """Cheapest paths from a cell to all others: their cost (H,W), and the step that leads to each cell (8: none).

    Dijkstra with one bucket per cost (every step costs less than there are buckets), 8 neighbours, no diagonal step
    past a barred cell. FAR where there is no path. The cells on the border of the grid are taken as barred. A bucket is
    a stack of notes, each of a cell and the note below; the note of a cell that was reached cheaper since is ignored.
    """
    height, width = cost.shape
    inner = np.zeros((height, width), np.uint8)
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            inner[r, c] = cost[r, c]
    flat = inner.reshape(-1)
    total, step = np.full(cost.size, FAR, np.int32), np.full(cost.size, 8, np.uint8)
    top = np.full(BUCKETS, -1, np.int32)
    below, cell_of = np.empty(8 * cost.size, np.int32), np.empty(8 * cost.size, np.int32)
    aside = (DROW * width + DCOL).astype(np.int32)
    start = row * width + column
    total[start], top[0], below[0], cell_of[0] = 0, 0, -1, start
    notes, at, last = np.int32(1), np.int32(0), np.int32(0 if flat[start] else -1)
    while at <= last:
        bucket = np.uint32(at & (BUCKETS - 1))  # indices without a sign are not asked for being negative
        note = np.uint32(top[bucket])
        if top[bucket] < 0:
            at += np.int32(1)
            continue
        top[bucket] = below[note]
        cell = cell_of[note]
        here = np.uint32(cell)
        for k in range(8 if total[here] == at else 0):
            near = np.uint32(cell + aside[k])
            far = at + np.int32(HALF_LENGTH[k]) * (np.int32(flat[here]) + np.int32(flat[near]))
            if flat[near] == 0 or far >= total[near]:
                continue
            if k >= 4 and (flat[cell + DROW[k] * width] == 0 or flat[cell + DCOL[k]] == 0):
                continue
            total[near], step[near], bucket = far, k, np.uint32(far & (BUCKETS - 1))
            below[np.uint32(notes)], cell_of[np.uint32(notes)] = top[bucket], near
            top[bucket] = notes
            notes += np.int32(1)
            last = max(last, far)
    return total.reshape(cost.shape), step.reshape(cost.shape)


@compiled
def path_lengths(total: Costs, step: Bytes, places: Array) -> Array:
    """(g,) length of the path to the cell nearest to each place, in tenths of a cell; -1: there is none.

    `places` (g,3): x, y and how near the path must come, in cells.
    """
    lengths = np.empty(places.shape[0])
    for i in range(places.shape[0]):
        row, column = nearest_reached(total, places[i, 0], places[i, 1], places[i, 2])
        lengths[i] = 0.0 if row >= 0 else -1.0
        k = step[row, column] if row >= 0 else np.uint8(8)
        while k != 8:
            lengths[i] += 2 * HALF_LENGTH[k]
            row, column = row - DROW[k], column - DCOL[k]
            k = step[row, column]
    return lengths


@compiled
def smooth_path(step: Bytes, row: int, column: int, distance: Distances, cost: Bytes, least: float) -> Array:
    """The path (n,2) to a reached cell, in cells (x, y), without the points that a clear line over known cells jumps.

    The ends stay.
    """
    limit = step.shape[0] * step.shape[1]
    back = np.empty((limit, 2), np.int64)  # from the reached cell to the source
    n, k = 0, 0
    while n < limit and k != 8:
        back[n, 0], back[n, 1] = row, column
        n, k = n + 1, int(step[row, column])
        if k != 8:
            row, column = row - DROW[k], column - DCOL[k]
    cells = back[:n][::-1]
    kept = np.empty(cells.shape)
    kept[0, 0], kept[0, 1] = cells[0, 1] + 0.5, cells[0, 0] + 0.5
    n, at = 1, 0
    while at < cells.shape[0] - 1:
        onward = at + 1
        while onward + 1 < cells.shape[0] and clear_line(distance, cost, cells[at], cells[onward + 1], least):
            onward += 1
        kept[n, 0], kept[n, 1] = cells[onward, 1] + 0.5, cells[onward, 0] + 0.5
        n, at = n + 1, onward
    return kept[:n].copy()


@compiled
def nearest_reached(total: Costs, x: float, y: float, reach: float) -> tuple[int, int]:
    """Row and column of the reached cell nearest to (x, y), in cells, within `reach`; (-1, -1): none."""
    best, found_row, found_column = math.inf, -1, -1
    row, column = math.floor(y), math.floor(x)
    if 0 <= row < total.shape[0] and 0 <= column < total.shape[1] and total[row, column] < FAR:
        reach = min(reach, 1.0)  # no cell is nearer than the own one, but one beside it
    for row in range(max(math.floor(y - reach), 0), min(math.floor(y + reach) + 1, total.shape[0])):
        for column in range(max(math.floor(x - reach), 0), min(math.floor(x + reach) + 1, total.shape[1])):
            if total[row, column] >= FAR:
                continue
            distance = math.hypot(column + 0.5 - x, row + 0.5 - y) + 1e-9 * total[row, column]
            if distance < min(best, reach):
                best, found_row, found_column = distance, row, column
    return found_row, found_column


@compiled
def clear_line(distance: Distances, cost: Bytes, first: Ints, last: Ints, least: float) -> bool:
    """True when all cells on the line between two cells (row, column) are passable, and `least` or more from walls."""
    x0, y0, x1, y1 = first[1] + 0.5, first[0] + 0.5, last[1] + 0.5, last[0] + 0.5
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    for i in range(n + 1):
        row, column = math.floor(y0 + (y1 - y0) * i / n), math.floor(x0 + (x1 - x0) * i / n)
        if distance[row, column] < least or cost[row, column] == 0:
            return False
    return True


@compiled
def wall_on_path(label: Bytes, path: Array, origin: Array, resolution: float, radius_m: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius_m` of the path (n,2) m, map frame."""
    cells, radius = np.empty(path.shape), radius_m / resolution
    for i in range(path.shape[0]):
        cells[i, 0], cells[i, 1] = (path[i, 0] - origin[0]) / resolution, (path[i, 1] - origin[1]) / resolution
    for leg in range(path.shape[0] - 1):
        dx, dy = cells[leg + 1, 0] - cells[leg, 0], cells[leg + 1, 1] - cells[leg, 1]
        n = int(math.hypot(dx, dy)) + 1
        for i in range(n + 1):
            if _wall_within(label, cells[leg, 0] + dx * i / n, cells[leg, 1] + dy * i / n, radius):
                return True
    return False


@compiled
def _wall_within(label: Bytes, x: float, y: float, radius: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius` of (x, y), in cells."""
    row, column, near = math.floor(y), math.floor(x), math.ceil(radius)
    for r in range(max(row - near, 0), min(row + near + 1, label.shape[0])):
        for c in range(max(column - near, 0), min(column + near + 1, label.shape[1])):
            if label[r, c] == OCCUPIED and math.hypot(c + 0.5 - x, r + 0.5 - y) < radius:
                return True
    return False
