"""Explorers that act on their uncertainty: they return to known ground, wait, or weigh information of pose and map.

They need the goals on known ground and the predicted columns (`SETTINGS`), which the tasks of active SLAM have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import ConfigError
from mecp_env.planning.goal_list import drawing_sigma
from mecp_env.policies.explorers import Gain, NextBestView
from mecp_env.policies.registry import GAIN, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, WAIT, Mask, choices, of_kind

Floats = NDArray[np.float32]

SETTINGS: Mapping[str, Any] = {
    "planning": {"known_ground": {"places": 8, "wait_steps": 5}},
    "observation": {"uncertainty": True},
}
RECOGNISED = 2  # column of `localisation`


def sigma_now(pose_cov: Floats) -> float:
    """The same for the covariance (6,) of the pose."""
    xx, _, _, yy, _, turn = np.asarray(pose_cov, np.float64)
    return float(drawing_sigma(np.sqrt(0.5 * (xx + yy)), np.sqrt(turn)))


def sigma_there(goals: Floats | Array) -> Array:
    """(k,) the same on arrival at goals (k,12), as predicted."""
    table = np.asarray(goals, np.float64)
    return drawing_sigma(table[:, SIGMA], table[:, SIGMA_RAD])


def check_columns(observation: Mapping[str, Any], name: str) -> None:
    """Raise `ConfigError` unless an observation has what a policy of that name reads of its uncertainty."""
    if "localisation" not in observation:
        raise ConfigError(
            f"policy: {name} reads `localisation`, the observation has {', '.join(observation)}; "
            'make the environment with observation={"uncertainty": True}, or a task such as ActiveHalls-v0'
        )


class Active:
    """What the explorers have in common: they look elsewhere while the pose is searched for, and need the columns."""

    actions, settings = "goal", SETTINGS

    def __init__(self, explorer: NextBestView | None = None) -> None:
        self.explorer = explorer or Gain()
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""
        self.in_a_row = 0  # waits or returns

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        """Row of the goal to drive to; 0 when there is none. Raises `ConfigError` without the columns."""
        check_columns(observation, type(self).__name__)
        look = of_kind(LOOK, observation, mask)
        return int(look[0]) if len(look) else self.choose(observation, mask)

    def choose(self, observation: dict[str, Any], mask: Mask) -> int:
        """The same, while the robot is localised."""
        return self.explorer.act(observation, mask)


class Pause(Active):
    """As `Gain`, but waits where few corners are recognised, at most `most_waits` times in a row."""

    def __init__(self, recognised: float = 0.4, most_waits: int = 2, sigma_m: float = 0.05) -> None:
        super().__init__()
        self.recognised, self.most_waits, self.sigma_m = recognised, most_waits, sigma_m

    def choose(self, observation: dict[str, Any], mask: Mask) -> int:
        """The row that waits, or that of the explorer."""
        rows, few = of_kind(WAIT, observation, mask), observation["localisation"][RECOGNISED] < self.recognised
        waits = few and len(rows) > 0 and sigma_now(observation["pose_cov"]) > self.sigma_m
        self.in_a_row = self.in_a_row + 1 if waits and self.in_a_row < self.most_waits else 0
        return int(rows[0]) if self.in_a_row else self.explorer.act(observation, mask)


@dataclass(frozen=True, slots=True)
class Triggers:
    """When `Returning` returns, and where to; tuned on the train and validation splits (docs/tasks.md)."""

    lost_m: float = 0.2  # drawing sigma that a place takes away: it returns
    share: float = 0.6  # of it: as long as a place takes away as much, it goes on to return
    most_returns: int = 3  # drives in a row
    between: int = 6  # drives to new floor, at least, before it returns again
    metre: float = 0.02  # what a metre of the way costs, as a share of the present sigma


class Returning(Active):
    """As `NextBestView` while the pose is well known; otherwise to the place where it is predicted to be known best.

    It returns when its drawing sigma is larger than that at a place by a trigger. What is uncertain there, too, is
    where the map as a whole lies, which no return makes better known. It goes on when no place promises a share of
    that, or after a few drives, and then does not return for some time: where few corners are, sigma grows fast.
    """

    def __init__(self, triggers: Triggers | None = None) -> None:
        self.triggers = triggers or Triggers()
        super().__init__(NextBestView())

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""
        super().reset(seed)
        self.explored = self.triggers.between  # drives since the last return

    def choose(self, observation: dict[str, Any], mask: Mask) -> int:
        """Row of the place, or that of the explorer."""
        given = self.triggers
        may = self.in_a_row < given.most_returns and (self.in_a_row or self.explored >= given.between)
        place = self.best(observation, of_kind(PLACE, observation, mask)) if may else None
        self.in_a_row, self.explored = (0, self.explored + 1) if place is None else (self.in_a_row + 1, 0)
        return self.explorer.act(observation, mask) if place is None else place

    def best(self, observation: Mapping[str, Any], places: Ints) -> int | None:
        """The place with the least predicted sigma and cost of the way; None where none takes away enough of it."""
        given, goals, sigma_m = self.triggers, observation["goals"], sigma_now(observation["pose_cov"])
        there, least_m = sigma_there(goals[places]), given.lost_m * (given.share if self.in_a_row else 1.0)
        of_use = there < sigma_m - least_m
        cost = np.where(of_use, there + given.metre * sigma_m * goals[places, PATH], np.inf)
        return int(places[np.argmin(cost)]) if of_use.any() else None


@dataclass(frozen=True, slots=True)
class InformationWeights:
    """Weights of the expected information, chosen on 12 validation buildings of the halls (docs/policies.md)."""

    cell_nat_m2: float = 0.7  # of a square metre of floor that is seen for the first time
    tau_m: float = 0.15  # tolerance of the map: what is drawn with that sigma is worth 0.6
    pose_nat: float = 0.1  # of a nat of the position's entropy
    landmark_nat: float = 0.1  # of a nat of the landmarks' entropy
    metre_nat: float = 0.8  # cost of a metre of the way


class Stachniss(Active):
    """Drives where the expected information of map and pose exceeds the cost most, be it known ground or new.

    U(g) = I_map(g) + I_pose(g) - cost(g) over the EKF belief (Stachniss, Grisetti and Burgard 2005, who sample it from
    a particle filter). I_map: new floor that an imaginary scan from the goal would see, as `Gain`, discounted by how
    far off it would be drawn. I_pose: decrease of the entropy of the position on arrival, by the virtual EKF along the
    path, and of the landmarks seen on the way. The cost is the length of the path.
    """

    def __init__(self, weights: InformationWeights | None = None) -> None:
        super().__init__()
        self.weights = weights or InformationWeights()

    def choose(self, observation: dict[str, Any], mask: Mask) -> int:
        """Row of the goal with the greatest utility."""
        new, places = choices(observation, mask), of_kind(PLACE, observation, mask)
        rows = np.concatenate([new, places])
        if not len(rows):
            return 0
        goals = np.asarray(observation["goals"], np.float64)[rows]
        area = np.zeros(len(rows))
        area[: len(new)] = self.explorer.expected_area(observation["grid"], goals[: len(new)]) if len(new) else 0.0
        return int(rows[np.argmax(self.utility(area, goals, sigma_now(observation["pose_cov"])))])

    def utility(self, area: Array, goals: Array, sigma_m: float) -> Array:
        """(k,) nat of goals (k,12) with so much new floor (k,) m^2, where the position is known to `sigma_m`."""
        weights, there = self.weights, np.maximum(sigma_there(goals), 1e-3)
        worth = 1.0 - np.exp(-(weights.tau_m**2) / (2.0 * there**2))
        of_map = weights.cell_nat_m2 * area * worth
        of_pose = 2.0 * np.log(max(sigma_m, 0.01) / np.maximum(there, 0.01))
        known: Array = of_map + weights.pose_nat * of_pose + weights.landmark_nat * goals[:, GAIN]
        return known - weights.metre_nat * goals[:, PATH]
