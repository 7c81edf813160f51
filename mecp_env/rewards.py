"""The reward: named terms in their own units, a weight for each (`RewardConfig`). By default all from the belief."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.config import RewardConfig
from mecp_env.kernel import kernel
from mecp_env.slam.data import Belief, SemanticGrid
from mecp_env.slam.linalg import factor_lower

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TERMS = ("area", "pose_information", "landmark_information", "contact", "time", "completion")
LEAST_LOG_DET, MOST_LOG_DET = -60.0, 60.0  # keeps the information finite at an exact or a diverged pose


@dataclass(slots=True, eq=False)
class RewardMemory:
    """What the last period left behind to compare with; plain state."""

    area_m2: float = 0.0
    half_log_det: float = 0.0
    ids: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (N,) landmarks
    traces: Array = field(default_factory=lambda: np.empty(0))  # (N,) m^2
    grid_version: int = -1


def remember(memory: RewardMemory, belief: Belief, grid: SemanticGrid, area_m2: float | None) -> float:
    """Bring `memory` up to this period; how much surer the landmarks known before are now, m^2.

    `area_m2` is the truth's area, None where the belief's counts.
    """
    if area_m2 is not None:
        memory.area_m2 = area_m2
    elif grid.version != memory.grid_version:
        memory.area_m2 = mapped_area(grid)
    memory.grid_version = grid.version
    traces = np.empty(len(belief.ids))
    cov = np.ascontiguousarray(belief.pose_cov)
    memory.half_log_det, drop = information(cov, belief.covs, memory.ids, memory.traces, belief.ids, traces)
    memory.ids, memory.traces = belief.ids, traces
    return drop


def quantities(
    memory: RewardMemory, belief: Belief, grid: SemanticGrid, area_m2: float | None = None
) -> dict[str, float]:
    """The terms that are measured, in their own units; `memory` is brought up to this period.

    - `area`: m^2 newly mapped: the cells of the semantic grid that are not UNKNOWN (or the true free area seen, with
      `source="truth"`), now minus the period before. A loop closure that redraws the map can make it negative.
    - `pose_information`: nat, 0.5 log det P_before - 0.5 log det P_now of the pose covariance.
    - `landmark_information`: m^2, the drop of trace(P) summed over the landmarks that were known before; a new landmark
      counts from the period after its birth.
    """
    area, half = memory.area_m2, memory.half_log_det
    drop = remember(memory, belief, grid, area_m2)
    return {
        "area": memory.area_m2 - area,
        "pose_information": half - memory.half_log_det,
        "landmark_information": drop,
    }


def weigh(config: RewardConfig, measured: dict[str, float]) -> dict[str, float]:
    """Each term times its weight, in the order of `TERMS`; the reward is their sum.

    Beside the measured ones: `contact` is 1 in a period in which the robot touched something, `time` is 1 in every
    period, `completion` is 1 once, when the episode terminates.
    """
    return {name: getattr(config, name) * measured[name] for name in TERMS}


def mapped_area(grid: SemanticGrid) -> float:
    """m^2 of the cells that are not UNKNOWN, which is 0."""
    return float(np.count_nonzero(grid.label) * grid.resolution_m**2)


@kernel
def information(
    pose_cov: Array, covs: Array, ids_before: Ints, traces_before: Array, ids: Ints, traces: Array
) -> tuple[float, float]:
    """0.5 log det of the pose covariance (3,3), and the `trace_drop` of the landmarks since before.

    Writes the traces (N,) of the covariances (N,2,2) of the landmarks `ids` (N,).
    """
    for i in range(covs.shape[0]):
        traces[i] = covs[i, 0, 0] + covs[i, 1, 1]
    return half_log_det(pose_cov), trace_drop(ids_before, traces_before, ids, traces)


@kernel
def half_log_det(cov: Array) -> float:
    """0.5 log det of a covariance (n,n), kept within [-60, 60]; 60 where it is not positive: the filter diverged."""
    factor = cov.copy()
    if not factor_lower(factor):
        return MOST_LOG_DET
    total = 0.0
    for i in range(factor.shape[0]):
        total += math.log(factor[i, i])
    return max(LEAST_LOG_DET, min(MOST_LOG_DET, total))


@kernel
def trace_drop(ids_before: Ints, before: Array, ids_now: Ints, now: Array) -> float:
    """Sum of before - now over the ids that stand in both lists (n,) and (m,); ids mostly keep their order."""
    drop, j = 0.0, 0
    for i in range(ids_before.shape[0]):
        for k in range(ids_now.shape[0]):
            at = (j + k) % ids_now.shape[0]
            if ids_now[at] == ids_before[i]:
                drop += before[i] - now[at]
                j = at + 1
                break
    return drop
