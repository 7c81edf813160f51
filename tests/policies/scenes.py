"""Observations made by hand: goals, walls and landmarks where a test wants them."""

from types import MappingProxyType
from typing import Any

import numpy as np

from mecp_env.policies.registry import KIND, PATH, VALID, X, Y

CELLS, CELL_M = 96, 0.2
FREE, OCCUPIED, UNKNOWN = 0, 2, 3


def observation(*goals: dict[int, float]) -> dict[str, Any]:
    """An observation on floor that is known all over, with some goals (column -> value), all valid."""
    table = np.zeros((32, 12), np.float32)
    for row, columns in enumerate(goals):
        table[row, VALID] = 1.0
        for column, value in columns.items():
            table[row, column] = value
    grid = np.zeros((8, CELLS, CELLS), np.uint8)
    grid[FREE] = 255
    cov = np.array([1e-6, 0, 0, 1e-6, 0, 1e-8], np.float32)
    trust, marks = np.ones(3, np.float32), np.zeros((128, 8), np.float32)
    return {"goals": table, "grid": grid, "landmarks": marks, "pose_cov": cov, "localisation": trust}


def goal(x: float, y: float, path_m: float, kind: int = 2) -> dict[int, float]:
    """A goal in the robot frame."""
    return {X: x, Y: y, PATH: path_m, KIND: kind}


def paint(seen: dict[str, Any], layer: int, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Give a rectangle of the grid (m, robot frame) to one layer, and take it from the floor."""
    rows = slice(round(CELLS / 2 - x[1] / CELL_M), round(CELLS / 2 - x[0] / CELL_M))
    columns = slice(round(CELLS / 2 - y[1] / CELL_M), round(CELLS / 2 - y[0] / CELL_M))
    seen["grid"][FREE, rows, columns] = 0
    seen["grid"][layer, rows, columns] = 255


def landmarks(seen: dict[str, Any], places: list[tuple[float, float]], sigma_m: float) -> None:
    """Put landmarks (robot frame) of one standard deviation into the observation."""
    for row, (x, y) in enumerate(places):
        seen["landmarks"][row] = [x, y, sigma_m**2, 0.0, sigma_m**2, 0.0, 0.0, 1.0]


class FlatDriver:
    """Drives ahead; it takes nothing but flat observations."""

    actions, settings = "discrete", MappingProxyType({"observation": "flat"})

    def reset(self, seed: int = 0) -> None:
        """Nothing to do."""

    def act(self, observation: Any, mask: Any = None) -> int:
        """Ahead."""
        assert observation.ndim == 1
        return 1
