"""The reward: named terms in their own units, a weight for each (`RewardConfig`); see docs/rewards.md.

Each measured term is the change of a potential in a step. The terms of an episode therefore sum to the potential at its
end minus the potential at its start, whatever happened in between: uncertainty that grows and shrinks again, an area
mapped twice, or a map that is redrawn earns nothing. The terms of a metric (`mecp_env.episode.potentials`) sum to
its mean over the step limit.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mecp_env.config import REWARDS, RewardConfig
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import factor_lower
from mecp_env.core.processes import Failure
from mecp_env.core.settings import shown
from mecp_env.episode.potentials import (
    METRIC_TERMS,
    POTENTIALS,
    MetricMemory,
    RewardInputs,
    metric_terms,
    start_metrics,
)
from mecp_env.evaluation.metric_arrays import OCCUPIED

TERMS = REWARDS.ours
OURS = tuple(name for name in TERMS if name in POTENTIALS)
LEAST_LOG_DET, MOST_LOG_DET = -60.0, 60.0  # keeps the information finite at an exact or a diverged pose
COMPLETION_M2 = 100.0  # the unit of a completed area
LOST_M2 = 20.0  # the unit of floor that a lost robot does not have in its place
AHEAD_M = 5.0  # typical distance from the robot to a wall that it draws


@dataclass(slots=True, eq=False)
class RewardMemory:
    """The potentials of the step before; plain state."""

    metric: MetricMemory = field(default_factory=MetricMemory)
    area_m2: float = 0.0
    pose_nat: float = 0.0
    landmark_nat: float = 0.0
    grid_version: int = -1  # version of the map with that area
    potentials: dict[str, float] = field(default_factory=dict)  # those with a weight


def weights_of(config: RewardConfig) -> dict[str, float]:
    """The weight of each term, custom ones last."""
    return {name: getattr(config, name) for name in TERMS} | config.custom


def new_memory(inputs: RewardInputs, config: RewardConfig) -> RewardMemory:
    """The memory at the start of an episode."""
    names = [name for name in OURS if getattr(config, name)] + [
        name for name, weight in config.custom.items() if weight
    ]
    memory = RewardMemory(potentials=dict.fromkeys(names, 0.0))
    remember(memory, inputs, config)
    start_metrics(memory.metric, inputs, config)
    return memory


def remember(memory: RewardMemory, inputs: RewardInputs, config: RewardConfig) -> None:
    """Update the potentials in `memory` to this step."""
    memory.potentials = {name: measured(name, inputs) for name in memory.potentials}
    sigma, memory.pose_nat, landmark_nat = information(np.ascontiguousarray(inputs.belief.pose_cov), inputs.belief.covs)
    memory.area_m2 = area(memory, inputs, sigma <= config.area_sigma_m)
    memory.landmark_nat = 0.0 if inputs.diverged else landmark_nat


def measured(name: str, inputs: RewardInputs) -> float:
    """A potential. Raises `ConfigError` for a custom one that fails, or is no finite number."""
    try:
        value = POTENTIALS[name](inputs)
    except Exception as error:  # code of the user may raise anything
        raise ConfigError(f"reward: the potential {name!r} failed: {Failure.of(error).reason}") from error
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        if math.isfinite(value):
            return float(value)
    raise ConfigError(f"reward: the potential {name!r} gave {shown(value)}, a finite number expected")


def area(memory: RewardMemory, inputs: RewardInputs, sure: bool) -> float:
    """m^2 that count as mapped: the cells not UNKNOWN when the robot was last `sure` of its pose.

    What it draws while unsure counts once it is sure again, if it is still in the map. A diverged map counts 0.
    """
    if inputs.true_area_m2 is not None:
        return inputs.true_area_m2
    if inputs.diverged:
        return 0.0
    if not sure or inputs.grid.version == memory.grid_version:
        return memory.area_m2
    memory.grid_version = inputs.grid.version
    mapped, cell_m2 = np.count_nonzero(inputs.grid.label), inputs.grid.resolution_m**2  # UNKNOWN is 0
    memory.metric.floor_m2 = float((mapped - np.count_nonzero(inputs.grid.label == OCCUPIED)) * cell_m2)
    return float(mapped * cell_m2)


def measured_terms(memory: RewardMemory, inputs: RewardInputs, config: RewardConfig) -> dict[str, float]:
    """The measured terms, in their own units; updates `memory` to this step.

    - `area`: m^2 newly mapped minus what a redrawn map lost (see `area`); with `source="truth"` newly seen.
    - `pose_information`: nat, increase of -0.5 log det P of the pose.
    - `landmark_information`: nat, increase of the mean of -0.5 log det P over the landmarks.
    - the potentials that have a weight (`mecp_env.episode.potentials`): their change; 0 for the others.
    - those of `mecp_env.episode.potentials`.
    """
    area_m2, pose_nat, landmark_nat, before = memory.area_m2, memory.pose_nat, memory.landmark_nat, memory.potentials
    remember(memory, inputs, config)
    changes = {name: value - before[name] for name, value in memory.potentials.items()}
    changes["area"] = memory.area_m2 - area_m2
    changes["pose_information"] = memory.pose_nat - pose_nat
    changes["landmark_information"] = memory.landmark_nat - landmark_nat
    none = dict.fromkeys((*METRIC_TERMS, *OURS, *config.custom), 0.0)
    return none | metric_terms(memory.metric, inputs, config) | changes


class Happened(NamedTuple):
    """The events of a step."""

    contact: bool = False
    off: bool = False  # the pose, by ground truth (`mecp_env.evaluation.metric_arrays`)
    terminated: bool = False
    diverged: bool = False
    lost_m2: float | None = None  # misplaced floor, in the step in which an episode ends lost
    max_steps: int = 1


def events(memory: RewardMemory, happened: Happened) -> dict[str, float]:
    """The terms of events; `memory` is that of this step.

    - `contact`: 1 in a step in which the robot touched something; `contact_share`: 1 / `max_steps`.
    - `lost_share`: 1 / `max_steps` in a step in which the pose is more than 1 m or 10 degrees off (ground truth).
    - `time`: 1 in every step.
    - `completion`: once, when the episode terminates: the area that counts as mapped, in 100 m^2.
    - `divergence`: 1 once, when the filter diverges, which ends the episode.
    - `lost`: once, when the episode ends and the robot is lost (`mecp_env.evaluation.metric_arrays`, from ground truth)
      with `lost_m2` of floor that the map does not have in its place: 1, and 1 for each 20 m^2 of it.
    """
    return {
        "contact": float(happened.contact),
        "contact_share": happened.contact / happened.max_steps,
        "lost_share": happened.off / happened.max_steps,
        "time": 1.0,
        "completion": memory.area_m2 / COMPLETION_M2 if happened.terminated else 0.0,
        "divergence": float(happened.diverged),
        "lost": 1.0 + happened.lost_m2 / LOST_M2 if happened.lost_m2 is not None else 0.0,
    }


def apply_weights(weights: dict[str, float], terms: dict[str, float]) -> dict[str, float]:
    """Each term times its weight, in the order of `weights_of`; the reward is their sum."""
    return {name: weight * terms[name] for name, weight in weights.items()}


@compiled
def information(pose_cov: Array, covs: Array) -> tuple[float, float, float]:
    """Drawing sigma, m; -0.5 log det of the pose covariance (3,3); its mean over landmark covariances (N,2,2), nat.

    The drawing sigma is that of where the robot draws what is `AHEAD_M` ahead; inf for an invalid covariance. Each log
    determinant, P in m^2, is kept within [-60, 60]; -60 nat where P is not positive: the filter diverged. 0 without a
    landmark.
    """
    square = max(pose_cov[0, 0], pose_cov[1, 1]) + AHEAD_M * AHEAD_M * pose_cov[2, 2]
    sigma, factor, half = math.sqrt(square) if square >= 0.0 else math.inf, pose_cov.copy(), 0.0
    positive = factor_lower(factor)
    for i in range(3 if positive else 0):
        half += math.log(factor[i, i])
    pose_nat = -(max(LEAST_LOG_DET, min(MOST_LOG_DET, half)) if positive else MOST_LOG_DET)
    total = 0.0
    for i in range(covs.shape[0]):
        det = covs[i, 0, 0] * covs[i, 1, 1] - covs[i, 0, 1] * covs[i, 1, 0]
        known = covs[i, 0, 0] > 0.0 and det > 0.0
        total -= max(LEAST_LOG_DET, min(MOST_LOG_DET, 0.5 * math.log(det))) if known else MOST_LOG_DET
    return sigma, pose_nat, total / max(covs.shape[0], 1)
