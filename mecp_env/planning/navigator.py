"""The drive to one goal, step by step: plan, follow, back off when stuck, refuse what fails.

Paths on the estimated grid for a round robot: costs that keep off walls, one cost-to-go field, smoothed paths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mecp_env.core import grid_paths
from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.se2 import compose
from mecp_env.planning.config import ControlConfig, GoalsConfig, PathsConfig, PlanningConfig
from mecp_env.planning.controller import can_stop, coast, follow, look_ahead, off_path, seen_points
from mecp_env.planning.goal_list import CANDIDATE, DOOR, FRONTIER, LOOK, OPEN, PLACE, Goals, Outcome
from mecp_env.planning.goal_sources import GoalContext, OpenEdge, door_places, unexplained_gaps
from mecp_env.slam.messages import NO_ID, Cell, Door, SemanticGrid
from mecp_env.slam.output import SlamOutput

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


STOP = (0.0, 0.0)
NO_PATH = np.empty((0, 2))
UNKNOWN = int(Cell.UNKNOWN)
NEAR_M = 1.0  # what is nearer to the robot is no place to drive to
LOOK_M, LOOK_DEG, KEEP_OFF_M = 3.0, 15.0, 0.6  # a look elsewhere: how far, how wide the way, how far from walls it ends
SQUEEZE = 0.5  # of what a robot keeps off, it keeps off in its last try
AHEAD = 0.3  # by which the way ahead is preferred to the way back


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Target of a drive."""

    kind: int  # GoalKind
    p_map: Array  # (2,) m
    room: int
    door: int = NO_ID

    @classmethod
    def of(cls, goals: Goals, row: int) -> Target:
        """The goal of a row."""
        return cls(int(goals.kind[row]), goals.p_map[row].copy(), int(goals.room[row]), int(goals.door[row]))


