"""Search for goals in the grid: frontiers, floor outside polygons, clusters of cells, open edges of polygons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.grid_paths import wall_on_path
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.planning.config import GoalsConfig
from mecp_env.slam.messages import Belief, MapPolygon, SemanticGrid, rows_by_id

Rooms = NDArray[np.int16]
Layer = tuple[Bools, Array, float]
Floor = tuple[Bytes, Array, float]  # labels (H,W), origin and resolution of the grid

UNKNOWN, FREE, OCCUPIED = 0, 1, 2  # as in mecp_env.slam.messages.Cell
BLOCK = 256  # cells that are looked at together
BARRIER_CELLS = 1.5  # floor is not joined this close to the line of a door
DROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
DCOL = np.array([1, 0, -1, 0, 1, -1, -1, 1])
NOWHERE = [math.nan, math.nan]
IDS, INTERVALS = attrgetter("ids"), attrgetter("intervals")


def floor_clusters(grid: SemanticGrid, lines: Array, config: GoalsConfig) -> tuple[Ints, Ints]:
    """Clusters (c,4) of floor outside polygons and of frontiers, as from `clusters`.

    `lines` (d,2,2): doors and candidates, in cells; floor is not joined across one, and goals keep `door_clear_m` from
    the middle of one.
    """
    room = assign_rooms(grid.label, grid.room, lines, BARRIER_CELLS)
    span = max(round(config.uncovered_m / 2 / grid.resolution_m), 1)
    middles, clear = lines.mean(axis=1, keepdims=True).repeat(2, axis=1), config.door_clear_m / grid.resolution_m
    uncovered, frontier = mark_floor(grid.label, grid.polygon, room, span, middles, clear)
    return clusters(uncovered, room, config.uncovered_cells), clusters(frontier, room, config.frontier_cells)


def uncovered_edges(
    polygons: Sequence[MapPolygon],
    belief: Belief,
    grid: SemanticGrid,
    wanted: tuple[int, float, float],
) -> Array:
    """Wide intervals of one label beyond which no polygon lies (e,6): middle x, y, outward normal, width, polygon.

    `wanted`: the EdgeLabel, the least width and the distance from the edge at which another polygon is looked for, m.
    """
    rings, labels = list(map(IDS, polygons)), list(map(INTERVALS, polygons))
    ids = np.concatenate(rings)
    p_map = np.concatenate((belief.p_map, [NOWHERE]))[rows_by_id(belief.ids, ids)[ids]]
    first, rows = (np.array([0, *accumulate(map(len, some))], np.int64) for some in (rings, labels))
    layer = grid.polygon, grid.origin, grid.resolution_m
    edges: Array = _uncovered_edges(p_map, first, np.concatenate(labels), rows, wanted, layer)
    return edges


@compiled
def assign_rooms(label: Bytes, room: Rooms, lines: Array, margin: float) -> Rooms:
    """(H,W) the rooms, also of FREE cells without one (-1) that join the floor of a room, other than across a line.

    `lines` (d,2,2): doors and candidates, in cells; cells within `margin` of one are not passed, nor are DOOR cells.
    What was seen of a room from outside, through its door, has no room: it gets one as soon as the room has floor.
    """
    assigned, barred = room.copy(), near_lines(label.shape, lines, margin)
    loose, owned = np.empty(label.shape, np.bool_), np.empty(label.shape, np.bool_)
    for row in range(label.shape[0]):  # without branches, so that many cells are done at a time
        labels, rooms, bars, no_room, has_room = label[row], room[row], barred[row], loose[row], owned[row]
        for i in range(labels.shape[0]):
            no_room[i] = (labels[i] == FREE) & (rooms[i] < 0) & (not bars[i])
        for i in range(labels.shape[0]):
            has_room[i] = (labels[i] == FREE) & (rooms[i] >= 0)
    first = marked_cells(beside(loose, owned))
    queue = np.empty((label.size + 1, 2), np.int64)
    queue[: first.shape[0]] = first
    size, head = first.shape[0], 0
    for i in range(size):
        assigned[first[i, 0], first[i, 1]] = _room_beside(label, room, first[i, 0], first[i, 1])
    while head < size:
        for k in range(4):
            r, c = queue[head, 0] + DROW[k], queue[head, 1] + DCOL[k]
            inside = 0 < r < label.shape[0] - 1 and 0 < c < label.shape[1] - 1
            if inside and label[r, c] == FREE and assigned[r, c] < 0 and not barred[r, c]:
                assigned[r, c] = _room_beside(label, assigned, r, c)
                queue[size, 0], queue[size, 1] = r, c
                size += 1 if assigned[r, c] >= 0 else 0
        head += 1
    return assigned


@compiled
def _room_beside(label: Bytes, room: Rooms, row: int, column: int) -> int:
    """The room of a FREE neighbour of a cell; -1 without one."""
    beside = -1
    for k in range(4):
        r, c = row + DROW[k], column + DCOL[k]
        if label[r, c] == FREE and room[r, c] >= 0:
            beside = int(room[r, c])
    return beside


@compiled
def near_lines(shape: tuple[int, int], lines: Array, margin: float) -> Bools:
    """(H,W) whether a segment (d,2,2) without nan lies within `margin` of the middle of a cell, in cells."""
    near = np.zeros(shape, np.bool_)
    for i in range(lines.shape[0]):
        x, y, dx, dy = lines[i, 0, 0], lines[i, 0, 1], lines[i, 1, 0] - lines[i, 0, 0], lines[i, 1, 1] - lines[i, 0, 1]
        if not (abs(x) + abs(y) + abs(dx) + abs(dy)) < math.inf:
            continue
        low, high = min(y, y + dy) - margin - 1.0, max(y, y + dy) + margin + 1.0
        left, right = min(x, x + dx) - margin - 1.0, max(x, x + dx) + margin + 1.0
        for row in range(max(math.floor(low), 0), min(math.ceil(high), shape[0])):
            for column in range(max(math.floor(left), 0), min(math.ceil(right), shape[1])):
                px, py = column + 0.5 - x, row + 0.5 - y
                share = min(max((px * dx + py * dy) / max(dx * dx + dy * dy, 1e-9), 0.0), 1.0)
                near[row, column] |= math.hypot(share * dx - px, share * dy - py) < margin
    return near


@compiled
def mark_floor(label: Bytes, polygon: Bools, room: Rooms, span: int, doors: Array, clear: float) -> tuple[Bools, Bools]:
    """(H,W) which FREE cells of a room are uncovered, and which are frontiers.

    All keep `clear` cells from the middles of `doors`, segments (d,2,2) of no length, in cells. Uncovered: no polygon
    covers the cell, nor its eight neighbours `span` cells away, which are FREE. Frontier: beside an UNKNOWN cell.
    """
    (height, width), near = label.shape, near_lines(label.shape, doors, clear)
    bare, asked = np.empty(label.shape, np.bool_), np.empty(label.shape, np.bool_)
    unknown = np.empty(label.shape, np.bool_)
    for row in range(height):  # without branches, so that many cells are done at a time
        labels, covered, rooms, nears = label[row], polygon[row], room[row], near[row]
        uncovered_floor, own, unseen = bare[row], asked[row], unknown[row]
        for i in range(width):
            uncovered_floor[i] = (labels[i] == FREE) & (not covered[i])
        for i in range(width):
            own[i] = (labels[i] == FREE) & (rooms[i] >= 0) & (not nears[i])
        for i in range(width):
            unseen[i] = labels[i] == UNKNOWN
    uncovered, column = np.zeros(label.shape, np.bool_), np.empty(width, np.bool_)
    for row in range(span, height - span):
        before, own, after = bare[row - span], bare[row], bare[row + span]
        for i in range(width):
            column[i] = before[i] & own[i] & after[i]
        wide, wanted = uncovered[row, span : width - span], asked[row, span : width - span]
        left, middle, right = column[: width - 2 * span], column[span : width - span], column[2 * span :]
        for i in range(wide.shape[0]):
            wide[i] = wanted[i] & left[i] & middle[i] & right[i]
    return uncovered, beside(asked, unknown)


@compiled
def beside(mask: Bools, other: Bools) -> Bools:
    """(H,W) the cells of a mask, but for those on the border, that have one of another among their four neighbours."""
    height, width = mask.shape
    found = np.zeros(mask.shape, np.bool_)
    for row in range(1, height - 1):
        own, marked = mask[row, 1 : width - 1], found[row, 1 : width - 1]
        left, right = other[row, : width - 2], other[row, 2:]
        down, up = other[row - 1, 1 : width - 1], other[row + 1, 1 : width - 1]
        for i in range(own.shape[0]):
            marked[i] = own[i] & (left[i] | right[i] | down[i] | up[i])
    return found


@compiled
def marked_cells(mask: Bools) -> Ints:
    """(n,2) row and column of each cell of a mask (H,W) that is set, row by row."""
    cells, flat, width, n = np.empty((mask.size, 2), np.int64), mask.reshape(-1), mask.shape[1], 0
    for first in range(0, flat.shape[0], BLOCK):  # most blocks are empty
        block, some = flat[first : first + BLOCK], False
        for i in range(block.shape[0]):
            some |= block[i]
        for i in range(block.shape[0] if some else 0):
            if block[i]:
                cells[n, 0], cells[n, 1] = (first + i) // width, (first + i) % width
                n += 1
    return cells[:n].copy()


@compiled
def clusters(marked: Bools, room: Rooms, least: int) -> Ints:
    """(c,4) row, column, size and room of the connected clusters (8 neighbours, one room) of `least` cells or more.

    The cell is the one nearest to the middle of its cluster. The mask `marked` (H,W) is used up.
    """
    cells = marked_cells(marked)
    found = np.empty((cells.shape[0], 4), np.int64)
    queue = np.empty((cells.shape[0], 2), np.int64)
    n = 0
    for first in range(cells.shape[0]):
        size, step = 0, 0  # eight steps per cell of the queue, one to each neighbour
        own = room[cells[first, 0], cells[first, 1]]
        if marked[cells[first, 0], cells[first, 1]]:
            queue[0, 0], queue[0, 1] = cells[first, 0], cells[first, 1]
            marked[cells[first, 0], cells[first, 1]] = False
            size = 1
        while step < 8 * size:
            r, c = queue[step >> 3, 0] + DROW[step & 7], queue[step >> 3, 1] + DCOL[step & 7]
            if 0 <= r < marked.shape[0] and 0 <= c < marked.shape[1] and marked[r, c] and room[r, c] == own:
                marked[r, c] = False
                queue[size, 0], queue[size, 1] = r, c
                size += 1
            step += 1
        if size < max(least, 1):
            continue
        row, column, best = queue[:size, 0].mean(), queue[:size, 1].mean(), math.inf
        for i in range(size):
            distance = math.hypot(queue[i, 0] - row, queue[i, 1] - column)
            if distance < best:
                best, found[n, 0], found[n, 1] = distance, queue[i, 0], queue[i, 1]
        found[n, 2], found[n, 3] = size, own
        n += 1
    return found[:n].copy()


@compiled
def _uncovered_edges(
    p_map: Array, first: Ints, interval: Array, rows: Ints, wanted: tuple[int, float, float], layer: Layer
) -> Array:
    """See `uncovered_edges`: a polygon lies beyond where polygons cover two of three points of the strip there.

    The vertices (V,2) m of polygon p start at row first[p], nan: not in the map; its intervals at rows[p], each (m,4):
    edge, start and end as share of it, EdgeLabel. `layer`: the polygons on the grid (H,W), origin, resolution.
    """
    (label, least, beyond), (polygon, origin, resolution) = wanted, layer
    edges = np.empty((interval.shape[0], 6))
    n = 0
    for owner in range(first.shape[0] - 1):
        for i in range(rows[owner], rows[owner + 1]):
            a = first[owner] + int(interval[i, 0])
            b = a + 1 if a + 1 < first[owner + 1] else first[owner]
            dx, dy = p_map[b, 0] - p_map[a, 0], p_map[b, 1] - p_map[a, 1]
            length = math.hypot(dx, dy)
            width = length * (interval[i, 2] - interval[i, 1])
            if interval[i, 3] != label or not width >= least:
                continue
            nx, ny, covered = dy / length, -dx / length, 0
            for k in (0, 2, 1):  # the last is the middle
                share = interval[i, 1] + (interval[i, 2] - interval[i, 1]) * (0.3 + 0.2 * k)
                edges[n, 0], edges[n, 1] = p_map[a, 0] + share * dx, p_map[a, 1] + share * dy
                row = math.floor((edges[n, 1] + beyond * ny - origin[1]) / resolution)
                column = math.floor((edges[n, 0] + beyond * nx - origin[0]) / resolution)
                inside = 0 <= row < polygon.shape[0] and 0 <= column < polygon.shape[1]
                covered += 1 if inside and polygon[row, column] else 0
            edges[n, 2], edges[n, 3], edges[n, 4], edges[n, 5] = nx, ny, width, owner
            n += 1 if covered <= 1 else 0
    return edges[:n].copy()


@compiled
def far_apart(places: Array, apart: float) -> Ints:
    """The rows (k,) of the places (g,2) that are farther than `apart` from each row that was taken before."""
    taken, n = np.empty(places.shape[0], np.int64), 0
    for i in range(places.shape[0]):
        free = True
        for k in range(n):
            free &= math.hypot(places[i, 0] - places[taken[k], 0], places[i, 1] - places[taken[k], 1]) > apart
        if free:
            taken[n] = i
            n += 1
    return taken[:n].copy()


@compiled
def looked_at(
    places: Array, rooms: Ints, scans: tuple[Array, Ints], near: float, field: tuple[float, float], floor: Floor
) -> Bools:
    """(g,) whether a scan was taken within `near` m of each place (g,2), in its room or without a wall between.

    `rooms` (g,); `scans`: poses (n,3) and rooms (n,); `field`: the middle of what they see, from the heading of the
    robot on, and the half of it, rad: what lies behind a laser that does not see all around was not looked at.
    """
    T_map_scans, scan_rooms = scans
    seen, leg, (label, origin, resolution) = np.zeros(places.shape[0], np.bool_), np.empty((2, 2)), floor
    for i in range(places.shape[0]):
        for k in range(T_map_scans.shape[0]):
            dx, dy = places[i, 0] - T_map_scans[k, 0], places[i, 1] - T_map_scans[k, 1]
            if seen[i] or not dx * dx + dy * dy <= near * near:
                continue
            aside = abs(wrap_angle(math.atan2(dy, dx) - T_map_scans[k, 2] - field[0]))
            leg[0], leg[1] = T_map_scans[k, :2], places[i]
            open_to = scan_rooms[k] == rooms[i] or not wall_on_path(label, leg, origin, resolution, resolution)
            seen[i] = aside <= field[1] and open_to
    return seen


def wall_ahead_m(label: Bytes, origin: Array, resolution: float, rays: Array, most: float) -> Array:
    """(e,) how far from the start of each ray (e,4), x, y and unit direction, the first wall is, m; inf beyond `most`.

    It is looked for at every half cell.
    """
    steps = int(2.0 * most / resolution)
    away = most * np.arange(1, steps + 1) / steps
    points = rays[:, None, :2] + away[:, None] * rays[:, None, 2:]
    column, row = np.floor((points - origin) / resolution).astype(np.int64).transpose(2, 0, 1)
    inside = (row >= 0) & (row < label.shape[0]) & (column >= 0) & (column < label.shape[1])
    walled = inside & (label[row * inside, column * inside] == OCCUPIED)
    distance: Array = np.where(walled, away, math.inf).min(axis=1, initial=math.inf)
    return distance
