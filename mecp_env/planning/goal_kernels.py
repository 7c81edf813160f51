"""Kernels that look for goals: frontiers, bare floor, clusters of cells, strips beyond open edges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rooms = NDArray[np.int16]

UNKNOWN, FREE = 0, 1  # as in mecp_env.slam.data.Cell
OPEN_LABEL = 2  # as in mecp_env.slam.data.EdgeLabel
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])


@kernel
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


@kernel
def _room_beside(label: Bytes, room: Rooms, lines: Array, margin: float, row: int, column: int) -> int:
    """The room of a FREE neighbour of a cell; -1 without one, and for a cell near a line."""
    beside = -1
    for k in range(4):
        r, c = row + DROW[k], column + DCOL[k]
        if label[r, c] == FREE and room[r, c] >= 0:
            beside = int(room[r, c])
    return -1 if beside >= 0 and _near_line(lines, column + 0.5, row + 0.5, margin) else beside


@kernel
def _near_line(lines: Array, x: float, y: float, margin: float) -> bool:
    """True when one of the segments (d,2,2) lies within `margin` of (x, y)."""
    near = False
    for i in range(lines.shape[0]):
        dx, dy = lines[i, 1, 0] - lines[i, 0, 0], lines[i, 1, 1] - lines[i, 0, 1]
        share = ((x - lines[i, 0, 0]) * dx + (y - lines[i, 0, 1]) * dy) / max(dx * dx + dy * dy, 1e-9)
        share = min(max(share, 0.0), 1.0)
        near = near or math.hypot(lines[i, 0, 0] + share * dx - x, lines[i, 0, 1] + share * dy - y) < margin
    return near


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
def bare_cells(grid: tuple[Bytes, Bools, Rooms], span: int, doors: Array, clear: float) -> tuple[Bytes, Ints]:
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
def uncovered(polygon: Bools, strips: Array, origin: Array, resolution: float) -> Bools:
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
