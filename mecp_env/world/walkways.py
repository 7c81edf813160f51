"""Where pedestrians can walk in a building, and the shortest paths there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mecp_env.core import grid_paths
from mecp_env.core.array_types import Array, Bools

MARGIN_M = 0.05  # error of the raster
COMFORT_M, WALL_COST = 0.7, 3.0  # closer to walls than this a path costs more, up to this factor
SHORTCUT_M = 0.5  # distance of shortcuts from walls
NEAR_M = 1.0  # a pedestrian too close to a wall starts at a free cell within this distance


class WalkwayPlanner:
    """Paths of round pedestrians over the raster of a building's free space; derived, not part of a snapshot."""

    def __init__(self, free: Bools, corner: Array, cell_m: float, radius_m: float) -> None:
        label = np.where(free, grid_paths.FREE, grid_paths.OCCUPIED).astype(np.uint8)
        least = (radius_m + MARGIN_M) / cell_m + 0.5
        comfort = max(COMFORT_M / cell_m, least)
        self._corner, self._cell_m = corner, cell_m
        self.clearance = grid_paths.clearance(label, comfort)  # (H,W) cells to the nearest wall, up to the comfort
        self._cost = grid_paths.cell_costs(label, self.clearance, least, comfort, WALL_COST)
        self._open = np.where(self._cost > 0, 0, grid_paths.FAR).astype(np.int32)  # (H,W) FAR: barred
        self._shortcut = max(SHORTCUT_M / cell_m, least)
        self._fields: dict[tuple[int, int], tuple[NDArray[np.int32], NDArray[np.uint8]]] = {}

    def forget(self) -> None:
        """Forget the paths to all destinations: those of another episode are others, and each takes 0.2 MB and more."""
        self._fields.clear()

    def reachable(self, p_world: Array) -> Array:
        """(n,2) m: the centres of all cells reachable from `p_world` (2,); empty where no pedestrian can be."""
        start = self._nearest(self._open, p_world)
        if start is None:
            return np.empty((0, 2))
        rows, columns = np.nonzero(self._field(*start)[0] < grid_paths.FAR)
        middles: Array = self._corner + (np.stack([columns, rows], axis=1) + 0.5) * self._cell_m
        return middles

    def clearance_m(self, p_world: Array) -> Array:
        """(n,) m from each point (n,2) of the raster to the nearest wall, about, up to the comfortable distance."""
        columns, rows = np.floor((p_world - self._corner) / self._cell_m).astype(np.int64).T
        clear: Array = self.clearance[rows, columns] * self._cell_m
        return clear

    def route(self, p_from: Array, p_to: Array) -> Array:
        """Points (n,2) m of the shortest path between two points (2,), without the first; empty without a path."""
        end = self._nearest(self._open, p_to)
        if end is None:
            return np.empty((0, 2))
        total, step = self._field(*end)
        begin = self._nearest(total, p_from)
        if begin is None:
            return np.empty((0, 2))
        cells = grid_paths.smooth_path(step, *begin, self.clearance, self._cost, self._shortcut)
        points: Array = self._corner + cells[::-1] * self._cell_m
        return points

    def _field(self, row: int, column: int) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Cost and step of the paths from a cell to all others."""
        if (row, column) not in self._fields:
            self._fields[row, column] = grid_paths.cost_to_go(self._cost, row, column)
        return self._fields[row, column]

    def _nearest(self, total: NDArray[np.int32], p_world: Array) -> tuple[int, int] | None:
        """Row and column of the nearest cell within `NEAR_M` that is not FAR."""
        x, y = ((p_world - self._corner) / self._cell_m).tolist()
        row, column = grid_paths.nearest_reached(total, x, y, NEAR_M / self._cell_m)
        return None if row < 0 else (row, column)
