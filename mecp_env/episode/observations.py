"""The observation: the estimate, in arrays of fixed shape. Nothing here uses ground truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.episode import observation_arrays
from mecp_env.episode.observation_arrays import COLUMNS, GOAL, GOALS, LANDMARKS, LAYERS, Column, Floats, Part
from mecp_env.planning.goals import Goals
from mecp_env.slam.messages import FeatureTable, RoomGraph, SemanticGrid
from mecp_env.slam.output import SlamOutput

GRID = (96, 0.2)  # cells per side, m per cell
MAP = (64, 0.8)
TRAIL_STEP_M = 0.1
TABLES = ("pose", "pose_cov", "landmarks", "goals")
ROWS = {"landmarks": LANDMARKS, "goals": GOALS}
BLOCK = 32  # cells: what is kept of a grid begins and ends at multiples
FARTHEST = 2.0**40  # cells


@dataclass(slots=True, eq=False)
class TravelledPath:
    """Where the robot believed to be, a point every 0.1 m, in the map frame; not redrawn by a loop closure."""

    points: Array = field(default_factory=lambda: np.zeros((256, 2)))  # (capacity,2) m
    count: int = 0
    last: tuple[float, float] = (math.inf, math.inf)

    def add(self, T_map_robot: Array) -> None:
        """Append the position unless it is near the last one."""
        x, y, _ = T_map_robot.tolist()
        if math.hypot(x - self.last[0], y - self.last[1]) < TRAIL_STEP_M:
            return
        if self.count == len(self.points):
            self.points = np.concatenate([self.points, np.zeros_like(self.points)])
        self.points[self.count] = self.last = (x, y)
        self.count += 1


class Seen(NamedTuple):
    """What an observation is computed from: the estimate, and the agent's own step budget."""

    output: SlamOutput
    features: FeatureTable
    goals: Goals
    path: TravelledPath
    recognised: float = 0.0  # recent share of recognised corners
    budget: float = 1.0  # share of the step limit that is left


def limits_of(name: str, uncertainty: bool) -> Floats:
    """(2,k) the lower and upper bounds of the columns of a table."""
    columns = GOAL if name == "goals" and not uncertainty else COLUMNS[name]
    limits = np.array([bounds for _, _, bounds in columns], np.float32).T.copy()
    if columns is GOAL:
        limits[1, 4] = 3.0  # kinds
    return limits


def table_space(name: str, uncertainty: bool) -> spaces.Box:
    """The space of a table, or of a row of numbers."""
    low, high = (np.tile(row, (ROWS[name], 1)) if name in ROWS else row for row in limits_of(name, uncertainty))
    return spaces.Box(low, high, dtype=np.float32)


def make_space(with_map: bool, beams: int, max_range_m: float, uncertainty: bool = False) -> spaces.Dict:
    """The observation space; `beams` is 0 without the scan."""
    names = ("budget", *TABLES, "localisation") if uncertainty else ("budget", *TABLES)
    parts: dict[str, spaces.Space[Any]] = {name: table_space(name, uncertainty) for name in names}
    for name, (cells, _) in {"grid": GRID, "map": MAP}.items() if with_map else [("grid", GRID)]:
        parts[name] = spaces.Box(0, 255, (len(LAYERS), cells, cells), np.uint8)
    if beams:
        parts["scan"] = spaces.Box(0.0, max_range_m, (beams,), np.float32)
    return spaces.Dict(parts)


class Observer:
    """Computes observations of the format "dict"; it has no state beside caches.

    The parts of an observation (float32 unless noted):

    - `pose` (4): x, y, cos and sin of the heading, map frame.
    - `budget` (1): the share of the step limit `max_steps` that is left, from 1 to 0.
    - `pose_cov` (6): xx, xy, x heading, y y, y heading, heading heading.
    - `landmarks` (128,8), nearest first: x, y in the robot frame, covariance xx, xy, yy in the robot's axes, room, kind
      (0 crossing, 1 free end, 2 jamb), valid.
    - `goals` (32,9), in the order of `find_goals`: x, y in the robot frame, path length, size, kind (0 open edge, 1
      candidate door, 2 frontier, 3 door), room, level, visits, valid.
    - `grid` (8,96,96) uint8, cells of 0.2 m, centred on the robot with its heading up: 255 where any cell of the
      semantic grid in it is free, in a polygon, occupied, unknown, a door, in the current room, a frontier, or on the
      path travelled.
    - `map` (8,64,64) uint8, on request: the same with cells of 0.8 m.
    - `localisation` (3,), with `uncertainty`: the probability that the position error is below 0.5 m, 1 while the robot
      is localised, and the recent share of recognised corners. `goals` then is (32,12): after the nine columns the
      predicted standard deviations of position (m) and heading (rad) on arrival and the predicted gain of landmark
      information on the way (nat), and there are more kinds: 4 a place on known ground (its level: 0 the last good
      place, 1 closes a loop, 2 well-known landmarks), 5 waiting, and, while the pose is searched for, 6 open floor
      ahead.
    - `scan` (B,), on request: ranges of the merged beams, the maximum range where nothing was hit.
    """

    def __init__(
        self, with_map: bool = False, beams: int = 0, max_range_m: float = 30.0, uncertainty: bool = False
    ) -> None:
        self.space = make_space(with_map, beams, max_range_m, uncertainty)
        self._uncertainty, self._windows = uncertainty, GridWindows()
        self._limits = np.concatenate([limits_of(name, uncertainty) for name in TABLES], axis=1)
        self._scan_limits = np.array([[0.0], [max_range_m]], np.float32)
        self._goals: Goals | None = None
        self._became, self._merges = np.empty(0, np.int64), 0

    def observe(self, seen: Seen) -> tuple[dict[str, NDArray[Any]], int]:
        """The observation in fresh arrays, and how many of its values were cut to their bounds or left out."""
        output, goals, trail = seen.output, seen.goals, seen.path
        observation, outside = self._tables(output, seen.features, goals)
        observation["budget"] = np.array([seen.budget], np.float32)
        observation["grid"] = self._windows.layers(output, trail, GRID)
        if "map" in self.space.spaces:
            observation["map"] = self._windows.layers(output, trail, MAP)
        if self._uncertainty:
            trust = output.confidence, output.localised, seen.recognised
            observation["localisation"] = np.array(trust, np.float32)
        if "scan" in self.space.spaces:
            observation["scan"] = scan = output.beams.ranges.astype(np.float32)
            outside += observation_arrays.saturate(scan.reshape(-1, 1), self._scan_limits, 0)
        left_out = max(0, len(output.belief.ids) - LANDMARKS) + max(0, len(goals) - GOALS)
        return observation, left_out + outside

    def _tables(self, output: SlamOutput, features: FeatureTable, goals: Goals) -> tuple[dict[str, NDArray[Any]], int]:
        """The tables in fresh arrays, and how many of their values were cut to their bounds."""
        belief, graph = output.belief, output.graph
        if goals is not self._goals:  # they change only when goals are looked for
            self._goals, self._goal_rows = goals, goal_rows(goals, COLUMNS["goals"] if self._uncertainty else GOAL)
        if len(graph.merged) != self._merges:
            self._merges, self._became = len(graph.merged), rooms_after_merges(graph)
        pose, cov = np.ascontiguousarray(belief.T_map_robot), np.ascontiguousarray(belief.pose_cov)
        landmarks = np.zeros((LANDMARKS, len(COLUMNS["landmarks"])), np.float32)
        tables = np.empty(4, np.float32), np.empty(6, np.float32), landmarks, self._goal_rows.copy()
        labels = belief.ids, features.rows["room"], features.rows["kind"], self._became
        world = pose, cov, belief.p_map, belief.covs
        outside = observation_arrays.fill_tables(tables, world, labels, goals.p_map, self._limits)
        return dict(zip(TABLES, tables, strict=True)), outside


