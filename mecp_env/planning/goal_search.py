"""Compiled functions that find goals: frontiers, floor outside polygons, clusters of cells, open edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rooms = NDArray[np.int16]
Layer = tuple[Bools, Array, float]
Labels = tuple[Bytes, Array, float]

UNKNOWN, FREE, OCCUPIED = 0, 1, 2  # as in mecp_env.slam.messages.Cell
SPARE = 1e-6  # what is farther away by this needs no exact look
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@compiled
def floor_clusters(
    layers: tuple[Bytes, Bools, Rooms], lines: Array, clear: tuple[float, float], sizes: tuple[int, int, int]
) -> tuple[Ints, Ints]:
    """Clusters (c,4) of floor outside polygons and of frontiers, as from `clusters`.

    `layers`: label, polygon and room of the grid. `lines` (d,2,2): doors and candidates, in cells. `clear`: how far
    floor keeps from a line not to be joined across it, and goals from the middle of one, in cells. `sizes`: span of
    `uncovered_cells`, the least cluster of uncovered cells and of frontier cells.
    """
    label, polygon, room = layers
    adopted = adopt_rooms(label, room, lines, clear[0])
    middles = np.empty((lines.shape[0], 2))
    for i in range(lines.shape[0]):
        middles[i, 0] = (lines[i, 0, 0] + lines[i, 1, 0]) / 2.0
        middles[i, 1] = (lines[i, 0, 1] + lines[i, 1, 1]) / 2.0
    uncovered, bare_at = uncovered_cells((label, polygon, adopted), sizes[0], middles, clear[1])
    frontier, frontier_at = frontier_cells(label, adopted, middles, clear[1])
    return clusters(uncovered, bare_at, adopted, sizes[1]), clusters(frontier, frontier_at, adopted, sizes[2])


@compiled
def adopt_rooms(label: Bytes, room: Rooms, lines: Array, margin: float) -> Rooms:
    """(H,W) the rooms, also of FREE cells without one (-1) that join the floor of a room, other than across a line.

    `lines` (d,2,2): doors and candidates, in cells; cells within `margin` of one are not passed, nor are DOOR cells.
    What was seen of a room from outside, through its door, has no room: it gets one as soon as the room has floor.
    """
    adopted = room.copy()
    queue = np.empty((label.size + 1, 2), np.int64)
    size, head = 0, 0
    for row in range(1, label.shape[0] - 1):
        for column in range(1, label.shape[1] - 1):
            if label[row, column] == FREE and room[row, column] < 0:
                adopted[row, column] = _room_beside(label, room, lines, margin, row, column)
                queue[size, 0], queue[size, 1] = row, column
                size += 1 if adopted[row, column] >= 0 else 0
    while head < size:
        for k in range(4):
            r, c = queue[head, 0] + DROW[k], queue[head, 1] + DCOL[k]
            inside = 0 < r < label.shape[0] - 1 and 0 < c < label.shape[1] - 1
            if inside and label[r, c] == FREE and adopted[r, c] < 0:
                adopted[r, c] = _room_beside(label, adopted, lines, margin, r, c)
                queue[size, 0], queue[size, 1] = r, c
                size += 1 if adopted[r, c] >= 0 else 0
        head += 1
    return adopted


@compiled
def _room_beside(label: Bytes, room: Rooms, lines: Array, margin: float, row: int, column: int) -> int:
    """The room of a FREE neighbour of a cell; -1 without one, and for a cell near a line."""
    beside = -1
    for k in range(4):
        r, c = row + DROW[k], column + DCOL[k]
        if label[r, c] == FREE and room[r, c] >= 0:
            beside = int(room[r, c])
    return -1 if beside >= 0 and _near_line(lines, column + 0.5, row + 0.5, margin) else beside


@compiled
def _near_line(lines: Array, x: float, y: float, margin: float) -> bool:
    """True when one of the segments (d,2,2) lies within `margin` of (x, y)."""
    for i in range(lines.shape[0]):
        dx, dy = lines[i, 1, 0] - lines[i, 0, 0], lines[i, 1, 1] - lines[i, 0, 1]
        far = margin + SPARE + 0.5 * (abs(dx) + abs(dy))
        if abs(lines[i, 0, 0] + 0.5 * dx - x) > far or abs(lines[i, 0, 1] + 0.5 * dy - y) > far:
            continue
        share = ((x - lines[i, 0, 0]) * dx + (y - lines[i, 0, 1]) * dy) / max(dx * dx + dy * dy, 1e-9)
        share = min(max(share, 0.0), 1.0)
        if math.hypot(lines[i, 0, 0] + share * dx - x, lines[i, 0, 1] + share * dy - y) < margin:
            return True
    return False


@compiled
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


@compiled
def uncovered_cells(grid: tuple[Bytes, Bools, Rooms], span: int, doors: Array, clear: float) -> tuple[Bytes, Ints]:
    """(H,W) 1 at FREE cells of a room that no polygon covers, nor its neighbours `span` cells away; and where (n,2).

    `grid`: label, polygon and room; not within `clear` of the doors' middles (d,2), in cells.
    """
    label, polygon, room = grid
    uncovered = np.zeros(label.shape, np.uint8)
    cells = np.empty((label.size, 2), np.int64)
    n = 0
    for row in range(span, label.shape[0] - span):
        for column in range(span, label.shape[1] - span):
            if polygon[row, column] or label[row, column] != FREE or room[row, column] < 0:
                continue
            wide = _is_uncovered(label, polygon, span, row, column)
            wide = wide and not _near_any(doors, column + 0.5, row + 0.5, clear)
            if wide:
                uncovered[row, column] = 1
                cells[n, 0], cells[n, 1] = row, column
                n += 1
    return uncovered, cells[:n].copy()


@compiled
def _is_uncovered(label: Bytes, polygon: Bools, span: int, row: int, column: int) -> bool:
    """True when the eight cells `span` away from a cell are FREE, and no polygon covers one."""
    for k in range(8):
        r, c = row + span * DROW[k], column + span * DCOL[k]
        if label[r, c] != FREE or polygon[r, c]:
            return False
    return True


@compiled
def _near_any(points: Array, x: float, y: float, clear: float) -> bool:
    """True when one of the points (d,2) lies within `clear` of (x, y)."""
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        if max(abs(dx), abs(dy)) < clear + SPARE and math.hypot(dx, dy) < clear:
            return True
    return False


@compiled
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


@compiled
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


@compiled
def uncovered_intervals(
    rings: tuple[Array, Ints], intervals: tuple[Array, Ints], limits: tuple[int, float, float], layer: Layer
) -> Array:
    """Wide intervals of one label beyond which no polygon lies (s,6): middle x, y, outward normal, width, polygon.

    Nothing lies there where polygons cover two of three points of the strip beyond the interval. `rings`: the vertices
    (V,2) m of all polygons, polygon p from row first[p] to first[p + 1], nan: not in the map. `intervals`: edge, start
    and end as share of it, EdgeLabel (m,4), and the rows of each polygon likewise. `limits`: the label, the least
    width, and how far beyond the edge the strip lies, m. `layer`: the polygons on the grid (H,W), origin, resolution.
    """
    (p_map, first), (stretch, rows), (label, least, beyond) = rings, intervals, limits
    edges = np.empty((stretch.shape[0], 6))
    n = 0
    for owner in range(first.shape[0] - 1):
        for i in range(rows[owner], rows[owner + 1]):
            a = first[owner] + int(stretch[i, 0])
            b = a + 1 if a + 1 < first[owner + 1] else first[owner]
            dx, dy = p_map[b, 0] - p_map[a, 0], p_map[b, 1] - p_map[a, 1]
            length = math.hypot(dx, dy)
            width = length * (stretch[i, 2] - stretch[i, 1])
            if stretch[i, 3] != label or not width >= least:
                continue
            nx, ny, covered = dy / length, -dx / length, 0
            for k in (0, 2, 1):  # the last is the middle
                share = stretch[i, 1] + (stretch[i, 2] - stretch[i, 1]) * (0.3 + 0.2 * k)
                edges[n, 0], edges[n, 1] = p_map[a, 0] + share * dx, p_map[a, 1] + share * dy
                covered += _is_covered(layer, edges[n, 0] + beyond * nx, edges[n, 1] + beyond * ny)
            edges[n, 2], edges[n, 3], edges[n, 4], edges[n, 5] = nx, ny, width, owner
            n += 1 if covered <= 1 else 0
    return edges[:n].copy()


@compiled
def _is_covered(layer: Layer, x: float, y: float) -> int:
    """1 where a polygon covers the cell at (x, y), else 0."""
    polygon, origin, resolution = layer
    row, column = math.floor((y - origin[1]) / resolution), math.floor((x - origin[0]) / resolution)
    inside = 0 <= row < polygon.shape[0] and 0 <= column < polygon.shape[1]
    return 1 if inside and polygon[row, column] else 0


@compiled
def before_wall(layer: Labels, edges: Array, depth: float) -> Bools:
    """(s,) whether a wall lies within `depth` (m) behind the middle of each strip (s,6) of `uncovered_intervals`.

    `layer`: the labels of the grid (H,W), its origin and resolution.
    """
    label, origin, resolution = layer
    walled = np.zeros(edges.shape[0], np.bool_)
    steps = int(2.0 * depth / resolution)
    for i in range(edges.shape[0]):
        for k in range(1, steps + 1):
            x, y = edges[i, 0] + depth * k / steps * edges[i, 2], edges[i, 1] + depth * k / steps * edges[i, 3]
            row, column = math.floor((y - origin[1]) / resolution), math.floor((x - origin[0]) / resolution)
            inside = 0 <= row < label.shape[0] and 0 <= column < label.shape[1]
            walled[i] |= inside and label[row, column] == OCCUPIED
    return walled
