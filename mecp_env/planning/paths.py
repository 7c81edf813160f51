"""Ways over the believed grid for a round robot: costs that keep off walls, one distance field, smoothed paths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.planning import path_kernels as kernels
from mecp_env.planning.config import PathsConfig
from mecp_env.slam.data import SemanticGrid

Array = NDArray[np.float64]
Costs = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class WayField:
    """The cheapest ways from the robot to every cell of a grid."""

    grid: SemanticGrid
    clearance: NDArray[np.float32]  # (H,W) cells to the nearest wall, up to the comfortable distance
    cost: Costs  # (H,W) cost of a cell, 0: barred
    total: Costs  # (H,W) cost of the way there, kernels.FAR: none
    length: Costs  # (H,W) length of the way there, tenths of a cell
    step: NDArray[np.uint8]  # (H,W) the step that leads there
    shortcut: float  # cells: shortcuts keep so far from walls

    def nearest(self, p_map: Array, reach_m: float) -> tuple[int, int] | None:
        """Row and column of the reachable cell nearest to `p_map` (2,), within `reach_m`; None without one."""
        x, y = self._cells(p_map)
        row, column = kernels.nearest_reached(self.total, x, y, reach_m / self.grid.resolution_m)
        return None if row < 0 else (int(row), int(column))

    def length_m(self, cell: tuple[int, int]) -> float:
        """Length of the way to a reachable cell."""
        return 0.1 * self.grid.resolution_m * float(self.length[cell])

    def centre(self, cell: tuple[int, int]) -> Array:
        """(2,) m, map frame: the centre of a cell."""
        return self.grid.origin + (np.array([cell[1], cell[0]]) + 0.5) * self.grid.resolution_m

    def path(self, cell: tuple[int, int]) -> Array:
        """The way (n,2) m, map frame, from the robot to a reachable cell, smoothed."""
        cells = kernels.trace_back(self.step, cell[0], cell[1])
        points = np.ascontiguousarray(cells[:, ::-1] + 0.5)
        points = kernels.shorten(points, self.clearance, self.cost, self.shortcut)
        return self.grid.origin + points * self.grid.resolution_m

    def _cells(self, p_map: Array) -> tuple[float, float]:
        x, y = (p_map - self.grid.origin) / self.grid.resolution_m
        return float(x), float(y)


def way_field(grid: SemanticGrid, T_map_robot: Array, config: PathsConfig) -> WayField:
    """All ways of the robot over FREE and DOOR cells; unknown cells are barred.

    A cell is passable when its centre is radius + margin + half a cell from the centre of every OCCUPIED cell. A robot
    that stands nearer to a wall (or on an unknown cell) may leave over the cells around it.
    """
    cells = 1.0 / grid.resolution_m
    least = (config.radius_m + config.margin_m) * cells + 0.5
    comfort = max(config.comfort_m * cells, least)
    clearance = kernels.clearance(grid.label, comfort)
    cost = kernels.cell_costs(grid.label, clearance, least, comfort, config.wall_cost)
    here = np.floor((T_map_robot[:2] - grid.origin) / grid.resolution_m).astype(np.int64)
    column, row = np.clip(here, 0, np.array(cost.shape[::-1]) - 1)
    kernels.open_start(cost, grid.label, clearance, int(row), int(column), int(0.5 * cells))
    total, length, step = kernels.distance_field(cost, int(row), int(column))
    return WayField(grid, clearance, cost, total, length, step, config.shortcut_m * cells)