class GridWindows:
    """Windows of the semantic grid around the robot; keeps only a cache that follows from the version of the grid."""

    def __init__(self) -> None:
        self._cache: dict[int, tuple[tuple[int, ...], Bytes]] = {}  # pool width -> what it was made of, codes

    def layers(self, output: SlamOutput, trail: TravelledPath, size: tuple[int, float]) -> Bytes:
        """(8,n,n) the layers of `Observer`'s `grid`; `size`: n, and the side of a cell in m."""
        grid, pose = output.grid, np.ascontiguousarray(output.belief.T_map_robot)
        width = max(1, round(size[1] / grid.resolution_m))
        reach = math.ceil(0.5 * math.sqrt(2.0) * size[0] * size[1] / grid.resolution_m) + width + 1
        pooled, part = self._pooled(grid, output.graph.current, width, around(grid, pose, reach))
        corner = grid.origin - 0.5 * (width - 1) * grid.resolution_m
        path = trail.points[: trail.count]
        layers: Bytes = observation_arrays.window_layers(pooled, part, corner, grid.resolution_m, pose, size, path)
        return layers

    def _pooled(self, grid: SemanticGrid, room: int, width: int, rect: Part) -> tuple[Bytes, Part]:
        """The pooled codes of the rows and columns `rect`, right but for a rim of `width`, and where they are."""
        (top, bottom, left, right), (rows, columns) = rect, grid.label.shape
        key = (grid.version, room, *rect)
        if width not in self._cache or self._cache[width][0] != key:
            shown, label = np.s_[top:bottom, left:right], np.zeros((bottom - top + 2, right - left + 2), np.uint8)
            label[1:-1, 1:-1] = grid.label[shown]
            codes = observation_arrays.cell_codes(label, grid.polygon[shown].copy(), grid.room[shown].copy(), room)
            self._cache[width] = key, observation_arrays.pool_codes(codes, width)
        return self._cache[width][1], (top, left, rows + width - 1, columns + width - 1)


def around(grid: SemanticGrid, pose: Array, reach: int) -> Part:
    """First and last row and column of the cells within `reach` of a pose (3,), by whole blocks."""
    (x, y, _), (left, low_y), (rows, columns), ends = pose.tolist(), grid.origin.tolist(), grid.label.shape, list[int]()
    for away, size in ((y - low_y, rows), (x - left, columns)):
        at = math.floor(min(FARTHEST, max(-FARTHEST, away / grid.resolution_m)))  # nan is taken as far away
        low = min(max((at - reach) // BLOCK * BLOCK, 0), size)
        ends += [low, min(max((at + reach) // BLOCK * BLOCK + BLOCK, low), size)]
    return ends[0], ends[1], ends[2], ends[3]


def rooms_after_merges(graph: RoomGraph) -> Ints:
    """(M,) the room that each room up to the last merged one stands for."""
    return np.array([graph.resolve(room) for room in range(1 + max(graph.merged, default=-1))], np.int64)


def goal_rows(goals: Goals, columns: tuple[Column, ...]) -> Floats:
    """(32,k) the columns of the first goals of the list, their place left out."""
    rows = np.zeros((GOALS, len(columns)), np.float32)
    known = goals.path_m, goals.size_m, goals.kind, goals.room, goals.level, goals.visits, np.ones(len(goals))
    predicted = goals.sigma_m, goals.sigma_rad, goals.gain_nat
    for column, values in zip(range(2, len(columns)), (*known, *predicted), strict=False):
        rows[: len(goals), column] = values[:GOALS]
    return rows
