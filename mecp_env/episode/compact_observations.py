"""Observations of the formats "flat" and "image": one array each, from the estimate alone (docs/observations.md)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.errors import ConfigError
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import to_robot
from mecp_env.core.settings import guess
from mecp_env.episode.observation_arrays import LAYERS
from mecp_env.episode.observations import GridWindows, Seen
from mecp_env.planning.goal_list import PLACE, GoalKind, RowTimes, drawing_sigma
from mecp_env.planning.goals import Goals
from mecp_env.slam.messages import Cell, SemanticGrid

Column = tuple[str, float]  # name, and h of v / (|v| + h) in SI units; 0 for a number that is within [-1, 1] by itself

SECTORS = 24  # of the ranges
ROWS = {"goal": 32, "velocity": 16, "discrete": 16}  # of goals, by the actions of the environment
NEAR_S = 10.0  # the time at which `near` is 0.5

HEAD: tuple[Column, ...] = (
    ("start_cos", 0.0),
    ("start_sin", 0.0),
    ("start_distance", 10.0),
    ("sigma_ahead", 0.1),
    ("sigma_left", 0.1),
    ("sigma_heading", 0.05),
    ("confidence", 0.0),
    ("localised", 0.0),
    ("recognised", 0.0),
    ("budget", 0.0),
    ("floor", 100.0),
    ("goals", 10.0),
    ("landmarks", 10.0),
)
RANGES: tuple[Column, ...] = tuple((f"range_{360 * k // SECTORS}", 0.0) for k in range(SECTORS))
GOAL: tuple[Column, ...] = (
    ("valid", 0.0),
    ("cos", 0.0),
    ("sin", 0.0),
    ("distance", 5.0),
    ("floor", 5.0),
    ("near", 0.0),
    ("width", 1.0),
    ("visits", 1.0),
    ("kind", 0.0),
)
PREDICTED: tuple[Column, ...] = (("sigma_m", 0.1), ("sigma_rad", 0.05), ("gain", 10.0))
Floats = NDArray[np.float32]
Grid = tuple[Bytes, Array, float]  # (H,W) Cell, (2,) m the lower left corner in the map frame, m per cell
NO_BEAM = -1.0
RANGE_M = 2.0  # where a range is squashed to 0.5
KINDS = float(len(GoalKind))
EXPLORED = (GoalKind.PLACE + 0.5) / KINDS  # the column `kind` of what explores is below
FIRST_RANGE = len(HEAD)
FIRST_GOAL = FIRST_RANGE + SECTORS
SIGHT_M, WALL_M = 5.0, 0.3  # range of the imaginary scan; a wall nearer than `WALL_M` belongs to the goal itself
DEPTH_M = 2.0  # of unknown cells, after which a beam ends: rank correlation with what drives map .61, without it .43
BEAMS = 24
SECTOR_RAD, BEAM_RAD = 2.0 * math.pi / SECTORS, 2.0 * math.pi / BEAMS
UNKNOWN, OCCUPIED = int(Cell.UNKNOWN), int(Cell.OCCUPIED)
DIRECTIONS = np.array([(math.cos(k * BEAM_RAD), math.sin(k * BEAM_RAD)) for k in range(BEAMS)])
METRE = 0.02  # what a metre of the way to a place costs, as a share of the present deviation, as in `Returning`
POWER, START_M, LEAST_M2 = 0.7, 2.0, 0.1  # of the value of a goal, as in `NextBestView`
DERIVED = 5  # columns of a goal that depend on the pose or the grid
IMAGE = (64, 0.4)  # cells per side, m per cell
CHANNELS = (  # layer and shade, the later over the earlier
    (("unknown", 170), ("occupied", 255)),
    (("door", 85), ("frontier", 170), ("goal", 255)),
    (("polygon", 85), ("room", 170), ("path", 255)),
)
BUDGET_SHADE = 255


def flat_columns(actions: str, uncertainty: bool) -> tuple[Column, ...]:
    """Name and h of each number of a flat observation, in its order.

    Raises `ConfigError` for unknown actions.
    """
    if actions not in ROWS:
        known = ", ".join(map(repr, ROWS))
        raise ConfigError(f"actions: expected one of {known}, got {actions!r}{guess(actions, ROWS)}")
    goal = (*GOAL, *PREDICTED) if uncertainty else GOAL
    goals = tuple((f"goal_{row}_{name}", half) for row in range(ROWS[actions]) for name, half in goal)
    return (*HEAD, *RANGES, *goals)


def flat_names(env: Any = None, *, actions: str = "velocity", uncertainty: bool = False) -> tuple[str, ...]:
    """The name of each number of a flat observation: see `mecp_env.flat_names`."""
    if env is not None:
        config = getattr(getattr(env, "unwrapped", None), "config", None)
        seen = getattr(config, "observation", None)
        if config is None or seen is None:
            raise ConfigError(f"flat_names: env: expected a mecp_env environment, got {env!r:.80}")
        if seen.format != "flat":
            raise ConfigError(f"flat_names: env: expected observation='flat', got {seen.format!r}")
        actions, uncertainty = config.actions, seen.uncertainty
    return tuple(name for name, _ in flat_columns(actions, uncertainty))


@compiled
def fill_flat(
    flat: Floats,
    halves: Floats,
    belief: tuple[Array, Array],
    figures: tuple[float, float, float, float, float, float],
    rows: tuple[Ints, Array],
    beams: tuple[Array, Array, float],
    grid: Grid,
) -> int:
    """Fill `flat` (n,), which is 0, in the order of `flat_columns`; how many values were not finite, and became 0.

    `halves` (n,): the h of each column. `belief`: pose (3,) and its covariance (3,3). `figures`: confidence, localised,
    recognised, budget, number of goals and of landmarks. `rows`: (g,) which row describes each goal, and (g,2+k) its
    x, y (m, map frame) and last k columns. `beams`: bearings and ranges (b,) of the merged scan, and the heading of the
    laser on the robot.
    """
    (pose, cov), (bearings, ranges, heading), (label, _, cell_m) = belief, beams, grid
    c, s, far = math.cos(pose[2]), math.sin(pose[2]), math.hypot(pose[0], pose[1])
    if far > 0.0:
        flat[0], flat[1], flat[2] = -(c * pose[0] + s * pose[1]) / far, (s * pose[0] - c * pose[1]) / far, far
    both = 2.0 * c * s * cov[0, 1]
    flat[3] = math.sqrt(max(c * c * cov[0, 0] + both + s * s * cov[1, 1], 0.0))
    flat[4] = math.sqrt(max(s * s * cov[0, 0] - both + c * c * cov[1, 1], 0.0))
    flat[5] = math.sqrt(max(cov[2, 2], 0.0))
    mapped, cells = 0, label.reshape(-1)
    for i in range(cells.shape[0]):
        mapped += cells[i] != UNKNOWN
    flat[6], flat[7], flat[8], flat[9], flat[11], flat[12] = figures
    flat[10] = mapped * cell_m * cell_m
    nearest = np.full(SECTORS, math.inf)
    for i in range(ranges.shape[0]):
        sector = math.floor((bearings[i] + heading) * (1.0 / SECTOR_RAD) + 0.5)
        sector += SECTORS * ((sector < 0) - (sector >= SECTORS))
        nearest[sector] = min(nearest[sector], ranges[i])
    for k in range(SECTORS):
        flat[FIRST_RANGE + k] = nearest[k] / (nearest[k] + RANGE_M) if nearest[k] < math.inf else NO_BEAM
    place, goals = rows
    width = goals.shape[1] + 3
    for g in range(goals.shape[0]):
        at = FIRST_GOAL + place[g] * width
        dx, dy = goals[g, 0] - pose[0], goals[g, 1] - pose[1]
        far = math.hypot(dx, dy)
        flat[at] = 1.0
        if far > 0.0:
            flat[at + 1], flat[at + 2], flat[at + 3] = (c * dx + s * dy) / far, (c * dy - s * dx) / far, far
        if goals[g, 5] < EXPLORED:
            flat[at + 4] = unseen_floor(goals[g, 0], goals[g, 1], grid)
        for k in range(5, width):
            flat[at + k] = goals[g, k - 3]
    outside = 0
    for i in range(flat.shape[0]):
        if not math.isfinite(flat[i]):
            flat[i] = 0.0
            outside += 1
        elif halves[i] > 0.0:
            flat[i] /= abs(flat[i]) + halves[i]
    return outside


@compiled
def unseen_floor(x: float, y: float, grid: Grid) -> float:
    """m^2 of unknown cells that a scan at x, y (m, map frame) would see, with 24 beams of 5 m.

    The integral of r dr da over the unknown part of the beams (Gonzalez-Banos and Latombe 2002). A beam ends at the
    first known wall, and after 2 m of unknown cells: some wall is there. What is outside the grid is unknown.
    """
    label, corner, cell_m = grid
    rows, cols = label.shape
    u, v, steps = (x - corner[0]) / cell_m, (y - corner[1]) / cell_m, int(SIGHT_M / cell_m)
    area, deepest = 0.0, int(DEPTH_M / cell_m)
    for k in range(BEAMS):
        depth = 0
        for i in range(1, steps + 1):
            column, row = math.floor(u + i * DIRECTIONS[k, 0]), math.floor(v + i * DIRECTIONS[k, 1])
            cell = UNKNOWN
            if (0 <= row < rows) & (0 <= column < cols):
                cell = label[row, column]
            if depth == deepest or (cell == OCCUPIED and i * cell_m > WALL_M):
                break
            area += i * (cell == UNKNOWN)
            depth += cell == UNKNOWN
    return area * cell_m * cell_m * BEAM_RAD


def most_floor_first(goals: Goals, grid: SemanticGrid) -> Goals:
    """The goals in the order of their expected new floor per path, floor^0.7 / (path + 2 m).

    A network sees row k at the same place: so row k means the same, and the first row is no bad choice.
    """
    place = grid.label, grid.origin, float(grid.resolution_m)
    floor_m2 = np.array([unseen_floor(x, y, place) for x, y in goals.p_map.tolist()])
    value = np.maximum(floor_m2, LEAST_M2) ** POWER / (goals.path_m + START_M)
    return goals.in_order(np.argsort(-value, kind="stable"))


def best_place_last(goals: Goals, pose_cov: Array) -> Goals:
    """The goals with the places on known ground from the worst to the best; waiting stays the last.

    The best one has the least predicted deviation on arrival, of what is drawn 4 m ahead, and cost of the way, 2 % of
    the present deviation per metre.
    """
    x, y, heading = np.maximum(np.diagonal(pose_cov), 0.0).tolist()
    now_m = float(drawing_sigma(np.sqrt(0.5 * (x + y)), np.sqrt(heading)))
    cost = drawing_sigma(goals.sigma_m, goals.sigma_rad) + METRE * now_m * goals.path_m
    return goals.in_order(np.lexsort((np.where(goals.kind == PLACE, -cost, 0.0), goals.kind >= PLACE)))


class Flat:
    """Computes observations of the format "flat": float32 (n,) in [-1, 1], whose columns `mecp_env.flat_names` names.

    With `actions="goal"`, all 32 rows of goals are described, row k for action k (n = 325, 421 with `uncertainty`):
    those that explore from the first on, known ground up to the last. With other actions, the 16 that are nearest in
    time (n = 181, 229). Lengths and counts are squashed, so that no bound cuts them. Rows without a goal are 0.
    """

    def __init__(self, actions: str, uncertainty: bool = False, times: RowTimes | None = None) -> None:
        """`times`: how long each row takes."""
        columns = flat_columns(actions, uncertainty)
        self._halves = np.array([half for _, half in columns], np.float32)
        self.space = spaces.Box(-1.0, 1.0, (len(columns),), np.float32)
        self._most, self._last = ROWS[actions], len(GOAL) + uncertainty * len(PREDICTED) - DERIVED
        self._nearest_first, self._times = actions != "goal", times or RowTimes()
        self._goals, self._rows = Goals(), self._goal_rows(Goals())

    def observe(self, seen: Seen) -> tuple[Floats, int]:
        """The observation in a fresh array, and how many values were not finite, and goals left out."""
        output, belief, grid, goals = seen.output, seen.output.belief, seen.output.grid, seen.goals
        if goals is not self._goals:  # they change only when goals are looked for
            self._goals, self._rows = goals, self._goal_rows(goals)
        flat = np.zeros(len(self._halves), np.float32)
        trust = float(output.confidence), float(output.localised), float(seen.recognised), float(seen.budget)
        outside = fill_flat(
            flat,
            self._halves,
            (np.ascontiguousarray(belief.T_map_robot), np.ascontiguousarray(belief.pose_cov)),
            (*trust, float(len(goals)), float(len(belief.ids))),
            self._rows,
            (output.beams.bearings, output.beams.ranges, float(output.T_robot_laser[2])),
            (grid.label, grid.origin, float(grid.resolution_m)),
        )
        return flat, outside + max(0, len(goals) - self._most)

    def _goal_rows(self, goals: Goals) -> tuple[Ints, Array]:
        """What `fill_flat` reads of the goals that are described: the row (g,) and the numbers (g,2+k) of each."""
        seconds = self._times.seconds(goals)
        order = np.argsort(seconds, kind="stable") if self._nearest_first else np.arange(len(goals))
        near, kind = NEAR_S / (NEAR_S + seconds), (goals.kind + 1.0) / KINDS
        columns = (near, goals.size_m, goals.visits, kind, goals.sigma_m, goals.sigma_rad, goals.gain_nat)
        rows: Array = np.column_stack([goals.p_map, *columns[: self._last]])[order[: self._most]]
        places = np.arange(len(rows)) if self._nearest_first else goals.actions(self._most, True)[: self._most]
        return places, np.ascontiguousarray(rows)


class Image:
    """Computes observations of the format "image": uint8 (3,64,64), channels first, cells of 0.4 m around the robot.

    Its heading is up. The channels have shades: what blocks (unknown 170, occupied 255, free 0), where to go (door 85,
    frontier 170, goal 255), and where the robot was (polygon 85, its room 170, its path 255). The last row of the last
    channel is a bar instead: 255 from the left over the share of the step budget that is left, then 0.
    """

    def __init__(self) -> None:
        self.space = spaces.Box(0, 255, (len(CHANNELS), IMAGE[0], IMAGE[0]), np.uint8)
        self._windows = GridWindows()

    def observe(self, seen: Seen) -> tuple[Bytes, int]:
        """The observation in a fresh array, and 0: nothing in it is cut."""
        layers = dict(zip(LAYERS, self._windows.layers(seen.output, seen.path, IMAGE) > 0, strict=True))
        layers["unknown"] &= ~layers["free"]
        layers["goal"] = goal_cells(to_robot(seen.output.belief.T_map_robot, seen.goals.p_map))
        image = np.zeros(self.space.shape, np.uint8)
        for channel, shades in zip(image, CHANNELS, strict=True):
            for name, shade in shades:
                channel[layers[name]] = shade
        image[-1, -1] = 0
        image[-1, -1, : round(IMAGE[0] * seen.budget)] = BUDGET_SHADE
        return image, 0


def goal_cells(p_robot: Array) -> NDArray[np.bool_]:
    """(64,64) True in the cells of goals (g,2) m, robot frame, and those beside them."""
    n, side = IMAGE
    cells = np.zeros((n, n), np.bool_)
    for row, column in np.floor(0.5 * n - p_robot / side).astype(np.intp).tolist():
        cells[max(0, row - 1) : max(0, row + 2), max(0, column - 1) : max(0, column + 2)] = True
    return cells
