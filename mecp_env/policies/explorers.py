"""Explorers without a model of their uncertainty: breadth-first, nearest, random, standing, and by expected area."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bytes
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.policies.registry import KIND, PATH, Mask, X, Y, choices

LEAST_HELD, MOST_HELD = 3, 20  # steps for which the random walk holds a command
TURN_IN_PLACE = 0.3  # share of its commands
CELLS, CELL_M = 96, 0.2  # of the observation's grid, the robot in the middle, its heading up
FREE, OCCUPIED, UNKNOWN = 0, 2, 3  # layers of it
DOOR = 3  # kind of a goal
BEAMS, STEP_M, START_M = 90, 0.2, 0.3  # of the imaginary scan; a wall nearer than START_M belongs to the goal itself
LANDMARK_XX, LANDMARK_YY, LANDMARK_VALID = 2, 4, 7  # columns of `landmarks`


class Memoryless:
    """A policy that selects goals; each choice follows from the observation alone."""

    actions = "goal"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random, and no state is kept."""


class BreadthFirstPolicy(Memoryless, BreadthFirst):
    """`BreadthFirst` as a policy: planner and controller of the environment drive to the goals that it selects."""


class Nearest(Memoryless):
    """Drives to the goal with the shortest path: the standard baseline (Yamauchi 1997)."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the nearest goal, the first of equal ones; 0 when there is none."""
        rows = choices(observation, mask)
        return int(rows[observation["goals"][rows, PATH].argmin()]) if len(rows) else 0


class Random:
    """A policy whose random numbers follow from the seed of the episode."""

    def __init__(self) -> None:
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Start an episode."""
        self.rng = np.random.default_rng(seed)


class RandomGoal(Random):
    """Drives to a goal drawn uniformly from those that may be selected: the value of the planner without a policy."""

    actions = "goal"

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of a goal; 0 when there is none."""
        rows = choices(observation, mask)
        return int(self.rng.choice(rows)) if len(rows) else 0


class Standing(Memoryless):
    """Stands still: what an episode pays for nothing."""

    actions = "velocity"

    def act(self, observation: Any = None, mask: Any = None) -> NDArray[np.float32]:
        """The command (2,) to stand."""
        return np.zeros(2, np.float32)


class RandomWalk(Random):
    """Holds a random command for a random number of steps: usually forward along an arc, sometimes a turn in place."""

    actions = "velocity"

    def reset(self, seed: int = 0) -> None:
        """Start an episode."""
        super().reset(seed)
        self.command = np.zeros(2, np.float32)
        self.left = 0

    def act(self, observation: Any = None, mask: Any = None) -> NDArray[np.float32]:
        """Normalised command (2,), shares of the largest speed and turn rate; the observation is not used."""
        if self.left == 0:
            self.left = int(self.rng.integers(LEAST_HELD, MOST_HELD + 1))
            self.command = self._draw()
        self.left -= 1
        return self.command.copy()

    def _draw(self) -> NDArray[np.float32]:
        if self.rng.random() < TURN_IN_PLACE:
            return np.array([0.0, self.rng.uniform(-1.0, 1.0)], np.float32)
        return np.array([self.rng.uniform(0.5, 1.0), self.rng.uniform(-0.25, 0.25)], np.float32)


@dataclass(frozen=True, slots=True)
class Weights:
    """Parameters; tuned on 40 buildings of the validation split of `medium`."""

    sight_m: float = 6.0  # range of the imaginary scan
    power: float = 0.7  # of the area: twice the area is worth less than twice the path
    start_m: float = 2.0  # added to every path, so that the nearest goal does not always win
    winding: float = 1.3  # path length from one goal to the next, per straight-line distance
    beyond_m2: float = 12.0  # expected behind a door that lies outside the grid of the observation
    least_m2: float = 0.3  # where no goal has this gain, only path lengths count
    sure_m: float = 0.05  # standard deviation of the position up to which only floor counts
    caution: float = 1.0  # rate at which a goal away from known landmarks loses value beyond that


