"""Observations of the formats "flat" and "image": one array each, from the estimate alone (docs/observations.md)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.array_types import Array, Bytes
from mecp_env.core.se2 import to_robot
from mecp_env.episode.observation_arrays import LAYERS
from mecp_env.episode.observations import BeliefTables, GridWindows, TravelledPath
from mecp_env.planning.goals import Goals
from mecp_env.slam.messages import FeatureTable, SlamOutput

Floats = NDArray[np.float32]

FLAT_SECTORS, FLAT_GOALS, FLAT_LANDMARKS = 24, 8, 4
IMAGE = (64, 0.4)  # cells per side, m per cell
CHANNELS = (  # layer and shade, the later over the earlier
    (("unknown", 170), ("occupied", 255)),
    (("door", 85), ("frontier", 170), ("goal", 255)),
    (("polygon", 85), ("room", 170), ("path", 255)),
)
NO_BEAM = -1.0
KINDS = 7.0

# where a squashed column is 0.5
POSITION_M, DISTANCE_M, RANGE_M, SIGMA_M, SIGMA_RAD, WIDTH_M = 10.0, 5.0, 2.0, 0.1, 0.05, 1.0
FLOOR_M2, COUNTED, GAIN_NAT = 100.0, 10.0, 10.0


def squash(values: Any, half: Any) -> Any:
    """`values` of any size in (-1, 1): v / (|v| + half), which keeps order and sign and cuts nothing."""
    return values / (np.abs(values) + half)


class Flat:
    """Computes observations of the format "flat": float32 (104,) in [-1, 1], (128,) with `uncertainty`.

    `columns` names each number; docs/observations.md describes them. All lengths and counts are squashed, so that no
    bound cuts them. Rows of goals and landmarks that do not exist are 0.
    """

    def __init__(self, uncertainty: bool = False, nearest_first: bool = True) -> None:
        self.columns = flat_columns(uncertainty)
        self.space = spaces.Box(-1.0, 1.0, (len(self.columns),), np.float32)
        self._tables = BeliefTables(uncertainty=True)  # has all kinds of goals
        self._goal_columns = 12 if uncertainty else 9
        self._nearest_first = nearest_first

    def observe(
        self, output: SlamOutput, features: FeatureTable, goals: Goals, trail: TravelledPath, recognised: float = 0.0
    ) -> tuple[Floats, int]:
        """The observation in a fresh array, and how many values of the estimate were out of bounds."""
        tables, outside = self._tables.read(output, features, goals)
        trust = (output.confidence, output.localised, recognised)
        parts = (
            *(flat_pose(tables["pose"]), flat_covariance(tables["pose_cov"]), trust, flat_progress(output, goals)),
            flat_ranges(output),
            flat_goals(tables["goals"][:, : self._goal_columns], self._nearest_first).ravel(),
            flat_landmarks(tables["landmarks"]).ravel(),
        )
        return np.concatenate(parts, dtype=np.float32), outside


def flat_columns(uncertainty: bool = False) -> tuple[str, ...]:
    """The name of each number of a flat observation."""
    predicted = ("sigma_m", "sigma_rad", "gain") if uncertainty else ()
    goal = ("cos", "sin", "distance", "path", "width", "kind", *predicted)
    landmark = ("cos", "sin", "distance", "sigma_m")
    return (
        *("x", "y", "cos_heading", "sin_heading"),
        *("sigma_x", "sigma_y", "sigma_heading", "corr_x_y", "corr_x_heading", "corr_y_heading"),
        *("confidence", "localised", "recognised"),
        *("floor", "goals", "landmarks"),
        *(f"range_{360 * k // FLAT_SECTORS}" for k in range(FLAT_SECTORS)),
        *(f"goal_{k}_{name}" for k in range(FLAT_GOALS) for name in goal),
        *(f"landmark_{k}_{name}" for k in range(FLAT_LANDMARKS) for name in landmark),
    )


def flat_pose(pose: Floats) -> Floats:
    """(4,) x and y squashed, cos and sin of the heading, of `pose` (4,)."""
    flat = pose.copy()
    flat[:2] = squash(pose[:2], POSITION_M)
    return flat


def flat_covariance(cov: Floats) -> Array:
    """(6,) squashed standard deviations of x, y, heading, and the correlations xy, x heading, y heading.

    `cov` (6,): xx, xy, x heading, yy, y heading, heading heading. A correlation with an exact quantity is 0.
    """
    sigma = np.sqrt(np.maximum(cov[[0, 3, 5]].astype(np.float64), 0.0))
    product = sigma[[0, 0, 1]] * sigma[[1, 2, 2]]
    correlation = np.divide(cov[[1, 2, 4]], product, out=np.zeros(3), where=product > 0.0)
    return np.concatenate([squash(sigma, np.array([SIGMA_M, SIGMA_M, SIGMA_RAD])), correlation.clip(-1.0, 1.0)])


def flat_progress(output: SlamOutput, goals: Goals) -> tuple[float, float, float]:
    """Mapped floor, goals left and landmarks, squashed."""
    floor_m2 = np.count_nonzero(output.grid.label) * output.grid.resolution_m**2  # UNKNOWN is 0
    counts = ((floor_m2, FLOOR_M2), (len(goals), COUNTED), (len(output.belief.ids), COUNTED))
    floor, left, landmarks = (float(squash(value, half)) for value, half in counts)
    return floor, left, landmarks


def flat_ranges(output: SlamOutput) -> Array:
    """(24,) the squashed nearest range in each sector of 15 degrees around the laser; -1 where it does not look.

    The first sector is centred on the robot's heading, the others follow counter-clockwise.
    """
    bearings, width = output.beams.bearings + output.T_robot_laser[2], 2.0 * math.pi / FLAT_SECTORS
    sector = np.rint(bearings / width).astype(np.intp) % FLAT_SECTORS
    starts = np.flatnonzero(np.concatenate(([True], sector[1:] != sector[:-1])))  # of the runs of beams in one sector
    nearest = np.full(FLAT_SECTORS, np.inf)
    np.minimum.at(nearest, sector[starts], np.minimum.reduceat(output.beams.ranges, starts))
    seen = np.isfinite(nearest)
    return np.where(seen, squash(np.where(seen, nearest, 0.0), RANGE_M), NO_BEAM)


def flat_goals(rows: Floats, nearest_first: bool) -> Floats:
    """(8,6) or (8,9) cos and sin of the bearing, distance, path, width, kind, and what is predicted of each goal.

    `rows` (32,9) or (32,12): as in the observation `goals`. Without `nearest_first` they keep their order.
    """
    if nearest_first:
        rows = rows[np.argsort(np.where(rows[:, 8] > 0.0, rows[:, 2], np.inf), kind="stable")]
    rows = rows[:FLAT_GOALS]
    flat = np.empty((FLAT_GOALS, rows.shape[1] - 3), np.float32)
    flat[:, :3] = polar(rows[:, :2])
    flat[:, 3], flat[:, 4] = squash(rows[:, 2], DISTANCE_M), squash(rows[:, 3], WIDTH_M)
    flat[:, 5] = (rows[:, 4] + 1.0) / KINDS
    flat[:, 6:] = squash(rows[:, 9:], np.array((SIGMA_M, SIGMA_RAD, GAIN_NAT)[: rows.shape[1] - 9], np.float32))
    flat[rows[:, 8] == 0.0] = 0.0
    return flat


def flat_landmarks(rows: Floats) -> Floats:
    """(4,4) cos and sin of the bearing, distance, and standard deviation of the position of the nearest landmarks.

    `rows` (128,8): as in the observation `landmarks`.
    """
    rows = rows[:FLAT_LANDMARKS]
    flat = np.empty((FLAT_LANDMARKS, 4), np.float32)
    flat[:, :3] = polar(rows[:, :2])
    flat[:, 3] = squash(np.sqrt(np.maximum(rows[:, 2] + rows[:, 4], 0.0)), SIGMA_M)
    flat[rows[:, 7] == 0.0] = 0.0
    return flat


def polar(p_robot: Floats) -> Floats:
    """(n,3) cos and sin of the bearing and squashed distance of points (n,2) m in the robot's frame."""
    far = np.hypot(p_robot[:, 0], p_robot[:, 1])
    unit = np.divide(p_robot, far[:, None], out=np.zeros_like(p_robot), where=far[:, None] > 0.0)
    return np.concatenate([unit, squash(far, DISTANCE_M)[:, None]], axis=1)


