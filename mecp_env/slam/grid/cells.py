"""Kernels of the semantic grid: polygons filled by cell centres, votes of scans, polygons and doors, what they make.

A cell belongs to a polygon when its centre does: painting is unbiased, whatever the angle between wall and grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.grid.door_sight import door_ends, door_share, looks_through, split_outline

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Layer = NDArray[np.int16]
Bytes = NDArray[np.uint8]
Scan = tuple[Array, Array, Array]  # outline (m,2) of free space, strips (s,4,2) of wall, m, robot frame; pose (3,)

FREE, HITS, COVER, COVER_ROOM, ROOM, DOOR, POCKET = range(7)  # the layers of a grid
UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL, DOOR_CELL = range(4)  # as in mecp_env.slam.messages.Cell
FLOODED, OUTSIDE = 1, 2  # what is known of an unknown cell


class Brush(NamedTuple):
    """What every painting kernel needs: scratch space, where the grid lies on the lattice, and what was touched."""

    mask: Bytes  # (H,W+1) all zero between calls
    lattice: Ints  # (2,) column and row of cell [0, 0] on the lattice of the map frame
    dirty: Ints  # (4,) first row, last row + 1, first column, last column + 1 touched so far
    box: Ints  # (4,) scratch, the same of the last polygon


@compiled
def to_cells(points: Array, T_map_robot: Array, resolution: float) -> Array:
    """Points (n,2) of the robot frame on the lattice (n,2), column and row; cell centres lie at halves."""
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    cells = np.empty_like(points)
    for i in range(points.shape[0]):
        cells[i, 0] = (T_map_robot[0] + c * points[i, 0] - s * points[i, 1]) / resolution
        cells[i, 1] = (T_map_robot[1] + s * points[i, 0] + c * points[i, 1]) / resolution
    return cells


@compiled
def on_grid(cells: Array, lattice: Ints, height: int, width: int) -> bool:
    """True when the points (n,2) of the lattice, and a border of one cell, lie on the grid."""
    for i in range(cells.shape[0]):
        column, row = math.floor(cells[i, 0]) - lattice[0], math.floor(cells[i, 1]) - lattice[1]
        if not (1 <= column < width - 1 and 1 <= row < height - 1):
            return False
    return True


@compiled
def toggle_edges(ring: Array, mask: Bytes, lattice: Ints, box: Ints) -> None:
    """Flip `mask` right of every crossing of the ring's edges with the centre lines of the rows of `box`.

    Crossings are computed on the lattice, not on the grid: a polygon covers the same cells before and after growth.
    """
    width = mask.shape[1] - 1
    for i in range(ring.shape[0]):
        x0, y0, x1, y1 = ring[i - 1, 0], ring[i - 1, 1], ring[i, 0], ring[i, 1]
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first = max(math.ceil(y0 - 0.5), box[0] + lattice[1])
        last = min(math.ceil(y1 - 0.5), box[1] + lattice[1])
        for row in range(first, last):
            x = x0 + (x1 - x0) * (row + 0.5 - y0) / (y1 - y0)
            column = math.ceil(x - 0.5) - lattice[0]
            mask[row - lattice[1], min(max(column, 0), width)] ^= 1


@compiled
def mark(ring: Array, brush: Brush) -> None:
    """Set the mask, zero before, to 1 inside the ring (k,2) of the lattice; the brush's box tells where to look."""
    mask, lattice, box = brush.mask, brush.lattice, brush.box
    height, width = mask.shape[0], mask.shape[1] - 1
    low_x, low_y, high_x, high_y = math.inf, math.inf, -math.inf, -math.inf
    for i in range(ring.shape[0]):
        low_x, high_x = min(low_x, ring[i, 0]), max(high_x, ring[i, 0])
        low_y, high_y = min(low_y, ring[i, 1]), max(high_y, ring[i, 1])
    box[0] = max(math.floor(low_y) - lattice[1], 0)
    box[1] = min(math.floor(high_y) + 1 - lattice[1], height)
    box[2] = max(math.floor(low_x) - lattice[0], 0)
    box[3] = min(math.floor(high_x) + 1 - lattice[0], width)
    toggle_edges(ring, mask, lattice, box)
    for row in range(box[0], box[1]):
        inside = np.uint8(0)
        for column in range(box[2], box[3]):
            inside ^= mask[row, column]
            mask[row, column] = inside
        mask[row, max(box[3], 0)] = 0


@compiled
def widen(brush: Brush) -> None:
    """Let the dirty window contain the brush's box."""
    dirty, box = brush.dirty, brush.box
    dirty[0], dirty[1] = min(dirty[0], box[0]), max(dirty[1], box[1])
    dirty[2], dirty[3] = min(dirty[2], box[2]), max(dirty[3], box[3])


@compiled
def add_polygon(layer: Layer, ring: Array, delta: int, brush: Brush) -> None:
    """Add `delta` to the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            layer[row, column] += np.int16(delta * brush.mask[row, column])
            brush.mask[row, column] = 0
    widen(brush)


@compiled
def set_polygon(layer: Layer, ring: Array, value: int, brush: Brush) -> None:
    """Write `value` into the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            if brush.mask[row, column]:
                layer[row, column] = np.int16(value)
            brush.mask[row, column] = 0
    widen(brush)


