"""Kernels of the grid planner: clearance, cost of cells, distance field, shortcuts. Grids are indexed [row, column]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Costs = NDArray[np.int32]
Bytes = NDArray[np.uint8]

FREE, OCCUPIED, DOOR = 1, 2, 3  # as in mecp_env.slam.data.Cell
STRAIGHT, DIAGONAL = 10, 14  # lengths of steps, in tenths of a cell
OPEN_COST = 10  # of a tenth of a cell far from walls; more near them
MAX_COST = 250
FAR = 2**30
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@kernel
def clearance(label: Bytes, reach: int) -> Costs:
    """(H,W) distance of each cell to the nearest OCCUPIED one, in fifths of a cell, up to `reach`.

    Two chamfer passes with steps 5, 7, 11: within 2 % of the Euclidean distance.
    """
    height, width = label.shape
    distance = np.full((height, width), reach, np.int32)
    for turn in range(2):
        sign = 1 if turn == 0 else -1
        for i in range(height):
            row = i if turn == 0 else height - 1 - i
            for j in range(width):
                column = j if turn == 0 else width - 1 - j
                distance[row, column] = _nearer(label, distance, row, column, sign)
    return distance


@kernel
def _nearer(label: Bytes, distance: Costs, row: int, column: int, sign: int) -> int:
    """The chamfer distance of one cell from those already passed."""
    if label[row, column] == OCCUPIED:
        return 0
    height, width = label.shape
    best = distance[row, column]
    up, up2, left, right = row - sign, row - 2 * sign, column - sign, column + sign
    row_in, left_in, right_in = 0 <= up < height, 0 <= left < width, 0 <= right < width
    if left_in:
        best = min(best, distance[row, left] + 5)
    if row_in:
        best = min(best, distance[up, column] + 5)
        if left_in:
            best = min(best, distance[up, left] + 7)
        if right_in:
            best = min(best, distance[up, right] + 7)
        if 0 <= column - 2 < width:
            best = min(best, distance[up, column - 2] + 11)
        if 0 <= column + 2 < width:
            best = min(best, distance[up, column + 2] + 11)
    if 0 <= up2 < height:
        if left_in:
            best = min(best, distance[up2, left] + 11)
        if right_in:
            best = min(best, distance[up2, right] + 11)
    return int(best)


@kernel
def cell_costs(label: Bytes, distance: Costs, least: float, comfort: float, wall_cost: float) -> Costs:
    """(H,W) cost of a tenth of a cell: OPEN_COST in the open, more by `wall_cost` times that at `least`; 0: barred.

    `distance` as from `clearance`; `least` and `comfort` in its unit. Unknown cells are barred.
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
def open_start(cost: Costs, label: Bytes, distance: Costs, row: int, column: int, radius: int) -> None:
    """Let a robot that stands too near to a wall out: over cells near it that are no nearer to walls than it is."""
    if cost[row, column] > 0:
        return
    cost[row, column] = MAX_COST
    for r in range(max(row - radius, 0), min(row + radius + 1, cost.shape[0])):
        for c in range(max(column - radius, 0), min(column + radius + 1, cost.shape[1])):
            near = (r - row) ** 2 + (c - column) ** 2 <= radius * radius
            free = label[r, c] == FREE or label[r, c] == DOOR
            if near and free and cost[r, c] == 0 and distance[r, c] >= distance[row, column]:
                cost[r, c] = MAX_COST


@kernel
def distance_field(cost: Costs, row: int, column: int) -> tuple[Costs, Costs, Bytes]:
    """Cheapest ways from a cell to all others: cost (H,W), length in tenths of a cell, step that led there (8: none).

    Dijkstra with one bucket a cost (all steps cost less than the number of buckets), 8 neighbours, no diagonal step
    past a barred cell. FAR where there is no way.
    """
    height, width = cost.shape
    count = DIAGONAL * MAX_COST + 1
    total = np.full((height, width), FAR, np.int32)
    length = np.full((height, width), FAR, np.int32)
    step = np.full((height, width), 8, np.uint8)
    head = np.full(count, -1, np.int64)
    entry_cell, entry_next, entry_cost, used = _entries(8 * height * width)
    total[row, column], length[row, column] = 0, 0
    entry_cell[0], entry_next[0], entry_cost[0], used = row * width + column, -1, 0, 1
    head[0], waiting, at = 0, 1, 0
    while waiting > 0:
        while head[at % count] < 0:
            at += 1
        entry = head[at % count]
        head[at % count] = entry_next[entry]
        waiting -= 1
        r, c = entry_cell[entry] // width, entry_cell[entry] % width
        if total[r, c] < entry_cost[entry]:
            continue
        for k in range(8):
            far = _step_cost(cost, r, c, k)
            if far == 0 or total[r, c] + far >= total[r + DROW[k], c + DCOL[k]]:
                continue
            nr, nc = r + DROW[k], c + DCOL[k]
            total[nr, nc] = total[r, c] + far
            length[nr, nc] = length[r, c] + (STRAIGHT if k < 4 else DIAGONAL)
            step[nr, nc] = k
            bucket = total[nr, nc] % count
            entry_cell[used], entry_next[used], entry_cost[used] = nr * width + nc, head[bucket], total[nr, nc]
            head[bucket] = used
            used += 1
            waiting += 1
    return total, length, step


