"""Correct coverage: how much of the floor is in the map, at the place where it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.spatial
import shapely

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import inverse
from mecp_env.evaluation import metric_arrays
from mecp_env.slam.messages import SemanticGrid

SPACING_M = 0.1  # between the points of a wall


class FloorAndWalls(NamedTuple):
    """The free cells of a building, and the place on a wall that is nearest to each."""

    p_world: Array  # (n,2) m, centres of the free cells
    wall: Ints  # (n,) index of the nearest of `p_walls`
    p_walls: Array  # (w,2) m


def floor_and_walls(centres: Array, free: Bools, segments: Array) -> FloorAndWalls:
    """The cells of a raster with centres (H,W,2) that are `free` (H,W), and the faces (S,2,2) m as points."""
    p_world = np.ascontiguousarray(centres[free])
    lines = shapely.segmentize(shapely.linestrings(segments), SPACING_M)
    p_walls = shapely.get_coordinates(lines)
    _, wall = scipy.spatial.cKDTree(p_walls).query(p_world)
    return FloorAndWalls(p_world, np.asarray(wall, np.int64), p_walls)


def correct_coverage(floor: FloorAndWalls, grid: SemanticGrid, T_world_map: Array) -> float:
    """Share of the true free cells that the map calls FREE or DOOR, and whose nearest true wall is in the map.

    A wall is in the map where a cell within 0.25 m of the place of the true wall is OCCUPIED. Nothing is fitted: the
    map lies where the robot believed to start, so a part of it that slid off does not count.
    """
    place = np.array([*grid.origin.tolist(), grid.resolution_m])
    T_map_world = inverse(T_world_map)
    correct: int = metric_arrays.count_correct(*floor, T_map_world, grid.label, place)
    return correct / max(1, len(floor.p_world))


@dataclass(slots=True, eq=False)
class MapQuality:
    """Correct coverage and map error at the last comparison, and the areas under the former until now; plain state."""

    correct_coverage: float = 0.0
    map_error_m: float = 0.0  # RMSE of the landmarks
    over_steps: float = 0.0  # sum over the control steps
    over_metres: float = 0.0  # m, integral over the metres driven, up to the budget
    metres: float = 0.0  # driven, up to the budget

    def drive(self, metres: float, budget_m: float) -> None:
        """Count one control step of that length."""
        counted = min(metres, budget_m - self.metres)
        self.metres += counted
        self.over_steps += self.correct_coverage
        self.over_metres += counted * self.correct_coverage

    def mean_over_steps(self, steps: int, limit: int) -> float:
        """Mean over the step limit, the last value held after `steps`."""
        return (self.over_steps + max(0, limit - steps) * self.correct_coverage) / limit

    def mean_over_metres(self, budget_m: float) -> float:
        """Mean over the first `budget_m` metres, the last value held."""
        return (self.over_metres + (budget_m - self.metres) * self.correct_coverage) / budget_m