@compiled
def paint_scan(layers: Layer, outline: Array, strips: Array, delta: int, brush: Brush) -> None:
    """Vote (or take the vote back): cells inside the outline (m,2) free, cells of the strips (s,4,2) hit; lattice."""
    add_polygon(layers[FREE], outline, delta, brush)
    for i in range(strips.shape[0]):
        add_polygon(layers[HITS], strips[i], delta, brush)


@compiled
def vote_scan(layers: Layer, scan: Scan, resolution: float, delta: int, brush: Brush) -> bool:
    """Cast the votes of a scan (`delta` 1) or take them back (-1); False, and nothing done, where the grid ends."""
    outline, strips = scan_cells(scan, resolution)
    height, width = layers.shape[1], layers.shape[2]
    corners = strips.reshape(4 * strips.shape[0], 2)
    if not (on_grid(outline, brush.lattice, height, width) and on_grid(corners, brush.lattice, height, width)):
        return False
    paint_scan(layers, outline, strips, delta, brush)
    return True


@compiled
def scan_cells(scan: Scan, resolution: float) -> tuple[Array, Array]:
    """Outline (m,2) and strips (s,4,2) of a scan on the lattice."""
    outline, strips, T_map_robot = scan
    corners = to_cells(strips.reshape(4 * strips.shape[0], 2), T_map_robot, resolution)
    return to_cells(outline, T_map_robot, resolution), corners.reshape(strips.shape)


@compiled
def eye_of(scan: Scan, resolution: float) -> Array:
    """(2,) where a scan was taken, on the lattice."""
    eye = np.empty(2)
    eye[0], eye[1] = scan[2][0] / resolution, scan[2][1] / resolution
    return eye


@compiled
def stamp_polygon(layers: Layer, ring: Array, room: int, delta: int, resolution: float, brush: Brush) -> bool:
    """Paint a polygon (k,2) m, map frame, with its room (`delta` 1) or take it off (-1); False where the grid ends."""
    cells = to_cells(ring, np.zeros(3), resolution)
    if not on_grid(cells, brush.lattice, layers.shape[1], layers.shape[2]):
        return False
    add_polygon(layers[COVER], cells, delta, brush)
    if delta > 0:
        set_polygon(layers[COVER_ROOM], cells, room, brush)
    return True


@compiled
def stamp_doors(layers: Layer, quads: Array, delta: int, resolution: float, brush: Brush) -> bool:
    """Paint doors (d,4,2) m, map frame (`delta` 1), or take them off (-1), but those with nan; False: the grid ends."""
    known, corners = np.empty(quads.shape[0], np.bool_), quads.reshape(4 * quads.shape[0], 2)
    cells = to_cells(corners, np.zeros(3), resolution).reshape(quads.shape)
    for i in range(quads.shape[0]):
        known[i] = True
        for k in range(4):
            known[i] = known[i] and math.isfinite(quads[i, k, 0]) and math.isfinite(quads[i, k, 1])
        if known[i] and not on_grid(cells[i], brush.lattice, layers.shape[1], layers.shape[2]):
            return False
    for i in range(quads.shape[0]):
        if known[i]:
            add_polygon(layers[DOOR], cells[i], delta, brush)
    return True


@compiled
def paint_room(layer: Layer, room: int, scan: Scan, doors: Array, resolution: float, brush: Brush) -> None:
    """Write `room` into the cells of a scan, floor and walls, as far as the doors (d,2,2) of the lattice let see."""
    (outline, strips), eye = scan_cells(scan, resolution), eye_of(scan, resolution)
    through = np.zeros(strips.shape[0], np.bool_)
    for i in range(doors.shape[0]):
        if not looks_through(outline, eye, doors[i]):
            continue
        outline = split_outline(outline, eye, doors[i])[0]
        ax, ay, bx, by = door_ends(eye, doors[i])
        for j in range(strips.shape[0]):
            x, y = 0.5 * (strips[j, 0, 0] + strips[j, 1, 0]), 0.5 * (strips[j, 0, 1] + strips[j, 1, 1])
            through[j] |= door_share(ax, ay, bx, by, x - eye[0], y - eye[1]) < 1.0
    set_polygon(layer, outline, room, brush)
    for j in range(strips.shape[0]):
        if not through[j]:
            set_polygon(layer, strips[j], room, brush)


@compiled
def forget_room(layer: Layer, room: int, scan: Scan, doors: Array, resolution: float, brush: Brush) -> None:
    """Take `room` off the cells that a scan saw through doors (d,2,2) which were not known when it was painted."""
    outline, eye = to_cells(scan[0], scan[2], resolution), eye_of(scan, resolution)
    for i in range(doors.shape[0]):
        if looks_through(outline, eye, doors[i]):
            replace_room(layer, room, split_outline(outline, eye, doors[i])[1], brush)