class NextBestView(Memoryless):
    """Drives to the goal with the most expected new floor per path, area^0.7 / (path + 2 m), one goal ahead.

    The value of a goal is that of the best pair that starts with it: the floor of both, for the path to the first and
    on to the second. The area is that of the unknown cells of the observation's grid that an imaginary scan from the
    goal would see, up to the walls known so far (Gonzalez-Banos and Latombe 2002). How well the pose is known plays no
    role.
    """

    def __init__(self, weights: Weights | None = None) -> None:
        self.weights = weights or Weights()

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the goal to drive to; 0 when there is none."""
        rows = choices(observation, mask)
        if not len(rows):
            return 0
        goals = np.asarray(observation["goals"], np.float64)[rows]
        area = self.expected_area(observation["grid"], goals)
        if area.max() < self.weights.least_m2:
            area = np.ones(len(rows))
        return int(rows[np.argmax(self.value_of(area, goals) * self.certainty(observation, goals))])

    def certainty(self, observation: dict[str, Any], goals: Array) -> Array:
        """(k,) factors up to 1 of the goals (k,9): all 1 here."""
        return np.ones(len(goals))

    def value_of(self, area: Array, goals: Array) -> Array:
        """(k,) value of the goals (k,9) per path, each alone or together with the best second goal."""
        weights, value = self.weights, area**self.weights.power
        way = goals[:, PATH] + weights.start_m
        straight = np.hypot(*(goals[:, None, [X, Y]] - goals[None, :, [X, Y]]).transpose(2, 0, 1))
        pairs = (value[:, None] + value) / (way[:, None] + weights.winding * straight + weights.start_m)
        np.fill_diagonal(pairs, value / way)
        best: Array = pairs.max(axis=1)
        return best

    def expected_area(self, grid: Bytes, goals: Array) -> Array:
        """(k,) m^2 of unknown cells that a scan from each of the goals (k,9) would see."""
        area = unseen_area(grid, goals[:, [X, Y]], self.weights.sight_m)
        outside = np.abs(goals[:, [X, Y]]).max(axis=1) > 0.5 * CELLS * CELL_M - STEP_M
        area[outside & (goals[:, KIND] == DOOR)] = self.weights.beyond_m2
        return area


class Gain(NextBestView):
    """As `NextBestView`; while the pose is uncertain, it prefers goals near well-known landmarks.

    That is when the position's standard deviation exceeds `sure_m`. To see landmarks again that are known better than
    the pose reduces its uncertainty (Stachniss, Grisetti and Burgard 2005 close loops for that).
    """

    def certainty(self, observation: dict[str, Any], goals: Array) -> Array:
        """(k,) factors up to 1 of the goals (k,9): 1 while the pose is certain, less away from well-known landmarks."""
        sigma_m = float(np.sqrt(0.5 * (observation["pose_cov"][0] + observation["pose_cov"][3])))
        excess = max(0.0, sigma_m / self.weights.sure_m - 1.0)
        if excess == 0.0:
            return np.ones(len(goals))
        known = well_known(observation["landmarks"], goals[:, [X, Y]], sigma_m)
        factors: Array = np.exp(-self.weights.caution * excess * (1.0 - known))
        return factors


def unseen_area(grid: Bytes, places: Array, sight_m: float) -> Array:
    """(k,) m^2 of unknown cells of `grid` (8,96,96) visible from places (k,2) m, robot frame; none outside.

    The integral of r dr da over beams that end at the first wall.
    """
    bearings, ranges = np.arange(BEAMS) * (2.0 * np.pi / BEAMS), np.arange(0.5 * STEP_M, sight_m, STEP_M)
    x = places[:, 0, None, None] + np.cos(bearings)[:, None] * ranges
    y = places[:, 1, None, None] + np.sin(bearings)[:, None] * ranges
    row, column = (np.floor(0.5 * CELLS - p / CELL_M).astype(np.int64) for p in (x, y))
    inside = (row >= 0) & (column >= 0) & (row < CELLS) & (column < CELLS)
    row, column = np.clip(row, 0, CELLS - 1), np.clip(column, 0, CELLS - 1)
    stops = ~inside | ((grid[OCCUPIED][row, column] > 0) & (ranges > START_M))
    seen = np.logical_and.accumulate(~stops, axis=2)
    fresh = seen & (grid[UNKNOWN][row, column] > 0) & (grid[FREE][row, column] == 0)
    area: Array = (fresh * ranges).sum(axis=(1, 2)) * STEP_M * (2.0 * np.pi / BEAMS)
    return area


def well_known(landmarks: NDArray[np.float32], places: Array, sigma_m: float) -> Array:
    """(k,) how well places (k,2) m are mapped: 1 with three landmarks within 4 m, twice as certain as the pose."""
    table = np.asarray(landmarks, np.float64)
    theirs = np.sqrt(0.5 * (table[:, LANDMARK_XX] + table[:, LANDMARK_YY]))
    good = table[(table[:, LANDMARK_VALID] > 0.5) & (theirs < 0.5 * sigma_m)]
    far = np.hypot(places[:, 0, None] - good[:, X], places[:, 1, None] - good[:, Y])
    known: Array = np.minimum((far < 4.0).sum(axis=1) / 3.0, 1.0)
    return known
