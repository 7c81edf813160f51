"""Kernels of the semantic grid: polygons filled by cell centres, the outline of a scan, doors that cut a room.

A cell belongs to a polygon when its centre does: painting is unbiased, whatever the angle between wall and grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Layer = NDArray[np.int16]
Bytes = NDArray[np.uint8]

FREE, HITS, COVER, COVER_ROOM, ROOM, DOOR, POCKET = range(7)  # the layers of a grid
UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL, DOOR_CELL = range(4)  # as in mecp_env.slam.data.Cell


class Brush(NamedTuple):
    """What every painting kernel needs: scratch space, where the grid lies on the lattice, and what was touched."""

    mask: Bytes  # (H,W+1) all zero between calls
    lattice: Ints  # (2,) column and row of cell [0, 0] on the lattice of the map frame
    dirty: Ints  # (4,) first row, last row + 1, first column, last column + 1 touched so far
    box: Ints  # (4,) scratch, the same of the last polygon


@kernel
def to_cells(points: Array, T_map_robot: Array, resolution: float) -> Array:
    """Points (n,2) of the robot frame on the lattice (n,2), column and row; cell centres lie at halves."""
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    cells = np.empty_like(points)
    for i in range(points.shape[0]):
        cells[i, 0] = (T_map_robot[0] + c * points[i, 0] - s * points[i, 1]) / resolution
        cells[i, 1] = (T_map_robot[1] + s * points[i, 0] + c * points[i, 1]) / resolution
    return cells


@kernel
def on_grid(cells: Array, lattice: Ints, height: int, width: int) -> bool:
    """True when the points (n,2) of the lattice, and a border of one cell, lie on the grid."""
    for i in range(cells.shape[0]):
        column, row = math.floor(cells[i, 0]) - lattice[0], math.floor(cells[i, 1]) - lattice[1]
        if not (1 <= column < width - 1 and 1 <= row < height - 1):
            return False
    return True


@kernel
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


@kernel
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


@kernel
def widen(brush: Brush) -> None:
    """Let the dirty window contain the brush's box."""
    dirty, box = brush.dirty, brush.box
    dirty[0], dirty[1] = min(dirty[0], box[0]), max(dirty[1], box[1])
    dirty[2], dirty[3] = min(dirty[2], box[2]), max(dirty[3], box[3])


@kernel
def add_polygon(layer: Layer, ring: Array, delta: int, brush: Brush) -> None:
    """Add `delta` to the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            layer[row, column] += np.int16(delta * brush.mask[row, column])
            brush.mask[row, column] = 0
    widen(brush)


@kernel
def set_polygon(layer: Layer, ring: Array, value: int, brush: Brush) -> None:
    """Write `value` into the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            if brush.mask[row, column]:
                layer[row, column] = np.int16(value)
            brush.mask[row, column] = 0
    widen(brush)


@kernel
def paint_scan(layers: Layer, outline: Array, strips: Array, delta: int, brush: Brush) -> None:
    """Vote (or take the vote back): cells inside the outline (m,2) free, cells of the strips (s,4,2) hit; lattice."""
    add_polygon(layers[FREE], outline, delta, brush)
    for i in range(strips.shape[0]):
        add_polygon(layers[HITS], strips[i], delta, brush)