@compiled
def replace_room(layer: Layer, room: int, ring: Array, brush: Brush) -> None:
    """Take `room` off the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            if brush.mask[row, column] and layer[row, column] == room:
                layer[row, column] = np.int16(-1)
            brush.mask[row, column] = 0
    widen(brush)


@compiled
def compose(layers: Layer, occupied_ratio: float, label: Bytes, polygon: Bools, room: Layer, dirty: Ints) -> int:
    """Bring the published arrays up to date inside the window `dirty`; returns how many cells changed."""
    changed = 0
    left, right = max(dirty[2], 0), min(dirty[3], label.shape[1])
    for row in range(max(dirty[0], 0), min(dirty[1], label.shape[0])):
        hits, free = layers[HITS, row, left:right], layers[FREE, row, left:right]
        door, pocket = layers[DOOR, row, left:right], layers[POCKET, row, left:right]
        cover, cover_room, own_room = layers[COVER, row], layers[COVER_ROOM, row], layers[ROOM, row]
        labels, rooms = label[row, left:right], room[row, left:right]
        for i in range(right - left):
            value = cell_label(hits[i], free[i], door[i], pocket[i], occupied_ratio)
            covered = cover[left + i] > 0
            owner = cover_room[left + i] if covered else own_room[left + i]
            owner = owner if value != UNKNOWN_CELL else np.int16(-1)
            changed += (labels[i] != value) | (polygon[row, left + i] != covered) | (rooms[i] != owner)
            labels[i], polygon[row, left + i], rooms[i] = value, covered, owner
    return changed


@compiled
def cell_label(hits: int, free: int, door: int, pocket: int, occupied_ratio: float) -> int:
    """What the votes make of a cell; without branches, so that it is done for many cells at a time."""
    occupied = (hits > 0) & ((free == 0) | (hits >= occupied_ratio * (free + hits)))
    unseen = OCCUPIED_CELL if pocket > 0 else UNKNOWN_CELL
    seen = OCCUPIED_CELL if occupied else (FREE_CELL if free > 0 else unseen)
    return DOOR_CELL if door > 0 else seen


@compiled
def find_pockets(label: Bytes, room: Layer, complete: Bools, pocket: Layer) -> None:
    """Write 1 into `pocket` at unknown cells that only the walls and the floor of completed rooms surround, else 0.

    A component of unknown cells is a pocket when it does not reach the border of the grid, touches no door and touches
    cells of one room only, and that room is complete (`complete` (r,) by room id).
    """
    height, width = label.shape
    queue = np.empty((height * width, 2), np.int64)
    state = mark_outside(label)
    pocket[:, :] = 0
    for row in range(height):
        for column in range(width):
            if label[row, column] != UNKNOWN_CELL or state[row, column]:
                continue
            size, owner = flood_unknown(label, room, state, queue, row, column)
            if 0 <= owner < complete.shape[0] and complete[owner]:
                set_cells(pocket, queue, size)


@compiled
def set_cells(layer: Layer, cells: Ints, count: int) -> None:
    """Write 1 into the first `count` cells (n,2), row and column, of the layer."""
    for i in range(count):
        layer[cells[i, 0], cells[i, 1]] = np.int16(1)


@compiled
def mark_outside(label: Bytes) -> Bytes:
    """(H,W) OUTSIDE at unknown cells that join the border of the grid, most of them in two sweeps; else 0."""
    height, width = label.shape
    state = np.zeros((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            border = row == 0 or column == 0 or row == height - 1 or column == width - 1
            joined = border or state[row - 1, column] == OUTSIDE or state[row, column - 1] == OUTSIDE
            if joined and label[row, column] == UNKNOWN_CELL:
                state[row, column] = OUTSIDE
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            row, column = height - 1 - i, width - 1 - j
            joined = state[row + 1, column] == OUTSIDE or state[row, column + 1] == OUTSIDE
            if joined and label[row, column] == UNKNOWN_CELL:
                state[row, column] = OUTSIDE
    return state


@compiled
def flood_unknown(label: Bytes, room: Layer, state: Bytes, queue: Ints, row: int, column: int) -> tuple[int, int]:
    """Size of the unknown component around a cell (its cells in `queue`) and the one room around it (-2: not one).

    `state` (H,W) is OUTSIDE on the border of the grid wherever that is unknown.
    """
    queue[0, 0], queue[0, 1] = row, column
    state[row, column] = FLOODED
    size, head, owner = 1, 0, -1
    while head < size:
        r, c = queue[head, 0], queue[head, 1]
        head += 1
        for k in range(4):
            nr, nc = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
            unknown = label[nr, nc] == UNKNOWN_CELL
            if unknown and not state[nr, nc]:
                state[nr, nc] = FLOODED
                queue[size, 0], queue[size, 1] = nr, nc
                size += 1
            elif label[nr, nc] == DOOR_CELL or state[nr, nc] == OUTSIDE:
                owner = -2
            elif not unknown and room[nr, nc] >= 0 and owner != room[nr, nc]:
                owner = int(room[nr, nc]) if owner == -1 else -2
    return size, owner