@dataclass(slots=True, eq=False)
class Navigator:
    """Drives to one target after another; plain state."""

    config: PlanningConfig
    target: Target | None = None
    outcome: Outcome = Outcome.REFUSED
    path: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n,2) m, map frame; empty: to be planned
    steps: int = 0
    way_steps: int = 0  # that the first path takes at full speed
    planned: int = 0  # step of the last plan
    planned_version: int = -1  # of the grid
    tries: int = 0  # plans without a path, in a row
    best_left_m: float = math.inf  # the shortest remaining path until now
    best_step: int = 0  # its step
    recoveries: int = 0
    backing: int = 0  # remaining steps of backing off
    dwelt: int = 0  # steps spent at the goal
    command: tuple[float, float] = STOP  # the last one of the drive

    def start(self, target: Target) -> None:
        """Start a drive."""
        self.target, self.outcome = target, Outcome.RUNNING
        self.path = NO_PATH
        self.steps = self.planned = self.tries = self.recoveries = self.backing = self.best_step = self.dwelt = 0
        self.way_steps = 0
        self.planned_version, self.best_left_m, self.command = -1, math.inf, STOP

    def step(self, output: SlamOutput) -> tuple[float, float]:
        """Speed (m/s) and turn rate (rad/s) for the next step; `outcome` is the state of the drive."""
        if self.target is None or self.outcome != Outcome.RUNNING:
            return STOP
        self.steps += 1
        self.outcome = self._judge(self.target, output)
        if self.outcome != Outcome.RUNNING:
            return STOP
        if self._there(self.target, output):
            self.dwelt += 1
            return STOP
        return self._back_off(output) if self.backing else self._drive(self.target, output)

    def _judge(self, target: Target, output: SlamOutput) -> Outcome:
        """State of the drive before this step."""
        limits = self.config.navigator
        if settled(target, output, self.config.goals):
            far = target.kind == FRONTIER and not self._there(target, output)
            return Outcome.SETTLED if far else Outcome.REACHED
        if self.dwelt >= limits.dwell_steps:
            return Outcome.REACHED
        return Outcome.REFUSED if self.steps > limits.limit_steps + self.way_steps else Outcome.RUNNING

    def _there(self, target: Target, output: SlamOutput) -> bool:
        """True when the robot is at the goal, or as near as it can come (but for a door, which lies on the path)."""
        here, goal = output.belief.T_map_robot.tolist()[:2], target.p_map.tolist()
        end = self.path[-1].tolist() if len(self.path) and target.kind != DOOR else goal
        return min(math.dist(here, end), math.dist(here, goal)) < self.config.navigator.reached_m

    def _must_plan(self, output: SlamOutput) -> bool:
        """True without a path, off it, when it is old, or when a wall appeared on it."""
        pose = output.belief.T_map_robot
        if not len(self.path) or off_path(self.path, pose[0], pose[1]) > self.config.navigator.off_path_m:
            return True
        if output.grid.version == self.planned_version:
            return False
        old, grid = self.steps - self.planned >= self.config.navigator.replan_steps, output.grid
        place = grid.origin, grid.resolution_m
        return old or bool(grid_paths.wall_on_path(grid.label, self.path, *place, self.config.paths.radius_m))

    def _plan(self, target: Target, output: SlamOutput) -> None:
        """A new path; without one the robot waits, and after some tries the goal is refused."""
        self.planned, self.planned_version = self.steps, output.grid.version
        before = len(self.path)
        self.path = plan(target, output, self.config, stuck=self.recoveries > 0)
        self.tries = 0 if len(self.path) else self.tries + 1
        if not self.way_steps and len(self.path):
            length_m = float(np.hypot(*np.diff(self.path, axis=0).T).sum())
            self.way_steps = math.ceil(length_m / (self.config.control.speed_m_s * self.config.control.period_s))
        if not before or self.tries:
            self.best_left_m, self.best_step = math.inf, self.steps
        if self.tries >= self.config.navigator.tries:
            self.outcome = Outcome.REFUSED

    def _drive(self, target: Target, output: SlamOutput) -> tuple[float, float]:
        """Follow the path, and detect missing progress."""
        if self._must_plan(output):
            self._plan(target, output)
        if not len(self.path):
            return STOP
        config = self.config
        _, _, left = look_ahead(self.path, output.belief.T_map_robot, config.control.lookahead_m)
        if left < self.best_left_m - config.navigator.progress_m:
            self.best_left_m, self.best_step = left, self.steps
        if self.steps - self.best_step >= config.navigator.stuck_steps:
            return self._recover(output)
        last_try = self.recoveries == config.navigator.recoveries > 0
        control = squeezed(config.control) if last_try else config.control
        body, laser = config.paths, output.T_robot_laser
        command = follow(self.path, output.belief.T_map_robot, output.beams, control, body, laser)
        self.command = coast(command, self.command, output.beams, control, body, laser)
        return self.command

    def _recover(self, output: SlamOutput) -> tuple[float, float]:
        """Back off and plan again; too often: refuse the goal."""
        self.recoveries += 1
        self.path = NO_PATH
        if self.recoveries > self.config.navigator.recoveries:
            self.outcome = Outcome.REFUSED
            return STOP
        self.backing = self.config.navigator.back_steps
        return self._back_off(output)

    def _back_off(self, output: SlamOutput) -> tuple[float, float]:
        """One step backwards, bending to one side and the other in turn; in place where that is blocked."""
        self.backing -= 1
        side = 1.0 if self.recoveries % 2 else -1.0
        control, body = self.config.control, self.config.paths
        back_m_s, points = self.config.navigator.back_m_s, seen_points(output.beams, control, output.T_robot_laser)
        safe = can_stop(points, -back_m_s, side, control.period_s, control.record, body.record)
        return (-back_m_s, -side * back_m_s) if safe else (0.0, side * control.turn_rad_s / 2)


@lru_cache(REMEMBERED)
def squeezed(control: ControlConfig) -> ControlConfig:
    """The controller of a robot that got stuck again and again on its way: it keeps half as far off what is seen.

    It can then leave a place that it came into through a gap hardly wider than itself.
    """
    return control.model_copy(update={"guard_m": SQUEEZE * control.guard_m})


def settled(target: Target, output: SlamOutput, config: GoalsConfig) -> bool:
    """True when a goal has nothing more to show: covered, confirmed, known, or gone."""
    if target.kind == OPEN:
        return covered(target, output)
    if target.kind == FRONTIER:
        return not unknown_near(target.p_map, output)
    if target.kind == CANDIDATE:
        return not gap_left(target, output, config)
    if target.kind in (PLACE, LOOK):
        return target.kind == LOOK and output.localised
    return door_of(target, output) is None


def gap_left(target: Target, output: SlamOutput, config: GoalsConfig) -> bool:
    """True while there is a candidate near the target, or the gap in an edge that is looked at from there."""
    goal = target.p_map.tolist()
    gaps = (candidate.ends.mean(axis=0).tolist() for candidate in output.graph.candidates)
    if any(math.dist(gap, goal) < 2.0 * config.candidate_m for gap in gaps):
        return True
    return any(faces(goal, gap, config) for gap in unexplained_gaps(GoalContext.of(output), config))


def faces(place: list[float], gap: OpenEdge, config: GoalsConfig) -> bool:
    """True when a place (x, y) m lies in front of a gap, as near as from where a candidate is looked at."""
    x, y, nx, ny, *_ = gap
    ahead, aside = (x - place[0]) * nx + (y - place[1]) * ny, (x - place[0]) * ny - (y - place[1]) * nx
    return 0.0 < ahead < 2.0 * config.candidate_m and abs(aside) < config.apart_m