@kernel
def split_outline(outline: Array, eye: Array, door: Array) -> tuple[Array, Array]:
    """Free space (m,2) seen from `eye` (2,), in the order of bearing, as cut by a door (2,2): before it and behind it.

    Behind is empty when nothing is seen through the door.
    """
    count, n, m = outline.shape[0], 0, 0
    front, behind = np.empty((4 * count, 2)), np.empty((4 * count, 2))
    ax, ay, bx, by = door_ends(eye, door)
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        px, py, qx, qy = outline[i, 0] - eye[0], outline[i, 1] - eye[1], outline[j, 0] - eye[0], outline[j, 1] - eye[1]
        share, share_q = door_share(ax, ay, bx, by, px, py), door_share(ax, ay, bx, by, qx, qy)
        right, left = crossing_stretch(px, py, qx, qy, ax, ay), crossing_stretch(px, py, qx, qy, bx, by)
        n = _put(front, n, eye, min(share, 1.0) * px, min(share, 1.0) * py)
        if share < 1.0:
            m = _put(behind, m, eye, px, py)
        if right > 1.0:  # the outline goes behind the door past its right end
            n = _put(front, _put(front, n, eye, right * ax, right * ay), eye, ax, ay)
            m = _put(behind, _put(behind, m, eye, ax, ay), eye, right * ax, right * ay)
        if left > 1.0:  # and comes back past its left end
            n = _put(front, _put(front, n, eye, bx, by), eye, left * bx, left * by)
            m = _put(behind, _put(behind, m, eye, left * bx, left * by), eye, bx, by)
        if (share_q < 1.0 <= share and right <= 1.0) or (share < 1.0 <= share_q and left <= 1.0):  # or through it
            ex, ey, dx, dy = qx - px, qy - py, bx - ax, by - ay
            across = ex * dy - ey * dx  # 0: the edge lies on the door's line
            along = ((ax - px) * dy - (ay - py) * dx) / across if abs(across) > 1e-9 else 0.0
            n = _put(front, n, eye, px + along * ex, py + along * ey)
            m = _put(behind, m, eye, px + along * ex, py + along * ey)
    return front[:n].copy(), behind[:m].copy()


@kernel
def _put(ring: Array, n: int, eye: Array, x: float, y: float) -> int:
    """Write a point, given from the eye (2,), into row n of the ring; returns the next row."""
    ring[n, 0], ring[n, 1] = eye[0] + x, eye[1] + y
    return n + 1


@kernel
def door_ends(eye: Array, door: Array) -> tuple[float, float, float, float]:
    """Right and left end x, y of a door (2,2) as seen from the eye (2,), relative to it."""
    ax, ay, bx, by = door[0, 0] - eye[0], door[0, 1] - eye[1], door[1, 0] - eye[0], door[1, 1] - eye[1]
    if ax * by - ay * bx > 0.0:
        return ax, ay, bx, by
    return bx, by, ax, ay


