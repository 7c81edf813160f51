"""The canvas of the semantic grid: layers of votes that grow with the map, and what is published of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.grid import cells as kernels
from mecp_env.slam.messages import UNKNOWN_ROOM, Array, Bools, Ints, SemanticGrid

GROWTH_CELLS = 20  # the grid grows in steps of so many cells
MAP_FRAME = np.zeros(3)  # the pose of what is in the map frame already
NOTHING = (2**40, -1, 2**40, -1)  # an empty window


def empty_grid(resolution_m: float) -> SemanticGrid:
    """A grid without cells, version 0."""
    shape = (0, 0)
    return SemanticGrid(
        np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.zeros(shape, np.int16), np.zeros(2), resolution_m, 0
    )


@dataclass(slots=True, eq=False)
class Canvas:
    """Votes per cell, one layer a kind (`grid_kernels`), and the grid published last."""

    resolution_m: float
    grid: SemanticGrid
    layers: NDArray[np.int16] = field(default_factory=lambda: np.zeros((7, 0, 0), np.int16))  # (7,H,W)
    lattice: Ints = field(default_factory=lambda: np.zeros(2, np.int64))  # (2,) column, row of cell [0, 0]
    mask: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 1), np.uint8))  # (H,W+1) scratch, all zero
    dirty: Ints = field(default_factory=lambda: np.array(NOTHING, np.int64))  # (4,) window to publish

    def brush(self) -> kernels.Brush:
        """What the painting kernels need."""
        return kernels.Brush(self.mask, self.lattice, self.dirty, np.empty(4, np.int64))

    def cells(self, points: Array, T_map_points: Array = MAP_FRAME) -> Array:
        """Points (..., 2) of a frame on the lattice, column and row."""
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
        return kernels.to_cells(flat, T_map_points, self.resolution_m).reshape(points.shape)

    def contain(self, cells: Array) -> None:
        """Grow until the points (n,2) of the lattice and a border of one cell lie on the grid."""
        height, width = self.layers.shape[1:]
        if not kernels.on_grid(cells, self.lattice, height, width):
            self._stretch(cells.min(axis=0), cells.max(axis=0))

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
        layers[[kernels.ROOM, kernels.COVER_ROOM]] = UNKNOWN_ROOM
        layers[window] = self.layers
        label, polygon, room = np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.full(shape, -1, np.int16)
        label[window], polygon[window], room[window] = grid.label, grid.polygon, grid.room
        self.layers, self.mask = layers, np.zeros((shape[0], shape[1] + 1), np.uint8)
        self.lattice = self.lattice - before
        self.dirty = self.dirty + np.repeat(before[::-1], 2)
        origin = self.lattice.astype(np.float64) * self.resolution_m
        self.grid = SemanticGrid(label, polygon, room, origin, self.resolution_m, grid.version + 1)

    def everything_dirty(self) -> None:
        """Publish every cell anew."""
        self.dirty[:] = 0, self.layers.shape[1], 0, self.layers.shape[2]

    def publish(self, occupied_ratio: float) -> SemanticGrid:
        """The grid of the votes as they are; the same object as before when no cell changed."""
        if self.dirty[0] >= self.dirty[1]:
            return self.grid
        label, polygon, room = self.grid.label.copy(), self.grid.polygon.copy(), self.grid.room.copy()
        changed = kernels.compose(self.layers, occupied_ratio, label, polygon, room, self.dirty)
        self.dirty[:] = NOTHING
        if changed:
            version = self.grid.version + 1
            self.grid = SemanticGrid(label, polygon, room, self.grid.origin, self.resolution_m, version)
        return self.grid

    def find_pockets(self, complete: Bools, occupied_ratio: float) -> None:
        """Turn the unknown pockets of completed rooms, flags (r,) by room id, into walls."""
        self.layers[kernels.POCKET] = 0
        self.everything_dirty()
        bare = self.publish(occupied_ratio)
        kernels.find_pockets(bare.label, bare.room, complete, self.layers[kernels.POCKET])
        self.everything_dirty()
