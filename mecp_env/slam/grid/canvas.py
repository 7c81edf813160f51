"""The canvas of the semantic grid: layers of votes that grow with the map, and the grid published, pockets filled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.se2 import to_map
from mecp_env.slam.grid import cells
from mecp_env.slam.grid.cells import DOOR_CELL, UNKNOWN_CELL
from mecp_env.slam.messages import UNKNOWN_ROOM, SemanticGrid

SEVERAL = -2  # more than one room, or a door
GROWTH_CELLS = 20  # the grid grows by multiples of this
MAP_FRAME = np.zeros(3)  # the pose of points that are in the map frame already
AROUND = np.indices((3, 3)).reshape(2, 9).T - 1  # (9,2) from a cell to itself and those beside it
NOTHING = (2**40, -1, 2**40, -1)  # an empty window


def find_pockets(label: Bytes, room: NDArray[np.int16], complete: Bools, stood: Ints) -> Bools:
    """(H,W) the unknown cells that only the walls and the floor of one completed room surround.

    Such a component of unknown cells (4 neighbours) does not reach the border of the grid, touches no door and touches
    cells of one room only, and that room is complete (`complete` (r,) by room id). None of its cells is one of `stood`
    (n,2), column and row, or beside one.
    """
    part, count = ndimage.label(label == UNKNOWN_CELL)
    inner = np.arange(count + 1) > 0
    inner[np.concatenate((part[0], part[-1], part[:, 0], part[:, -1]))] = False
    near = (stood[:, None, :] + AROUND).reshape(-1, 2)
    columns, rows = near[((near >= 0) & (near < label.shape[::-1])).all(axis=1)].T
    inner[part[rows, columns]] = False
    pockets, width = np.zeros(label.shape, np.bool_), label.shape[1]
    labels, rooms, parts = label.ravel(), room.ravel(), part.ravel()
    cell = np.flatnonzero(inner.take(parts))
    own = parts[cell]
    least, most = np.full(count + 1, len(complete)), np.full(count + 1, SEVERAL)  # of the rooms beside each component
    for step in (width, -width, 1, -1):
        beside = labels[cell + step]
        owner = np.where(beside == DOOR_CELL, SEVERAL, rooms[cell + step])
        tells = (beside != UNKNOWN_CELL) & (owner != UNKNOWN_ROOM)
        np.minimum.at(least, own[tells], owner[tells])
        np.maximum.at(most, own[tells], owner[tells])
    surrounded = (least == most) & np.isin(least, np.flatnonzero(complete))
    pockets.ravel()[cell] = surrounded[own]
    return pockets


def empty_grid(resolution_m: float) -> SemanticGrid:
    """A grid without cells, version 0."""
    shape = (0, 0)
    return SemanticGrid(
        np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.zeros(shape, np.int16), np.zeros(2), resolution_m, 0
    )


@dataclass(slots=True, eq=False)
class Canvas:
    """Votes per cell in one layer per kind (`mecp_env.slam.grid.cells`), and the grid published last."""

    resolution_m: float
    grid: SemanticGrid
    layers: NDArray[np.int16] = field(default_factory=lambda: np.zeros((7, 0, 0), np.int16))  # (7,H,W)
    lattice: Ints = field(default_factory=lambda: np.zeros(2, np.int64))  # (2,) column, row of cell [0, 0]
    mask: Bytes = field(default_factory=lambda: np.zeros((0, 1), np.uint8))  # (H,W+1) scratch, all zero
    dirty: Ints = field(default_factory=lambda: np.array(NOTHING, np.int64))  # (4,) window to publish

    @property
    def raster(self) -> cells.Raster:
        """What the compiled functions need of it."""
        return cells.Raster(self.mask, self.lattice, self.dirty, self.resolution_m)

    def to_cells(self, points: Array, T_map_points: Array = MAP_FRAME) -> Array:
        """Points (..., 2) of a frame on the lattice, column and row."""
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
        lattice: Array = to_map(T_map_points, flat) / self.resolution_m
        return lattice.reshape(points.shape)

    def vote(self, outline: Array, strips: Array, T_map_robot: Array, delta: int) -> None:
        """Cast the votes of a scan, free inside (m,2) and hit in (s,4,2) m (`delta` 1), or take them back (-1)."""
        if not cells.vote_scan(self.layers, outline, strips, T_map_robot, delta, self.raster):
            self.contain(self.to_cells(outline, T_map_robot))
            self.contain(self.to_cells(strips, T_map_robot).reshape(-1, 2))
            cells.vote_scan(self.layers, outline, strips, T_map_robot, delta, self.raster)

    def stamp(self, rings: Array, layer: int, delta: int, room: int = UNKNOWN_ROOM) -> None:
        """Paint rings (n,k,2) m, map frame, on a layer (`delta` 1), or take them off (-1), but those with nan."""
        if not cells.stamp(self.layers, rings, layer, delta, room, self.raster):
            for ring in self.to_cells(rings[np.isfinite(rings).all(axis=(1, 2))]):
                self.contain(ring)
            cells.stamp(self.layers, rings, layer, delta, room, self.raster)

    def are_walled_up(self, quads: Array, occupied_ratio: float) -> Bools:
        """(d,) True for each door (d,4,2) m that walls narrow to less than half its width; not of one with nan."""
        if not self.layers.size:
            return np.zeros(len(quads), np.bool_)
        on_lattice = self.to_cells(np.where(np.isnan(quads), 0.0, quads))
        return cells.are_walled_up(self.layers, on_lattice, occupied_ratio, self.raster)

    def set_room(self, ring: Array, room: int) -> None:
        """Give the cells under a painted polygon (k,2) m its room."""
        cells.fill_polygon(self.layers[cells.COVER_ROOM], self.to_cells(ring), cells.SET, room, self.raster)

    def contain(self, points: Array) -> None:
        """Grow until the points (n,2) of the lattice and a border of one cell lie on the grid."""
        if not cells.on_grid(points, self.raster):
            self._stretch(points.min(axis=0), points.max(axis=0))

    def _stretch(self, low: Array, high: Array) -> None:
        """Grow until the points `low` and `high` (2,) of the lattice and a border of one cell lie on the grid."""
        size = np.array(self.layers.shape[:0:-1])
        first = np.floor(low).astype(np.int64) - 1 - self.lattice
        last = np.floor(high).astype(np.int64) + 2 - self.lattice
        if not size[0]:
            self.lattice, first, last = self.lattice + first, np.zeros(2, np.int64), last - first
        before = np.maximum(-(first // GROWTH_CELLS) * GROWTH_CELLS, 0)
        after = np.maximum(-((size - last) // GROWTH_CELLS) * GROWTH_CELLS, 0)
        self._grow(before, after)

    def _grow(self, before: Ints, after: Ints) -> None:
        """Add columns and rows (2,) before and after."""
        height, width = self.layers.shape[1:] + (before + after)[::-1]
        window = np.s_[..., before[1] : height - after[1], before[0] : width - after[0]]
        shape, grid = (int(height), int(width)), self.grid
        layers = np.zeros((len(self.layers), *shape), np.int16)
        layers[[cells.ROOM, cells.COVER_ROOM]] = UNKNOWN_ROOM
        layers[window] = self.layers
        label, polygon, room = np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.full(shape, -1, np.int16)
        label[window], polygon[window], room[window] = grid.label, grid.polygon, grid.room
        self.layers, self.mask = layers, np.zeros((shape[0], shape[1] + 1), np.uint8)
        self.lattice = self.lattice - before
        self.dirty = self.dirty + np.repeat(before[::-1], 2)
        origin = self.lattice.astype(np.float64) * self.resolution_m
        self.grid = SemanticGrid(label, polygon, room, origin, self.resolution_m, grid.version + 1)

    def everything_dirty(self) -> None:
        """Publish every cell again."""
        self.dirty[:] = 0, self.layers.shape[1], 0, self.layers.shape[2]

    def publish(self, occupied_ratio: float) -> SemanticGrid:
        """The grid of the current votes; the same object as before when no cell changed."""
        if self.dirty[0] >= self.dirty[1]:
            return self.grid
        label, polygon, room = self.grid.label.copy(), self.grid.polygon.copy(), self.grid.room.copy()
        changed = cells.compose(self.layers, occupied_ratio, label, polygon, room, self.dirty)
        self.dirty[:] = NOTHING
        if changed:
            version = self.grid.version + 1
            self.grid = SemanticGrid(label, polygon, room, self.grid.origin, self.resolution_m, version)
        return self.grid

    def fill_pockets(self, complete: Bools, occupied_ratio: float, p_laser: Array) -> None:
        """Turn the unknown pockets of completed rooms, flags (r,) by room id, into walls.

        Not those right beside a place p_laser (n,2) m of the laser: the robot was there, on its blind side.
        """
        layer = self.layers[cells.POCKET]
        layer[:] = 0
        self.everything_dirty()
        grid = self.publish(occupied_ratio)
        if complete.any():
            stood = np.floor((p_laser - grid.origin) / grid.resolution_m).astype(np.int64)
            layer[:] = find_pockets(grid.label, grid.room, complete, stood)
        self.everything_dirty()
