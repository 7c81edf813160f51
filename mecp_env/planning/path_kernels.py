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
Rooms = NDArray[np.int16]
Bytes = NDArray[np.uint8]

UNKNOWN, FREE, OCCUPIED, DOOR = 0, 1, 2, 3  # as in mecp_env.slam.data.Cell
HALF_LENGTH = np.array([5, 5, 5, 5, 7, 7, 7, 7])  # of the steps, in tenths of a cell
OPEN_COST = 10  # of a tenth of a cell far from walls; more near them
MAX_COST = 250
FAR = 2**30
OPEN_LABEL = 2  # as in mecp_env.slam.data.EdgeLabel
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


@kernel
def frontier_cells(label: Bytes, room: Rooms, doors: Array, clear: float) -> tuple[Bytes, Ints]:
    """(H,W) 1 at FREE cells of a room beside UNKNOWN ones, not within `clear` of the doors' middles (d,2), in cells.

    Also where they are (n,2), row and column.
    """
    height, width = label.shape
    frontier = np.zeros((height, width), np.uint8)
    cells = np.empty((height * width, 2), np.int64)
    n = 0
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if label[row, column] != FREE or room[row, column] < 0:
                continue
            beside = min(label[row - 1, column], label[row + 1, column], label[row, column - 1], label[row, column + 1])
            if beside != UNKNOWN or _near_any(doors, column + 0.5, row + 0.5, clear):
                continue
            frontier[row, column] = 1
            cells[n, 0], cells[n, 1] = row, column
            n += 1
    return frontier, cells[:n].copy()


@kernel
def bare_cells(
    grid: tuple[Bytes, NDArray[np.bool_], Rooms], span: int, doors: Array, clear: float
) -> tuple[Bytes, Ints]:
    """(H,W) 1 at FREE cells of a room that no polygon covers, nor its neighbours `span` cells away; and where (n,2).

    `grid`: label, polygon and room; not within `clear` of the doors' middles (d,2), in cells.
    """
    label, polygon, room = grid
    bare = np.zeros(label.shape, np.uint8)
    cells = np.empty((label.size, 2), np.int64)
    n = 0
    for row in range(span, label.shape[0] - span):
        for column in range(span, label.shape[1] - span):
            if polygon[row, column] or label[row, column] != FREE or room[row, column] < 0:
                continue
            wide = not _near_any(doors, column + 0.5, row + 0.5, clear)
            for k in range(8):
                r, c = row + span * DROW[k], column + span * DCOL[k]
                wide = wide and label[r, c] == FREE and not polygon[r, c]
            if wide:
                bare[row, column] = 1
                cells[n, 0], cells[n, 1] = row, column
                n += 1
    return bare, cells[:n].copy()


@kernel
def _near_any(points: Array, x: float, y: float, clear: float) -> bool:
    """True when one of the points (d,2) lies within `clear` of (x, y)."""
    near = False
    for i in range(points.shape[0]):
        near = near or math.hypot(points[i, 0] - x, points[i, 1] - y) < clear
    return near


@kernel
def clusters(marked: Bytes, cells: Ints, room: Rooms, least: int) -> Ints:
    """(c,4) row, column, size and room of the connected clusters (8 neighbours, one room) of `least` cells or more.

    The cell is the one nearest to the middle of its cluster. `marked`, whose `cells` (n,2) are set, is used up.
    """
    found = np.empty((cells.shape[0], 4), np.int64)
    queue = np.empty((cells.shape[0], 2), np.int64)
    n = 0
    for first in range(cells.shape[0]):
        if not marked[cells[first, 0], cells[first, 1]]:
            continue
        size = _collect(marked, room, queue, cells[first, 0], cells[first, 1])
        if size < least:
            continue
        row, column, best = queue[:size, 0].mean(), queue[:size, 1].mean(), math.inf
        for i in range(size):
            distance = math.hypot(queue[i, 0] - row, queue[i, 1] - column)
            if distance < best:
                best, found[n, 0], found[n, 1] = distance, queue[i, 0], queue[i, 1]
        found[n, 2], found[n, 3] = size, room[queue[0, 0], queue[0, 1]]
        n += 1
    return found[:n].copy()


@kernel
def _collect(marked: Bytes, room: Rooms, queue: Ints, row: int, column: int) -> int:
    """Take the cluster around a cell out of `marked` into `queue`; returns its size."""
    queue[0, 0], queue[0, 1] = row, column
    marked[row, column] = 0
    size, head = 1, 0
    while head < size:
        for k in range(8):
            nr, nc = queue[head, 0] + DROW[k], queue[head, 1] + DCOL[k]
            inside = 0 <= nr < marked.shape[0] and 0 <= nc < marked.shape[1]
            if inside and marked[nr, nc] and room[nr, nc] == room[row, column]:
                marked[nr, nc] = 0
                queue[size, 0], queue[size, 1] = nr, nc
                size += 1
        head += 1
    return size


@kernel
def open_strips(rings: Array, first: Ints, intervals: Array, owner: Ints, limits: Array) -> Array:
    """Strips (s,8) beyond wide open intervals: three points x, y, the width, and which polygon; in metres.

    `rings` (V,2): the vertices of all polygons, polygon p from first[p] to first[p + 1]; nan: not in the map.
    `intervals` (m,4) of the polygons `owner` (m,): edge, start and end as share of it, EdgeLabel. `limits` (2,): least
    width, and how far beyond the edge the strip lies.
    """
    strips = np.empty((intervals.shape[0], 8))
    n = 0
    for i in range(intervals.shape[0]):
        begin, end = first[owner[i]], first[owner[i] + 1]
        a = begin + int(intervals[i, 0])
        b = a + 1 if a + 1 < end else begin
        dx, dy = rings[b, 0] - rings[a, 0], rings[b, 1] - rings[a, 1]
        length = math.hypot(dx, dy)
        width = length * (intervals[i, 2] - intervals[i, 1])
        if intervals[i, 3] != OPEN_LABEL or not width >= limits[0]:
            continue
        for k in range(3):
            share = intervals[i, 1] + (intervals[i, 2] - intervals[i, 1]) * (0.3 + 0.2 * k)
            strips[n, 2 * k] = rings[a, 0] + share * dx + limits[1] * dy / length
            strips[n, 2 * k + 1] = rings[a, 1] + share * dy - limits[1] * dx / length
        strips[n, 6], strips[n, 7] = width, owner[i]
        n += 1
    return strips[:n].copy()


@kernel
def uncovered(polygon: NDArray[np.bool_], strips: Array, origin: Array, resolution: float) -> NDArray[np.bool_]:
    """(s,) True where polygons cover at most one of the three points of a strip (s,8), as from `open_strips`."""
    free = np.empty(strips.shape[0], np.bool_)
    for i in range(strips.shape[0]):
        count = 0
        for k in range(3):
            row = math.floor((strips[i, 2 * k + 1] - origin[1]) / resolution)
            column = math.floor((strips[i, 2 * k] - origin[0]) / resolution)
            inside = 0 <= row < polygon.shape[0] and 0 <= column < polygon.shape[1]
            count += 1 if inside and polygon[row, column] else 0
        free[i] = count <= 1
    return free
