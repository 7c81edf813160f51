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
from mecp_env.episode.observation_arrays import GOALS, LANDMARKS, Part
from mecp_env.planning.goals import Goals
from mecp_env.slam.messages import FeatureTable, RoomGraph, SemanticGrid
from mecp_env.slam.output import SlamOutput

GRID = (96, 0.2)  # cells per side, m per cell
MAP = (64, 0.8)
EXTENT_M = 200.0  # bound of every position and length
COV_MAX = 100.0  # bound of every covariance (m^2, m rad, rad^2)
SIGMA_MAX_M = 10.0  # bound of a predicted standard deviation
SIGMA_MAX_RAD = 10.0
GAIN_MAX_NAT = 1000.0  # bound of a predicted gain of information
LABEL_MAX = 255.0  # bound of room ids, levels and visits; rooms may be -1, unknown
TRAIL_STEP_M = 0.1
GOAL_COLUMNS = 27  # of the tables pose, pose_cov, landmarks and goals, without the predicted ones of the goals
BLOCK = 32  # cells: what is kept of a grid begins and ends at multiples
FARTHEST = 2.0**40  # cells
NOTHING_MERGED = np.empty(0, np.int64)


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


def bounds(rows: int, low: list[float], high: list[float]) -> spaces.Box:
    """A float32 box of `rows` rows with the bounds of each column."""
    return spaces.Box(
        np.tile(np.array(low, np.float32), (rows, 1)), np.tile(np.array(high, np.float32), (rows, 1)), dtype=np.float32
    )


def make_space(with_map: bool, beams: int, max_range_m: float, uncertainty: bool = False) -> spaces.Dict:
    """The observation space; `beams` is 0 without the scan."""
    far, cov, label = EXTENT_M, COV_MAX, LABEL_MAX
    goal_low, goal_high = [-far, -far, 0, 0, 0, -1, 0, 0, 0], [far, far, far, far, 3, label, label, label, 1]
    if uncertainty:
        goal_low = [*goal_low, 0, 0, 0]
        goal_high = [*goal_high[:4], 6, *goal_high[5:], SIGMA_MAX_M, SIGMA_MAX_RAD, GAIN_MAX_NAT]
    parts: dict[str, spaces.Space[Any]] = {
        "budget": spaces.Box(0.0, 1.0, (1,), np.float32),
        "pose": spaces.Box(np.array([-far, -far, -1, -1], np.float32), np.array([far, far, 1, 1], np.float32)),
        "pose_cov": spaces.Box(
            np.array([0, -cov, -cov, 0, -cov, 0], np.float32), np.full(6, cov, np.float32), dtype=np.float32
        ),
        "landmarks": bounds(LANDMARKS, [-far, -far, 0, -cov, 0, -1, 0, 0], [far, far, cov, cov, cov, label, 2, 1]),
        "goals": bounds(GOALS, goal_low, goal_high),
        "grid": spaces.Box(0, 255, (len(observation_arrays.LAYERS), GRID[0], GRID[0]), np.uint8),
    }
    if with_map:
        parts["map"] = spaces.Box(0, 255, (len(observation_arrays.LAYERS), MAP[0], MAP[0]), np.uint8)
    if uncertainty:
        parts["localisation"] = spaces.Box(0.0, 1.0, (3,), np.float32)
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
        self._tables, self._windows = BeliefTables(uncertainty), GridWindows()
        self._scan_limits = column_limits(self.space, ("scan",) if beams else ())
        self._uncertainty = uncertainty

    def observe(self, seen: Seen) -> tuple[dict[str, NDArray[Any]], int]:
        """The observation in fresh arrays, and how many of its values were cut to their bounds or left out."""
        output, goals, trail = seen.output, seen.goals, seen.path
        tables, outside = self._tables.read(output, seen.features, goals)
        observation: dict[str, NDArray[Any]] = dict(tables)
        observation["budget"] = np.array([seen.budget], np.float32)
        observation["grid"] = self._windows.layers(output, trail, GRID)
        if "map" in self.space.spaces:
            observation["map"] = self._windows.layers(output, trail, MAP)
        if self._uncertainty:
            trust = output.confidence, output.localised, seen.recognised
            observation["localisation"] = np.array(trust, np.float32)
        if "scan" in self.space.spaces:
            observation["scan"] = scan = output.beams.ranges.astype(np.float32)
            outside += observation_arrays.saturate(scan.reshape(1, -1), self._scan_limits, 0)
        left_out = max(0, len(output.belief.ids) - LANDMARKS) + max(0, len(goals) - GOALS)
        return observation, left_out + outside