def covered(target: Target, output: SlamOutput) -> bool:
    """True when a polygon of the target's room covers it."""
    grid = output.grid
    row, column = cell_of(target.p_map, grid)
    if not (0 <= row < grid.polygon.shape[0] and 0 <= column < grid.polygon.shape[1]):
        return False
    return bool(grid.polygon[row, column] and grid.room[row, column] == output.graph.resolve(target.room))


def unknown_near(p_map: Array, output: SlamOutput) -> bool:
    """True when a cell beside the one at `p_map` (2,) is unknown."""
    row, column = cell_of(p_map, output.grid)
    around = output.grid.label[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    return bool((around == UNKNOWN).any())


def cell_of(p_map: Array, grid: SemanticGrid) -> tuple[int, int]:
    """Row and column of the cell at a place (2,) m."""
    (x, y), (left, low) = p_map.tolist(), grid.origin.tolist()
    return math.floor((y - low) / grid.resolution_m), math.floor((x - left) / grid.resolution_m)


def door_of(target: Target, output: SlamOutput) -> Door | None:
    """The door of a target as it is known now."""
    return next((door for door in output.graph.doors if door.id == target.door), None)


def plan(target: Target, output: SlamOutput, config: PlanningConfig, stuck: bool = False) -> Array:
    """A path (n,2) m, map frame, to a target, a tight one where there is no other; empty when there is no path.

    While the pose is searched for, the map may be wrong here: to look elsewhere the robot drives straight on, and where
    there is no path to another target, or it is `stuck` on its way there, it does so instead.
    """
    here = output.belief.T_map_robot[:2]
    if target.kind == LOOK:
        return np.array([here, target.p_map])
    for tight in (False, True) if output.localised or not stuck else ():
        costs = cost_to_go_field(output.grid, output.belief.T_map_robot, config.paths, tight)
        path = plan_over(costs, target, output, config)
        if len(path):
            return path
    ahead = None if output.localised else open_floor(output)
    return NO_PATH if ahead is None else np.array([here, ahead])


def open_floor(output: SlamOutput) -> Array | None:
    """(2,) m, map frame: the farthest open floor that the scan shows, at most 3 m away; None where all is near.

    It is relative to the robot, so that it is right also in a map frame that is not.
    """
    beams, half = output.beams, max(1, round(math.radians(LOOK_DEG) / (2.0 * math.pi) * len(output.beams.ranges)))
    around = np.take(beams.ranges, np.arange(-half, len(beams.ranges) + half), mode="wrap")
    open_m = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1).min(axis=1) - KEEP_OFF_M
    best = int(np.argmax(np.minimum(open_m, LOOK_M) * (1.0 + AHEAD * np.cos(beams.bearings))))
    far_m = min(float(open_m[best]), LOOK_M)
    if far_m < NEAR_M:
        return None
    T_map_laser = compose(output.belief.T_map_robot, output.T_robot_laser)
    bearing = T_map_laser[2] + beams.bearings[best]
    place: Array = T_map_laser[:2] + far_m * np.array([math.cos(bearing), math.sin(bearing)])
    return place


def plan_over(costs: CostToGoField, target: Target, output: SlamOutput, config: PlanningConfig) -> Array:
    """A path (n,2) m, map frame, to a target; empty when there is no path."""
    door = door_of(target, output)
    if target.kind == DOOR and door is not None:
        return plan_through(door, output, costs, config)
    cell = costs.nearest(target.p_map, config.goals.reach_m)
    return NO_PATH if cell is None else costs.path(cell)


def plan_through(door: Door, output: SlamOutput, costs: CostToGoField, config: PlanningConfig) -> Array:
    """A path through the middle of a door along its normal; beyond it the floor need not be known.

    A robot that stands in the door, or just before or behind it, goes straight on.
    """
    (place,) = door_places([door], output.belief)
    middle, onward = np.array(place[:2]), np.array(place[2:4])
    beyond = middle + config.goals.door_beyond_m * onward
    robot = output.belief.T_map_robot[:2]
    offset = robot - middle
    along, aside = float(offset @ onward), abs(float(offset[0] * onward[1] - offset[1] * onward[0]))
    if -config.navigator.approach_m - 0.1 < along < config.goals.door_beyond_m and aside < 0.2:
        return np.array([robot, middle, beyond] if along < 0.0 else [robot, beyond])
    cell = costs.nearest(middle - config.navigator.approach_m * onward, config.goals.reach_m)
    return NO_PATH if cell is None else np.concatenate([costs.path(cell), [middle, beyond]])
