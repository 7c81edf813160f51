"""Kernels of the grid planner: clearance, cost of cells, distance field, shortcuts. Grids are indexed [row, column]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Costs = NDArray[np.int32]
Distances = NDArray[np.float32]
Bytes = NDArray[np.uint8]

FREE, OCCUPIED, DOOR = 1, 2, 3  # as in mecp_env.slam.messages.Cell
HALF_LENGTH = np.array([5, 5, 5, 5, 7, 7, 7, 7])  # of the steps, in tenths of a cell
OPEN_COST = 10  # of a tenth of a cell far from walls; more near them
MAX_COST = 250
FAR = 2**30
BUCKETS = 4096  # a power of two, more than a step can cost
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@compiled
def cost_to_go(
    label: Bytes, row: int, column: int, limits: tuple[float, float, float, int]
) -> tuple[Distances, Bytes, Costs, Bytes]:
    """Clearance, cost of the cells, cost of the ways from a cell, and the step that leads to each cell; all (H,W).

    `limits`: least and comfortable distance to walls, in cells; the cost at the least one; how far a robot that stands
    too near to a wall may go to get out, in cells.
    """
    least, comfort, wall_cost, way_out = limits
    distance = clearance(label, comfort)
    cost = cell_costs(label, distance, least, comfort, wall_cost)
    open_start(cost, label, distance, row, column, way_out)
    total, step = distance_field(cost, row, column)
    return distance, cost, total, step


@compiled
def clearance(label: Bytes, reach: float) -> Distances:
    """(H,W) distance of each cell to the nearest OCCUPIED one, centre to centre, in cells, up to `reach`."""
    height, width = label.shape
    near = math.ceil(reach)
    rows_away = _rows_to_wall(label, near + 1)
    roots = np.empty(2 * (near + 1) ** 2 + 1, np.float32)  # of a sum of two squares, up to `reach`
    for i in range(near + 2):
        for j in range(near + 2):
            roots[i * i + j * j] = min(math.hypot(i, j), reach)
    distance = np.empty((height, width), np.float32)
    squares, least = np.empty(width + 2 * near, np.float32), np.empty(width, np.float32)
    for row in range(height):
        for i in range(width + 2 * near):
            squares[i] = (near + 1) ** 2
        for column in range(width):
            squares[column + near] = rows_away[row, column] * rows_away[row, column]
            least[column] = squares[column + near]
        for i in range(2 * near + 1):
            aside = np.float32((i - near) ** 2)
            for column in range(width):
                least[column] = min(least[column], squares[column + i] + aside)
        for column in range(width):
            distance[row, column] = roots[int(least[column])]
    return distance


@compiled
def _rows_to_wall(label: Bytes, most: int) -> Costs:
    """(H,W) how many rows away the nearest OCCUPIED cell of the column is, up to `most`."""
    height, width = label.shape
    away = np.empty((height, width), np.int32)
    for row in range(height):
        for column in range(width):
            before = away[row - 1, column] + 1 if row > 0 else most
            away[row, column] = 0 if label[row, column] == OCCUPIED else min(before, most)
    for i in range(1, height):
        row = height - 1 - i
        for column in range(width):
            away[row, column] = min(away[row, column], away[row + 1, column] + 1)
    return away


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


@compiled
def open_start(cost: Bytes, label: Bytes, distance: Distances, row: int, column: int, radius: int) -> None:
    """Let a robot that stands too near to a wall out: over cells near it, at most a cell nearer to walls than it is.

    That cell is for the way round: past a barred cell there is no diagonal step.
    """
    if cost[row, column] > 0:
        return
    cost[row, column] = MAX_COST
    for r in range(max(row - radius, 0), min(row + radius + 1, cost.shape[0])):
        for c in range(max(column - radius, 0), min(column + radius + 1, cost.shape[1])):
            near = (r - row) ** 2 + (c - column) ** 2 <= radius * radius
            free = label[r, c] == FREE or label[r, c] == DOOR
            if near and free and cost[r, c] == 0 and distance[r, c] >= distance[row, column] - 1.0:
                cost[r, c] = MAX_COST


@compiled
def distance_field(cost: Bytes, row: int, column: int) -> tuple[Costs, Bytes]:
    """Cheapest ways from a cell to all others: their cost (H,W), and the step that leads to each cell (8: none).

    Dijkstra with one bucket a cost (every step costs less than there are buckets), 8 neighbours, no diagonal step past
    a barred cell. FAR where there is no way. The cells on the border of the grid are taken as barred. A bucket is a
    stack of notes, each of a cell and the note below; the note of a cell that was reached cheaper since is passed over.
    """
    width, flat = cost.shape[1], within_border(cost)
    total, step = np.full(cost.size, FAR, np.int32), np.full(cost.size, 8, np.uint8)
    top = np.full(BUCKETS, -1, np.int32)
    below, cell_of = np.empty(8 * cost.size, np.int32), np.empty(8 * cost.size, np.int32)
    start = row * width + column
    total[start], top[0], below[0], cell_of[0] = 0, 0, -1, start
    notes, at, last = 1, 0, 0 if flat[start] else -1
    while at <= last:
        note = top[at & (BUCKETS - 1)]
        if note < 0:
            at += 1
            continue
        top[at & (BUCKETS - 1)] = below[note]
        cell = cell_of[note]
        for k in range(8 if total[cell] == at else 0):
            near = cell + DROW[k] * width + DCOL[k]
            far = at + HALF_LENGTH[k] * (np.int64(flat[cell]) + flat[near])
            if flat[near] == 0 or far >= total[near]:
                continue
            if k >= 4 and (flat[cell + DROW[k] * width] == 0 or flat[cell + DCOL[k]] == 0):
                continue
            total[near], step[near] = far, k
            below[notes], cell_of[notes] = top[far & (BUCKETS - 1)], near
            top[far & (BUCKETS - 1)] = notes
            notes += 1
            last = max(last, far)
    return total.reshape(cost.shape), step.reshape(cost.shape)


@compiled
def within_border(cost: Bytes) -> Bytes:
    """(H*W,) the cost of the cells, 0 on the border of the grid."""
    height, width = cost.shape
    inner = np.zeros((height, width), np.uint8)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            inner[row, column] = cost[row, column]
    return inner.reshape(-1)


@compiled
def path_lengths(total: Costs, step: Bytes, places: Array) -> Array:
    """(g,) length of the way to the cell nearest to each place, in tenths of a cell; -1: there is none.

    `places` (g,3): x, y and how near the way must come, in cells.
    """
    lengths = np.empty(places.shape[0])
    for i in range(places.shape[0]):
        row, column = nearest_reached(total, places[i, 0], places[i, 1], places[i, 2])
        lengths[i] = way_length(step, row, column) if row >= 0 else -1
    return lengths


@compiled
def way_length(step: Bytes, row: int, column: int) -> int:
    """Length of the way to a cell that was reached, in tenths of a cell."""
    length, k = 0, step[row, column]
    while k != 8:
        length += 2 * HALF_LENGTH[k]
        row, column = row - DROW[k], column - DCOL[k]
        k = step[row, column]
    return length


@compiled
def smooth_path(step: Bytes, row: int, column: int, distance: Distances, cost: Bytes, least: float) -> Array:
    """The way (n,2) to a cell that was reached, in cells (x, y), without the points that `shorten` leaves out."""
    cells = trace_back(step, row, column)
    points = np.empty(cells.shape)
    for i in range(cells.shape[0]):
        points[i, 0], points[i, 1] = cells[i, 1] + 0.5, cells[i, 0] + 0.5
    return shorten(points, distance, cost, least)


@compiled
def trace_back(step: Bytes, row: int, column: int) -> Ints:
    """Cells (n,2), row and column, from the source of a distance field to a cell it reached."""
    limit = step.shape[0] * step.shape[1]
    cells = np.empty((limit, 2), np.int64)
    n = 0
    while n < limit:
        cells[n, 0], cells[n, 1] = row, column
        n += 1
        k = step[row, column]
        if k == 8:
            break
        row, column = row - DROW[k], column - DCOL[k]
    return cells[:n][::-1].copy()


@compiled
def nearest_reached(total: Costs, x: float, y: float, reach: float) -> tuple[int, int]:
    """Row and column of the reached cell nearest to (x, y), in cells, within `reach`; (-1, -1): none."""
    best, found_row, found_column = math.inf, -1, -1
    for row in range(max(math.floor(y - reach), 0), min(math.floor(y + reach) + 1, total.shape[0])):
        for column in range(max(math.floor(x - reach), 0), min(math.floor(x + reach) + 1, total.shape[1])):
            if total[row, column] >= FAR:
                continue
            distance = math.hypot(column + 0.5 - x, row + 0.5 - y) + 1e-9 * total[row, column]
            if distance < min(best, reach):
                best, found_row, found_column = distance, row, column
    return found_row, found_column


@compiled
def clear_line(distance: Distances, x0: float, y0: float, x1: float, y1: float, least: float) -> bool:
    """True when every cell on the line between two points, in cells, is `least` or more from walls."""
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    for i in range(n + 1):
        row = math.floor(y0 + (y1 - y0) * i / n)
        column = math.floor(x0 + (x1 - x0) * i / n)
        if not (0 <= row < distance.shape[0] and 0 <= column < distance.shape[1]) or distance[row, column] < least:
            return False
    return True


@compiled
def wall_on_way(label: Bytes, path: Array, origin: Array, resolution: float, radius_m: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius_m` of the path (n,2) m, map frame."""
    cells = np.empty(path.shape)
    for i in range(path.shape[0]):
        cells[i, 0], cells[i, 1] = (path[i, 0] - origin[0]) / resolution, (path[i, 1] - origin[1]) / resolution
    return wall_on_path(label, cells, radius_m / resolution)


