"""Most new floor for the way there, and a preference for known ground when the pose grows unsure.

`python -m mecp_env.policies.gain --layout medium:test:3`
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.policies.one_episode import main
from mecp_env.policies.policy import KIND, PATH, Array, Mask, X, Y, choices

CELLS, CELL_M = 96, 0.2  # of the observation's grid, the robot in the middle, its heading up
FREE, OCCUPIED, UNKNOWN = 0, 2, 3  # layers of it
DOOR = 3  # kind of a goal
BEAMS, STEP_M, START_M = 90, 0.2, 0.3  # of the imagined scan; a wall nearer than START_M is the goal's own
LANDMARK_XX, LANDMARK_YY, LANDMARK_VALID = 2, 4, 7  # columns of `landmarks`


@dataclass(frozen=True, slots=True)
class Weights:
    """What the explorer goes by; tuned on 40 buildings of the validation split of `medium`."""

    sight_m: float = 6.0  # unknown floor further from a goal than this is not expected to be seen from there
    power: float = 0.7  # of the area: a room twice as large is not worth twice the way
    start_m: float = 2.0  # added to every way, so that what lies at hand is not worth all
    winding: float = 1.3  # the way from one goal to the next, times the straight line
    beyond_m2: float = 12.0  # expected behind a door that lies outside the grid of the observation
    least_m2: float = 0.3  # where no goal promises as much, only the ways count
    sure_m: float = 0.05  # standard deviation of the position up to which nothing but floor counts
    caution: float = 1.0  # how fast a goal on unknown ground loses its worth beyond that


class Gain:
    """Drives to the goal with the most expected new floor for the way, area^0.7 / (way + 2 m), looking one goal ahead.

    A goal counts as much as the best pair that it begins: the floor of both for the way to the one and on to the other.
    The area is what an imagined scan from the goal would see of the unknown cells of the observation's grid, walls
    known so far in its way (next best view: Gonzalez-Banos and Latombe 2002). When the position's standard deviation
    exceeds `sure_m`, goals are preferred that lie near landmarks known better than the pose: seen again, they make it
    sure (Stachniss, Grisetti and Burgard 2005 close loops for that).
    """

    actions = "goal"

    def __init__(self, weights: Weights | None = None) -> None:
        self.weights = weights or Weights()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; nothing here is random and nothing is kept."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the goal to drive to; 0 when there is none."""
        rows = choices(observation, mask)
        if not len(rows):
            return 0
        goals = np.asarray(observation["goals"], np.float64)[rows]
        area = self.expected_area(observation["grid"], goals)
        if area.max() < self.weights.least_m2:
            area = np.ones(len(rows))
        return int(rows[np.argmax(self.worth(area, goals) * self.trust(observation, goals))])

    def worth(self, area: Array, goals: Array) -> Array:
        """(k,) worth of the goals (k,9) for the way, each alone or together with the best one to go on to."""
        weights, value = self.weights, area**self.weights.power
        way = goals[:, PATH] + weights.start_m
        straight = np.hypot(*(goals[:, None, [X, Y]] - goals[None, :, [X, Y]]).transpose(2, 0, 1))
        pairs = (value[:, None] + value) / (way[:, None] + weights.winding * straight + weights.start_m)
        np.fill_diagonal(pairs, value / way)
        best: Array = pairs.max(axis=1)
        return best

    def expected_area(self, grid: NDArray[np.uint8], goals: Array) -> Array:
        """(k,) m^2 of unknown cells that a scan from each of the goals (k,9) would see."""
        area = unseen_area(grid, goals[:, [X, Y]], self.weights.sight_m)
        outside = np.abs(goals[:, [X, Y]]).max(axis=1) > 0.5 * CELLS * CELL_M - STEP_M
        area[outside & (goals[:, KIND] == DOOR)] = self.weights.beyond_m2
        return area

    def trust(self, observation: dict[str, Any], goals: Array) -> Array:
        """(k,) factors up to 1 of the goals (k,9): 1 while the pose is sure, less on ground that is not well known."""
        sigma_m = float(np.sqrt(0.5 * (observation["pose_cov"][0] + observation["pose_cov"][3])))
        excess = max(0.0, sigma_m / self.weights.sure_m - 1.0)
        if excess == 0.0:
            return np.ones(len(goals))
        known = well_known(observation["landmarks"], goals[:, [X, Y]], sigma_m)
        factors: Array = np.exp(-self.weights.caution * excess * (1.0 - known))
        return factors


def unseen_area(grid: NDArray[np.uint8], places: Array, sight_m: float) -> Array:
    """(k,) m^2 of unknown cells of `grid` (8,96,96) in sight of places (k,2) m, robot frame; nothing is seen outside.

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
    """(k,) how well places (k,2) m are known, 0 to 1: three landmarks within 4 m, twice as sure as the pose, are 1."""
    table = np.asarray(landmarks, np.float64)
    theirs = np.sqrt(0.5 * (table[:, LANDMARK_XX] + table[:, LANDMARK_YY]))
    good = table[(table[:, LANDMARK_VALID] > 0.5) & (theirs < 0.5 * sigma_m)]
    far = np.hypot(places[:, 0, None] - good[:, X], places[:, 1, None] - good[:, Y])
    known: Array = np.minimum((far < 4.0).sum(axis=1) / 3.0, 1.0)
    return known


if __name__ == "__main__":
    sys.exit(main("gain"))
