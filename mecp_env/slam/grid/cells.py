"""Compiled functions of the semantic grid: polygons filled by cell centres, votes of scans, polygons, doors, labels.

A cell belongs to a polygon when its centre does: painting is unbiased, whatever the angle between wall and grid.
Points of the lattice are places of the map frame over the resolution: cell centres lie at halves.

Compiled functions of what is seen through a door: the line of the door cuts the free space of a scan.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import to_map

Layer = NDArray[np.int16]

FREE, HITS, COVER, COVER_ROOM, ROOM, DOOR, POCKET = range(7)  # the layers of a grid
UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL, DOOR_CELL = range(4)  # as in mecp_env.slam.messages.Cell
ADD, SET, CLEAR = range(3)  # what `fill_polygon` does: add a value, write it, write -1 over it


class Raster(NamedTuple):
    """What every fill needs: scratch space, the position and size of the cells, and the window touched so far."""

    mask: Bytes  # (H,W+1) all zero between calls
    lattice: Ints  # (2,) column and row of cell [0, 0] on the lattice of the map frame
    dirty: Ints  # (4,) first row, last row + 1, first column, last column + 1 touched so far
    resolution_m: float


@compiled
def on_grid(cells: Array, raster: Raster) -> bool:
    """True when the points (n,2) of the lattice, and a border of one cell, lie on the grid."""
    height, width = raster.mask.shape[0], raster.mask.shape[1] - 1
    for i in range(cells.shape[0]):
        column = math.floor(cells[i, 0]) - raster.lattice[0]
        row = math.floor(cells[i, 1]) - raster.lattice[1]
        if not (1 <= column < width - 1 and 1 <= row < height - 1):
            return False
    return True


@compiled
def fill_polygon(layer: Layer, ring: Array, how: int, value: int, raster: Raster) -> None:
    """ADD or SET a value in the cells whose centre lies in the ring (k,2) of the lattice, or CLEAR it to -1 there.

    A row is filled between its crossings with the ring's edges. They are computed on the lattice, not on the grid: a
    polygon covers the same cells before and after growth.
    """
    mask, lattice, dirty = raster.mask, raster.lattice, raster.dirty
    height, width = mask.shape[0], mask.shape[1] - 1
    low_x, low_y, high_x, high_y = math.inf, math.inf, -math.inf, -math.inf
    for i in range(ring.shape[0]):
        low_x, high_x = min(low_x, ring[i, 0]), max(high_x, ring[i, 0])
        low_y, high_y = min(low_y, ring[i, 1]), max(high_y, ring[i, 1])
    top, bottom = max(math.floor(low_y) - lattice[1], 0), min(math.floor(high_y) + 1 - lattice[1], height)
    left, right = max(math.floor(low_x) - lattice[0], 0), min(math.floor(high_x) + 1 - lattice[0], width)
    for i in range(ring.shape[0]):
        x0, y0, x1, y1 = ring[i - 1, 0], ring[i - 1, 1], ring[i, 0], ring[i, 1]
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        for row in range(max(math.ceil(y0 - 0.5), top + lattice[1]), min(math.ceil(y1 - 0.5), bottom + lattice[1])):
            x = x0 + (x1 - x0) * (row + 0.5 - y0) / (y1 - y0)
            mask[row - lattice[1], min(max(math.ceil(x - 0.5) - lattice[0], 0), width)] ^= 1
    for row in range(top, bottom):
        inside = np.uint8(0)
        for column in range(left, right):
            inside ^= mask[row, column]
            mask[row, column] = inside
        mask[row, max(right, 0)] = 0
        for column in range(left, right):
            if how == ADD:
                layer[row, column] += np.int16(value * int(mask[row, column]))
            elif mask[row, column] and (how == SET or layer[row, column] == value):
                layer[row, column] = np.int16(value if how == SET else -1)
            mask[row, column] = 0
    dirty[0], dirty[1] = min(dirty[0], top), max(dirty[1], bottom)
    dirty[2], dirty[3] = min(dirty[2], left), max(dirty[3], right)


@compiled
def vote_scan(layers: Layer, outline: Array, strips: Array, T_map_robot: Array, delta: int, raster: Raster) -> bool:
    """Cast the votes of a scan (`delta` 1) or take them back (-1); False, and nothing done, where the grid ends.

    Cells inside the outline (m,2) are free, cells of the strips (s,4,2) hit; both in m, robot frame.
    """
    free = to_map(T_map_robot, outline) / raster.resolution_m
    walls = to_map(T_map_robot, strips.reshape(4 * strips.shape[0], 2)) / raster.resolution_m
    if not (on_grid(free, raster) and on_grid(walls, raster)):
        return False
    fill_polygon(layers[FREE], free, ADD, delta, raster)
    for i in range(strips.shape[0]):
        fill_polygon(layers[HITS], walls[4 * i : 4 * i + 4], ADD, delta, raster)
    return True


@compiled
def stamp(layers: Layer, rings: Array, layer: int, delta: int, room: int, raster: Raster) -> bool:
    """Add `delta` to a layer inside the rings (n,k,2) m, map frame; False, and nothing done, where the grid ends.

    Rings with nan are left out. On the layer COVER a ring that is added brings its room.
    """
    n, k = rings.shape[0], rings.shape[1]
    cells, known = to_map(np.zeros(3), rings.reshape(n * k, 2)) / raster.resolution_m, np.ones(n, np.bool_)
    for i in range(n * k):
        known[i // k] &= math.isfinite(cells[i, 0]) and math.isfinite(cells[i, 1])
    for i in range(n):
        if known[i] and not on_grid(cells[k * i : k * i + k], raster):
            return False
    for i in range(n):
        if known[i]:
            fill_polygon(layers[layer], cells[k * i : k * i + k], ADD, delta, raster)
        if known[i] and layer == COVER and delta > 0:
            fill_polygon(layers[COVER_ROOM], cells[k * i : k * i + k], SET, room, raster)
    return True


@compiled
def are_walled_up(layers: Layer, quads: Array, occupied_ratio: float, raster: Raster) -> Bools:
    """(d,) True for each door (d,4,2) of the lattice where walls leave no half of its width free between its faces.

    Probed every half cell in lines parallel to its faces, half a cell apart. A door without width is never walled up.
    """
    shut, last = np.zeros(quads.shape[0], np.bool_), (layers.shape[2] - 1, layers.shape[1] - 1)
    for d in range(quads.shape[0]):
        across, onward = quads[d, 1] - quads[d, 0], quads[d, 3] - quads[d, 0]
        count = math.ceil(2.0 * math.hypot(across[0], across[1]))
        lines = math.ceil(2.0 * math.hypot(onward[0], onward[1]))
        for line in range(lines):
            deep, run, longest = (line + 0.5) / lines, 0, 0
            right = quads[d, 0] + deep * (quads[d, 3] - quads[d, 0])
            along = (quads[d, 1] + deep * (quads[d, 2] - quads[d, 1]) - right) / max(count, 1)
            for k in range(count):
                column = min(max(math.floor(right[0] + (k + 0.5) * along[0]) - raster.lattice[0], 0), last[0])
                row = min(max(math.floor(right[1] + (k + 0.5) * along[1]) - raster.lattice[1], 0), last[1])
                hits, free = layers[HITS, row, column], layers[FREE, row, column]
                run = 0 if hits > 0 and hits >= occupied_ratio * (free + hits) else run + 1
                longest = max(longest, run)
            shut[d] |= 2 * longest < count
    return shut


@compiled
def paint_room(
    layer: Layer, room: int, outline: Array, strips: Array, T_map_robot: Array, doors: Array, raster: Raster
) -> None:
    """Write `room` into the cells of a scan, floor (m,2) and walls (s,4,2) m, robot frame.

    It ends at the doors (d,2,2) of the lattice through which the scan looks.
    """
    free = to_map(T_map_robot, outline) / raster.resolution_m
    walls = to_map(T_map_robot, strips.reshape(4 * strips.shape[0], 2)) / raster.resolution_m
    eye, through = T_map_robot[:2] / raster.resolution_m, np.zeros(strips.shape[0], np.bool_)
    for i in range(doors.shape[0]):
        front, behind = split_outline(free, eye, doors[i])
        if not len(behind):
            continue
        free = front
        ax, ay, bx, by = door_ends(eye, doors[i])
        for j in range(strips.shape[0]):
            x, y = 0.5 * (walls[4 * j, 0] + walls[4 * j + 1, 0]), 0.5 * (walls[4 * j, 1] + walls[4 * j + 1, 1])
            through[j] |= door_share(ax, ay, bx, by, x - eye[0], y - eye[1]) < 1.0
    fill_polygon(layer, free, SET, room, raster)
    for j in range(strips.shape[0]):
        if not through[j]:
            fill_polygon(layer, walls[4 * j : 4 * j + 4], SET, room, raster)


@compiled
def forget_room(layer: Layer, room: int, outline: Array, T_map_robot: Array, doors: Array, raster: Raster) -> None:
    """Take `room` off the cells that a scan saw through doors (d,2,2) which were not known when it was painted."""
    free, eye = to_map(T_map_robot, outline) / raster.resolution_m, T_map_robot[:2] / raster.resolution_m
    for i in range(doors.shape[0]):
        behind = split_outline(free, eye, doors[i])[1]
        if len(behind):
            fill_polygon(layer, behind, CLEAR, room, raster)


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
        for i in range(right - left):  # without branches, so that many cells are done at a time
            occupied = (hits[i] > 0) & ((free[i] == 0) | (hits[i] >= occupied_ratio * (free[i] + hits[i])))
            unseen = OCCUPIED_CELL if pocket[i] > 0 else UNKNOWN_CELL
            seen = OCCUPIED_CELL if occupied else (FREE_CELL if free[i] > 0 else unseen)
            value = DOOR_CELL if door[i] > 0 else seen
            covered = cover[left + i] > 0
            owner = cover_room[left + i] if covered else own_room[left + i]
            owner = owner if value != UNKNOWN_CELL else np.int16(-1)
            changed += (labels[i] != value) | (polygon[row, left + i] != covered) | (rooms[i] != owner)
            labels[i], polygon[row, left + i], rooms[i] = value, covered, owner
    return changed


@compiled
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


@compiled
def _put(ring: Array, n: int, eye: Array, x: float, y: float) -> int:
    """Write a point, given from the eye (2,), into row n of the ring; returns the next row."""
    ring[n, 0], ring[n, 1] = eye[0] + x, eye[1] + y
    return n + 1


@compiled
def door_ends(eye: Array, door: Array) -> tuple[float, float, float, float]:
    """Right and left end x, y of a door (2,2) as seen from the eye (2,), relative to it."""
    ax, ay, bx, by = door[0, 0] - eye[0], door[0, 1] - eye[1], door[1, 0] - eye[0], door[1, 1] - eye[1]
    if ax * by - ay * bx > 0.0:
        return ax, ay, bx, by
    return bx, by, ax, ay


@compiled
def door_share(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> float:
    """Share of the way from the origin to p at which it crosses the segment from a (right) to b; 2: nowhere."""
    if ax * py - ay * px < 0.0 or px * by - py * bx < 0.0:
        return 2.0
    across = px * (by - ay) - py * (bx - ax)
    return (ax * by - ay * bx) / across if across > 1e-12 else 2.0


@compiled
def crossing_stretch(px: float, py: float, qx: float, qy: float, ax: float, ay: float) -> float:
    """How far out, in lengths of a, the edge from p to q crosses the ray through a counter-clockwise; 0: nowhere."""
    before, after = ax * py - ay * px, ax * qy - ay * qx
    if before >= 0.0 or after < 0.0:
        return 0.0
    return (px * qy - py * qx) / (after - before)
