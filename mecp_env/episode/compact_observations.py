"""Observations of the formats "flat" and "image": one array each, from the estimate alone (docs/observations.md)."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.se2 import to_robot
from mecp_env.episode.flat import GOAL, KINDS, NEAR_S, PREDICTED, ROWS, fill_flat, flat_columns
from mecp_env.episode.observation_arrays import LAYERS
from mecp_env.episode.observations import GridWindows, Seen
from mecp_env.planning.goals import Goals
from mecp_env.planning.row_times import RowTimes

Floats = NDArray[np.float32]

DERIVED = 5  # columns of a goal that depend on the pose or the grid
IMAGE = (64, 0.4)  # cells per side, m per cell
CHANNELS = (  # layer and shade, the later over the earlier
    (("unknown", 170), ("occupied", 255)),
    (("door", 85), ("frontier", 170), ("goal", 255)),
    (("polygon", 85), ("room", 170), ("path", 255)),
)
BUDGET_SHADE = 255


class Flat:
    """Computes observations of the format "flat": float32 (n,) in [-1, 1], whose columns `mecp_env.flat_names` names.

    With `actions="goal"`, all 32 rows of goals are described, row k for action k (n = 325, 421 with `uncertainty`);
    with other actions, the 16 that are nearest in time (n = 181, 229). Lengths and counts are squashed, so that no
    bound cuts them. Rows without a goal are 0.
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

    def _goal_rows(self, goals: Goals) -> Array:
        """(g,2+k) what `fill_flat` reads of the goals that are described."""
        seconds = self._times.seconds(goals)
        order = np.argsort(seconds, kind="stable") if self._nearest_first else np.arange(len(goals))
        near, kind = NEAR_S / (NEAR_S + seconds), (goals.kind + 1.0) / KINDS
        columns = (near, goals.size_m, goals.visits, kind, goals.sigma_m, goals.sigma_rad, goals.gain_nat)
        rows: Array = np.column_stack([goals.p_map, *columns[: self._last]])[order[: self._most]]
        return np.ascontiguousarray(rows)


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