class BeliefTables:
    """The tables `pose`, `pose_cov`, `landmarks` and `goals` of `Observer`; keeps only a cache."""

    def __init__(self, uncertainty: bool = False) -> None:
        space = make_space(False, 0, 1.0, uncertainty)
        self._limits = column_limits(space, ("pose", "pose_cov", "landmarks", "goals"))  # goals: the last columns
        self._predicted_limits = self._limits[:, GOAL_COLUMNS:] if uncertainty else None
        self._goals, self._goal_rows = Goals(), goal_rows(Goals())
        self._became, self._merges = NOTHING_MERGED, 0

    def read(
        self, output: SlamOutput, features: FeatureTable, goals: Goals
    ) -> tuple[dict[str, NDArray[np.float32]], int]:
        """The tables in fresh arrays, and how many of their values were cut to their bounds."""
        became, rows = self._rooms(output.graph), self._goal_columns(goals).copy()
        tables, outside = observation_arrays.belief_tables(
            output.belief, features, became, rows, goals.p_map, self._limits
        )
        if self._predicted_limits is not None:
            predicted = predicted_columns(goals)
            outside += observation_arrays.saturate(predicted, self._predicted_limits, 0)
            tables["goals"] = np.concatenate([tables["goals"], predicted], axis=1)
        return tables, outside

    def _goal_columns(self, goals: Goals) -> NDArray[np.float32]:
        """(32,9) the first goals of the list without their place; they change only when goals are looked for."""
        if goals is not self._goals:
            self._goals, self._goal_rows = goals, goal_rows(goals)
        return self._goal_rows

    def _rooms(self, graph: RoomGraph) -> Ints:
        """(M,) what each room became after all merges; a room beyond the table is itself."""
        if len(graph.merged) != self._merges:
            self._merges, self._became = len(graph.merged), rooms_after_merges(graph)
        return self._became


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
            shown = np.s_[top:bottom, left:right]
            label, polygon, rooms = grid.label[shown].copy(), grid.polygon[shown].copy(), grid.room[shown].copy()
            codes = observation_arrays.pool_codes(observation_arrays.cell_codes(label, polygon, rooms, room), width)
            self._cache[width] = key, codes
        return self._cache[width][1], (top, left, rows + width - 1, columns + width - 1)


def around(grid: SemanticGrid, pose: Array, reach: int) -> Part:
    """First and last row and column of the cells within `reach` of a pose (3,), by whole blocks."""
    (x, y, _), (left, low_y), (rows, columns), ends = pose.tolist(), grid.origin.tolist(), grid.label.shape, list[int]()
    for away, size in ((y - low_y, rows), (x - left, columns)):
        at = math.floor(min(FARTHEST, max(-FARTHEST, away / grid.resolution_m)))  # nan is taken as far away
        low = min(max((at - reach) // BLOCK * BLOCK, 0), size)
        ends += [low, min(max((at + reach) // BLOCK * BLOCK + BLOCK, low), size)]
    return ends[0], ends[1], ends[2], ends[3]


def column_limits(space: spaces.Dict, names: tuple[str, ...]) -> NDArray[np.float32]:
    """(2,k) lower and upper bound of the columns of some tables, one table after the other."""
    boxes = [space.spaces[name] for name in names]
    rows = [[np.atleast_2d(bound)[0] for bound in (box.low, box.high)] for box in boxes if isinstance(box, spaces.Box)]
    return np.concatenate([np.empty((2, 0), np.float32), *(np.array(row, np.float32) for row in rows)], axis=1)


def rooms_after_merges(graph: RoomGraph) -> Ints:
    """(M,) the room that each room up to the last merged one stands for."""
    return np.array([graph.resolve(room) for room in range(1 + max(graph.merged, default=-1))], np.int64)


def predicted_columns(goals: Goals) -> NDArray[np.float32]:
    """(32,3) predicted sigmas on arrival and gain of information of the first goals of the list."""
    rows = np.zeros((GOALS, 3), np.float32)
    for column, values in enumerate((goals.sigma_m, goals.sigma_rad, goals.gain_nat)):
        rows[: len(values), column] = values[:GOALS]
    return rows


def goal_rows(goals: Goals) -> NDArray[np.float32]:
    """(32,9) the columns of the first goals of the list, their place left out."""
    rows = np.zeros((GOALS, 9), np.float32)
    columns = (goals.path_m, goals.size_m, goals.kind, goals.room, goals.level, goals.visits, np.ones(len(goals)))
    for column, values in enumerate(columns, start=2):
        rows[: len(goals), column] = values[:GOALS]
    return rows