@compiled
def wall_on_path(label: Bytes, path: Array, radius: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius` of the path (n,2), in cells."""
    near = math.ceil(radius)
    for leg in range(path.shape[0] - 1):
        dx, dy = path[leg + 1, 0] - path[leg, 0], path[leg + 1, 1] - path[leg, 1]
        n = int(math.hypot(dx, dy)) + 1
        for i in range(n + 1):
            x, y = path[leg, 0] + dx * i / n, path[leg, 1] + dy * i / n
            if _wall_within(label, x, y, near, radius):
                return True
    return False


@compiled
def _wall_within(label: Bytes, x: float, y: float, near: int, radius: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius` of (x, y), in cells."""
    row, column = math.floor(y), math.floor(x)
    for r in range(max(row - near, 0), min(row + near + 1, label.shape[0])):
        for c in range(max(column - near, 0), min(column + near + 1, label.shape[1])):
            if label[r, c] == OCCUPIED and math.hypot(c + 0.5 - x, r + 0.5 - y) < radius:
                return True
    return False


@compiled
def shorten(points: Array, distance: Distances, cost: Bytes, least: float) -> Array:
    """The path (n,2), in cells, without the points that a clear line over known cells jumps; the ends stay."""
    kept = np.empty_like(points)
    kept[0] = points[0]
    n, at = 1, 0
    while at < points.shape[0] - 1:
        onward = at + 1
        while onward + 1 < points.shape[0] and _may_jump(points, distance, cost, at, onward + 1, least):
            onward += 1
        kept[n] = points[onward]
        n, at = n + 1, onward
    return kept[:n].copy()


@compiled
def _may_jump(points: Array, distance: Distances, cost: Bytes, first: int, last: int, least: float) -> bool:
    """True when the line between two points of a path is clear and passable."""
    x0, y0, x1, y1 = points[first, 0], points[first, 1], points[last, 0], points[last, 1]
    if not clear_line(distance, x0, y0, x1, y1, least):
        return False
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    passable = True
    for i in range(n + 1):
        passable = passable and cost[math.floor(y0 + (y1 - y0) * i / n), math.floor(x0 + (x1 - x0) * i / n)] > 0
    return passable
