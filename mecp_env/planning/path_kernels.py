"""Kernels of the grid planner: clearance, cost of cells, distance field, shortcuts. Grids are indexed [row, column]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Costs = NDArray[np.int32]
Distances = NDArray[np.float32]
Bytes = NDArray[np.uint8]

FREE, OCCUPIED, DOOR = 1, 2, 3  # as in mecp_env.slam.data.Cell
HALF_LENGTH = np.array([5, 5, 5, 5, 7, 7, 7, 7])  # of the steps, in tenths of a cell
OPEN_COST = 10  # of a tenth of a cell far from walls; more near them
MAX_COST = 250
FAR = 2**30
BUCKETS = 4096  # a power of two, more than a step can cost
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@kernel
def clearance(label: Bytes, reach: float) -> Distances:
    """(H,W) distance of each cell to the nearest OCCUPIED one, centre to centre, in cells, up to `reach`."""
    height, width = label.shape
    distance = np.full((height, width), np.float32(reach), np.float32)
    near = math.ceil(reach)
    disc = np.empty((2 * near + 1, 2 * near + 1), np.float32)
    for i in range(2 * near + 1):
        for j in range(2 * near + 1):
            disc[i, j] = math.hypot(i - near, j - near)
    for row in range(height):
        for column in range(width):
            if label[row, column] == OCCUPIED:
                _stamp(distance, disc, row, column, near)
    return distance


@kernel
def _stamp(distance: Distances, disc: Distances, row: int, column: int, near: int) -> None:
    """Let no cell around a wall be farther from it than it is."""
    for r in range(max(row - near, 0), min(row + near + 1, distance.shape[0])):
        for c in range(max(column - near, 0), min(column + near + 1, distance.shape[1])):
            distance[r, c] = min(distance[r, c], disc[r - row + near, c - column + near])


@kernel
def cell_costs(label: Bytes, distance: Distances, least: float, comfort: float, wall_cost: float) -> Costs:
    """(H,W) cost of a tenth of a cell: OPEN_COST in the open, more by `wall_cost` times that at `least`; 0: barred.

    `distance` as from `clearance`; `least` and `comfort` in cells. Unknown cells are barred.
    """
    height, width = label.shape
    cost = np.zeros((height, width), np.int32)
    for row in range(height):
        for column in range(width):
            free = label[row, column] == FREE or label[row, column] == DOOR
            if not free or distance[row, column] < least:
                continue
            share = max(comfort - distance[row, column], 0.0) / max(comfort - least, 1e-9)
            cost[row, column] = min(int(OPEN_COST * (1.0 + wall_cost * share * share)), MAX_COST)
    return cost


@kernel
def open_start(cost: Costs, label: Bytes, distance: Distances, row: int, column: int, radius: int) -> None:
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


@kernel
def distance_field(cost: Costs, row: int, column: int) -> tuple[Costs, Costs, Bytes]:
    """Cheapest ways from a cell to all others: cost (H,W), length in tenths of a cell, step that led there (8: none).

    Dijkstra with one bucket a cost (every step costs less than there are buckets), 8 neighbours, no diagonal step past
    a barred cell. FAR where there is no way. The cells on the border of the grid are taken as barred. A bucket is a
    ring of cells, linked both ways and closed by a node of its own; a cell in no bucket is a ring of one.
    """
    cells = cost.size
    total, length = np.full(cells, FAR, np.int32), np.full(cells, FAR, np.int32)
    step = np.full(cells, 8, np.uint8)
    flat, steps = cost.reshape(-1), allowed_steps(cost).reshape(-1)
    offset = DROW * cost.shape[1] + DCOL
    onward, back = np.arange(cells + BUCKETS, dtype=np.int32), np.arange(cells + BUCKETS, dtype=np.int32)
    start = row * cost.shape[1] + column
    total[start], length[start] = 0, 0
    onward[cells], back[cells], onward[start], back[start] = start, start, cells, cells
    at, last = 0, 0
    while at <= last:
        cell = onward[cells + (at & (BUCKETS - 1))]
        if cell >= cells:
            at += 1
            continue
        onward[back[cell]], back[onward[cell]] = onward[cell], back[cell]
        for k in range(8):
            near = cell + offset[k]
            far = at + HALF_LENGTH[k] * (flat[cell] + flat[near])
            if not (steps[cell] >> k) & 1 or far >= total[near]:
                continue
            onward[back[near]], back[onward[near]] = onward[near], back[near]
            node = cells + (far & (BUCKETS - 1))
            onward[near], back[near] = onward[node], node
            back[onward[node]], onward[node] = near, near
            total[near], length[near], step[near] = far, length[cell] + 2 * HALF_LENGTH[k], k
            last = max(last, far)
    return total.reshape(cost.shape), length.reshape(cost.shape), step.reshape(cost.shape)


@kernel
def allowed_steps(cost: Costs) -> Bytes:
    """(H,W) bit k set where step k leads to a passable cell, and past none that is barred; 0 on the border."""
    height, width = cost.shape
    steps = np.zeros((height, width), np.uint8)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if cost[row, column] == 0:
                continue
            bits = 0
            for k in range(8):
                r, c = row + DROW[k], column + DCOL[k]
                inside = 0 < r < height - 1 and 0 < c < width - 1
                bits |= (inside and min(cost[r, c], cost[row, c], cost[r, column]) > 0) << k
            steps[row, column] = bits
    return steps


@kernel
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


@kernel
def nearest_reached(total: Costs, x: float, y: float, reach: float) -> Ints:
    """Row and column (2,) of the reached cell nearest to (x, y), in cells, within `reach`; (-1, -1): none."""
    best, found = math.inf, np.array([-1, -1])
    for row in range(max(math.floor(y - reach), 0), min(math.floor(y + reach) + 1, total.shape[0])):
        for column in range(max(math.floor(x - reach), 0), min(math.floor(x + reach) + 1, total.shape[1])):
            if total[row, column] >= FAR:
                continue
            distance = math.hypot(column + 0.5 - x, row + 0.5 - y) + 1e-9 * total[row, column]
            if distance < min(best, reach):
                best = distance
                found[0], found[1] = row, column
    return found


@kernel
def clear_line(distance: Distances, x0: float, y0: float, x1: float, y1: float, least: float) -> bool:
    """True when every cell on the line between two points, in cells, is `least` or more from walls."""
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    for i in range(n + 1):
        row = math.floor(y0 + (y1 - y0) * i / n)
        column = math.floor(x0 + (x1 - x0) * i / n)
        if not (0 <= row < distance.shape[0] and 0 <= column < distance.shape[1]) or distance[row, column] < least:
            return False
    return True


@kernel
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


@kernel
def _wall_within(label: Bytes, x: float, y: float, near: int, radius: float) -> bool:
    """True when the centre of an OCCUPIED cell lies within `radius` of (x, y), in cells."""
    row, column = math.floor(y), math.floor(x)
    for r in range(max(row - near, 0), min(row + near + 1, label.shape[0])):
        for c in range(max(column - near, 0), min(column + near + 1, label.shape[1])):
            if label[r, c] == OCCUPIED and math.hypot(c + 0.5 - x, r + 0.5 - y) < radius:
                return True
    return False


@kernel
def shorten(points: Array, distance: Distances, cost: Costs, least: float) -> Array:
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


@kernel
def _may_jump(points: Array, distance: Distances, cost: Costs, first: int, last: int, least: float) -> bool:
    """True when the line between two points of a path is clear and passable."""
    x0, y0, x1, y1 = points[first, 0], points[first, 1], points[last, 0], points[last, 1]
    if not clear_line(distance, x0, y0, x1, y1, least):
        return False
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    passable = True
    for i in range(n + 1):
        passable = passable and cost[math.floor(y0 + (y1 - y0) * i / n), math.floor(x0 + (x1 - x0) * i / n)] > 0
    return passable