@kernel
def door_share(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> float:
    """Share of the way from the origin to p at which it crosses the segment from a (right) to b; 2: nowhere."""
    if ax * py - ay * px < 0.0 or px * by - py * bx < 0.0:
        return 2.0
    across = px * (by - ay) - py * (bx - ax)
    return (ax * by - ay * bx) / across if across > 1e-12 else 2.0


@kernel
def crossing_stretch(px: float, py: float, qx: float, qy: float, ax: float, ay: float) -> float:
    """How far out, in lengths of a, the edge from p to q crosses the ray through a counter-clockwise; 0: nowhere."""
    before, after = ax * py - ay * px, ax * qy - ay * qx
    if before >= 0.0 or after < 0.0:
        return 0.0
    return (px * qy - py * qx) / (after - before)


@kernel
def looks_through(outline: Array, eye: Array, door: Array) -> bool:
    """True when some of the free space (m,2) seen from `eye` (2,) lies behind the door (2,2)."""
    ax, ay, bx, by = door_ends(eye, door)
    for i in range(outline.shape[0]):
        px, py = outline[i - 1, 0] - eye[0], outline[i - 1, 1] - eye[1]
        qx, qy = outline[i, 0] - eye[0], outline[i, 1] - eye[1]
        if door_share(ax, ay, bx, by, qx, qy) < 1.0 or crossing_stretch(px, py, qx, qy, ax, ay) > 1.0:
            return True
    return False


@kernel
def paint_room(layer: Layer, room: int, outline: Array, strips: Array, view: tuple[Array, Array], brush: Brush) -> None:
    """Write `room` into the cells inside the outline (m,2) and of the strips (s,4,2), as far as doors let see.

    `view`: the eye (2,) and the doors (d,2,2), on the lattice like the rest.
    """
    eye, doors = view
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


@kernel
def forget_room(layer: Layer, room: int, outline: Array, eye: Array, doors: Array, brush: Brush) -> None:
    """Take `room` off the cells that a scan saw through doors (d,2,2) which were not known when it was painted."""
    for i in range(doors.shape[0]):
        if looks_through(outline, eye, doors[i]):
            replace_room(layer, room, split_outline(outline, eye, doors[i])[1], brush)


@kernel
def replace_room(layer: Layer, room: int, ring: Array, brush: Brush) -> None:
    """Take `room` off the cells whose centre lies in the ring (k,2) of the lattice."""
    mark(ring, brush)
    for row in range(brush.box[0], brush.box[1]):
        for column in range(brush.box[2], brush.box[3]):
            if brush.mask[row, column] and layer[row, column] == room:
                layer[row, column] = np.int16(-1)
            brush.mask[row, column] = 0
    widen(brush)


@kernel
def compose(layers: Layer, occupied_ratio: float, label: Bytes, polygon: Bools, room: Layer, dirty: Ints) -> int:
    """Bring the published arrays up to date inside the window `dirty`; returns how many cells changed."""
    changed = 0
    for row in range(max(dirty[0], 0), min(dirty[1], label.shape[0])):
        for column in range(max(dirty[2], 0), min(dirty[3], label.shape[1])):
            value = cell_label(layers, row, column, occupied_ratio)
            covered = layers[COVER, row, column] > 0
            owner = layers[COVER_ROOM, row, column] if covered else layers[ROOM, row, column]
            owner = owner if value != UNKNOWN_CELL else np.int16(-1)
            if label[row, column] != value or polygon[row, column] != covered or room[row, column] != owner:
                changed += 1
                label[row, column], polygon[row, column], room[row, column] = value, covered, owner
    return changed


@kernel
def cell_label(layers: Layer, row: int, column: int, occupied_ratio: float) -> int:
    """What the votes make of a cell."""
    hits, free = layers[HITS, row, column], layers[FREE, row, column]
    if layers[DOOR, row, column] > 0:
        return DOOR_CELL
    if hits > 0 and (free == 0 or hits >= occupied_ratio * (free + hits)):
        return OCCUPIED_CELL
    if free > 0:
        return FREE_CELL
    return OCCUPIED_CELL if layers[POCKET, row, column] > 0 else UNKNOWN_CELL


@kernel
def find_pockets(label: Bytes, room: Layer, complete: Bools, pocket: Layer) -> None:
    """Write 1 into `pocket` at unknown cells that only the walls and the floor of completed rooms surround, else 0.

    A component of unknown cells is a pocket when it does not reach the border of the grid, touches no door and touches
    cells of one room only, and that room is complete (`complete` (r,) by room id).
    """
    height, width = label.shape
    queue = np.empty((height * width, 2), np.int64)
    state = np.zeros((height, width), np.uint8)
    pocket[:, :] = 0
    for cell in range(height * width):
        row, column = cell // width, cell % width
        if label[row, column] != UNKNOWN_CELL or state[row, column]:
            continue
        size, owner = flood_unknown(label, room, state, queue, row, column)
        if 0 <= owner < complete.shape[0] and complete[owner]:
            for i in range(size):
                pocket[queue[i, 0], queue[i, 1]] = 1


@kernel
def flood_unknown(label: Bytes, room: Layer, state: Bytes, queue: Ints, row: int, column: int) -> tuple[int, int]:
    """Size of the unknown component around a cell (its cells in `queue`) and the one room around it (-2: not one)."""
    height, width = label.shape
    queue[0, 0], queue[0, 1] = row, column
    state[row, column] = 1
    size, head, owner = 1, 0, -1
    while head < size:
        r, c = queue[head, 0], queue[head, 1]
        head += 1
        if r == 0 or c == 0 or r == height - 1 or c == width - 1:
            owner = -2
            continue
        for k in range(4):
            nr, nc = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
            if label[nr, nc] == UNKNOWN_CELL and not state[nr, nc]:
                state[nr, nc] = 1
                queue[size, 0], queue[size, 1] = nr, nc
                size += 1
            elif label[nr, nc] == DOOR_CELL:
                owner = -2
            elif label[nr, nc] != UNKNOWN_CELL and room[nr, nc] >= 0 and owner != room[nr, nc]:
                owner = int(room[nr, nc]) if owner == -1 else -2
    return size, owner