@kernel
def _entries(count: int) -> tuple[Ints, Ints, Ints, int]:
    """Room for the entries of the buckets: cell, next of the bucket, cost; none used yet."""
    return np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64), 0


@kernel
def _step_cost(cost: Costs, row: int, column: int, k: int) -> int:
    """Cost of step k from a cell, 0 when it is barred: the mean of the two cells, times the length."""
    nr, nc = row + DROW[k], column + DCOL[k]
    if not (0 <= nr < cost.shape[0] and 0 <= nc < cost.shape[1]) or cost[nr, nc] == 0:
        return 0
    if k >= 4 and (cost[row, nc] == 0 or cost[nr, column] == 0):
        return 0
    return int((STRAIGHT if k < 4 else DIAGONAL) * (cost[row, column] + cost[nr, nc]) // 2)


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
def clear_line(distance: Costs, x0: float, y0: float, x1: float, y1: float, least: float) -> bool:
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
def shorten(points: Array, distance: Costs, cost: Costs, least: float) -> Array:
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
def _may_jump(points: Array, distance: Costs, cost: Costs, first: int, last: int, least: float) -> bool:
    """True when the line between two points of a path is clear and passable."""
    x0, y0, x1, y1 = points[first, 0], points[first, 1], points[last, 0], points[last, 1]
    if not clear_line(distance, x0, y0, x1, y1, least):
        return False
    n = int(math.hypot(x1 - x0, y1 - y0) * 2.0) + 1
    passable = True
    for i in range(n + 1):
        passable = passable and cost[math.floor(y0 + (y1 - y0) * i / n), math.floor(x0 + (x1 - x0) * i / n)] > 0
    return passable


@kernel
def frontier_cells(label: Bytes, room: NDArray[np.int16], doors: Array, clear: float) -> Bytes:
    """(H,W) 1 at FREE cells of a room beside UNKNOWN ones, not within `clear` of the doors' middles (d,2); in cells."""
    height, width = label.shape
    frontier = np.zeros((height, width), np.uint8)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if label[row, column] != FREE or room[row, column] < 0:
                continue
            unknown = label[row - 1, column] == 0 or label[row + 1, column] == 0
            if not (unknown or label[row, column - 1] == 0 or label[row, column + 1] == 0):
                continue
            near = False
            for i in range(doors.shape[0]):
                near = near or math.hypot(doors[i, 0] - column - 0.5, doors[i, 1] - row - 0.5) < clear
            frontier[row, column] = np.uint8(0 if near else 1)
    return frontier


@kernel
def frontier_clusters(frontier: Bytes, room: NDArray[np.int16], least: int) -> Ints:
    """(c,4) row, column, size and room of the connected frontiers (8 neighbours, one room) of `least` cells or more.

    The cell is the one nearest to the middle of its frontier. `frontier` is used up.
    """
    height, width = frontier.shape
    found = np.empty((height * width // max(least, 1) + 1, 4), np.int64)
    queue = np.empty((height * width, 2), np.int64)
    n = 0
    for cell in range(height * width):
        if not frontier[cell // width, cell % width]:
            continue
        size = _collect(frontier, room, queue, cell // width, cell % width)
        if size < least:
            continue
        row, column, best = 0.0, 0.0, math.inf
        for i in range(size):
            row += queue[i, 0] / size
            column += queue[i, 1] / size
        for i in range(size):
            distance = math.hypot(queue[i, 0] - row, queue[i, 1] - column)
            if distance < best:
                best, found[n, 0], found[n, 1] = distance, queue[i, 0], queue[i, 1]
        found[n, 2], found[n, 3] = size, room[queue[0, 0], queue[0, 1]]
        n += 1
    return found[:n].copy()


@kernel
def _collect(frontier: Bytes, room: NDArray[np.int16], queue: Ints, row: int, column: int) -> int:
    """Take the frontier around a cell out of `frontier` into `queue`; returns its size."""
    queue[0, 0], queue[0, 1] = row, column
    frontier[row, column] = 0
    size, head = 1, 0
    while head < size:
        for k in range(8):
            nr, nc = queue[head, 0] + DROW[k], queue[head, 1] + DCOL[k]
            inside = 0 <= nr < frontier.shape[0] and 0 <= nc < frontier.shape[1]
            if inside and frontier[nr, nc] and room[nr, nc] == room[row, column]:
                frontier[nr, nc] = 0
                queue[size, 0], queue[size, 1] = nr, nc
                size += 1
        head += 1
    return size