class Image:
    """Computes observations of the format "image": uint8 (3,64,64), channels first, cells of 0.4 m around the robot.

    Its heading is up. The channels have shades: what blocks (unknown 170, occupied 255, free 0), where to go (door 85,
    frontier 170, goal 255), and where the robot was (polygon 85, its room 170, its path 255).
    """

    def __init__(self) -> None:
        self.space = spaces.Box(0, 255, (len(CHANNELS), IMAGE[0], IMAGE[0]), np.uint8)
        self._windows = GridWindows()

    def observe(
        self, output: SlamOutput, features: FeatureTable, goals: Goals, trail: TravelledPath, recognised: float = 0.0
    ) -> tuple[Bytes, int]:
        """The observation in a fresh array, and 0: nothing in it is cut."""
        layers = dict(zip(LAYERS, self._windows.layers(output, trail, IMAGE) > 0, strict=True))
        layers["unknown"] &= ~layers["free"]
        layers["goal"] = goal_cells(to_robot(output.belief.T_map_robot, goals.p_map))
        image = np.zeros(self.space.shape, np.uint8)
        for channel, shades in zip(image, CHANNELS, strict=True):
            for name, shade in shades:
                channel[layers[name]] = shade
        return image, 0


def goal_cells(p_robot: Array) -> NDArray[np.bool_]:
    """(64,64) True in the cells of goals (g,2) m, robot frame, and those beside them."""
    n, side = IMAGE
    cells = np.zeros((n, n), np.bool_)
    for row, column in np.floor(0.5 * n - p_robot / side).astype(np.intp).tolist():
        cells[max(0, row - 1) : max(0, row + 2), max(0, column - 1) : max(0, column + 2)] = True
    return cells
