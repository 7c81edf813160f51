"""Paths on the estimated grid for a round robot: costs that keep off walls, one cost-to-go field, smoothed paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mecp_env.core import grid_paths
from mecp_env.core.array_types import Array, Bytes
from mecp_env.planning.config import PathsConfig
from mecp_env.slam.messages import SemanticGrid

Costs = NDArray[np.int32]

REMEMBERED = 4  # fields: a goal that is chosen is driven to over the field it was found with


@dataclass(frozen=True, slots=True, eq=False)
class CostToGoField:
    """The cheapest paths from the robot to every cell of a grid."""

    grid: SemanticGrid
    clearance: NDArray[np.float32]  # (H,W) cells to the nearest wall, up to the comfortable distance
    cost: Bytes  # (H,W) cost of a cell, 0: barred
    total: Costs  # (H,W) cost of the path there, grid_paths.FAR: none
    step: Bytes  # (H,W) the step that leads there
    shortcut: float  # cells: distance of shortcuts from walls

    def nearest(self, p_map: Array, reach_m: float) -> tuple[int, int] | None:
        """Row and column of the reachable cell nearest to `p_map` (2,), within `reach_m`; None without one."""
        x, y = self._cells(p_map)
        row, column = grid_paths.nearest_reached(self.total, x, y, reach_m / self.grid.resolution_m)
        return None if row < 0 else (row, column)

    def lengths_m(self, places: Sequence[tuple[float, float, float]]) -> list[float]:
        """Length of the path to each place (x, y, how near the path must come; m, map frame), below 0 without one."""
        (left, low), cell = self.grid.origin.tolist(), self.grid.resolution_m
        in_cells = [((x - left) / cell, (y - low) / cell, reach / cell) for x, y, reach in places]
        tenths = grid_paths.path_lengths(self.total, self.step, np.array(in_cells, np.float64).reshape(-1, 3))
        return [0.1 * cell * length for length in tenths.tolist()]

    def centre(self, cell: tuple[int, int]) -> Array:
        """(2,) m, map frame: the centre of a cell."""
        return self.grid.origin + (np.array([cell[1], cell[0]]) + 0.5) * self.grid.resolution_m

    def path(self, cell: tuple[int, int]) -> Array:
        """The path (n,2) m, map frame, from the robot to a reachable cell, smoothed."""
        points = grid_paths.smooth_path(self.step, cell[0], cell[1], self.clearance, self.cost, self.shortcut)
        return self.grid.origin + points * self.grid.resolution_m

    def _cells(self, p_map: Array) -> tuple[float, float]:
        x, y = (p_map - self.grid.origin) / self.grid.resolution_m
        return float(x), float(y)


def cost_to_go_field(grid: SemanticGrid, T_map_robot: Array, config: PathsConfig, tight: bool = False) -> CostToGoField:
    """The cheapest paths of the robot over FREE and DOOR cells; unknown cells are barred.

    A cell is passable when its centre is radius + margin + half a cell from the centre of every OCCUPIED cell; for
    tight paths need only the radius: the robot then passes a door whose jambs are drawn too thick.
    A robot that stands nearer to a wall (or on an unknown cell) may leave over the cells around it, and over the
    unknown cells under its body.
    """
    x, y = ((T_map_robot[:2] - grid.origin) / grid.resolution_m).tolist()
    row, column = (int(min(max(0.0, at), size - 1)) for at, size in zip((y, x), grid.label.shape, strict=True))
    return _field_from(grid, row, column, config, tight)


@lru_cache(REMEMBERED)
def _field_from(grid: SemanticGrid, row: int, column: int, config: PathsConfig, tight: bool) -> CostToGoField:
    """The cheapest paths from a cell; fields and grids are never written to."""
    cells = 1.0 / grid.resolution_m
    least = config.radius_m * cells if tight else (config.radius_m + config.margin_m) * cells + 0.5
    comfort = max(config.comfort_m * cells, least)
    clearance = grid_paths.clearance(grid.label, comfort)
    cost = grid_paths.cell_costs(grid.label, clearance, least, comfort, config.wall_cost)
    body = config.radius_m * cells
    grid_paths.open_start(cost, grid.label, clearance, (row, column), int(0.5 * cells), body)
    return CostToGoField(grid, clearance, cost, *grid_paths.cost_to_go(cost, row, column), config.shortcut_m * cells)
