"""What a belief is worth: potentials of the reward beyond the area, and custom ones by name (docs/rewards.md).

Each takes the belief and the map and gives a number; the reward term is its change in a step.

Rewards whose sum is a metric: coverage, or correct coverage, as a mean over the step limit; and shaping.

With c(t) after step t and the limit L, an episode scores (c(0) + ... + c(L-1)) / L, the last value held after its end.
Step t pays what it adds to this score if nothing more is found: (c(t) - c(t-1)) (L - t) / L, and the first step also
c(0). So early floor counts more, every building pays at most 1, and a map that slides off gives back what it had.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from mecp_env.config import REWARDS, RewardConfig
from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.errors import ConfigError
from mecp_env.core.jit import compiled
from mecp_env.core.settings import shown
from mecp_env.evaluation.metric_arrays import OCCUPIED, WALL_M
from mecp_env.slam.messages import Belief, SemanticGrid

TAU_M = 0.15  # tolerance of `expected_area`: a wall drawn farther off is in a wrong place
BLOCK_CELLS = 8  # width of the blocks of cells that have their nearest landmark in common
NO_GOALS = np.empty((0, 2))
LEAST_VARIANCE, MOST_VARIANCE = 1e-8, 1e4  # m^2 and rad^2: keep the information finite


class RewardInputs(NamedTuple):
    """The inputs of the measured terms in one step."""

    belief: Belief
    grid: SemanticGrid
    diverged: bool = False
    true_area_m2: float | None = None  # the true free area seen; None if the estimated area counts
    true_shares: tuple[float, float] | None = None  # true coverage and correct coverage, likewise
    free_area_m2: float = 1.0  # the floor of the building: only scales what is mapped to a share
    budget: float = 1.0  # share of the step limit that is left
    p_goals: Array = NO_GOALS  # (g,2) m, map frame: the goals that are left
    over: bool = False  # the episode has ended


Potential = Callable[[RewardInputs], float]


def expected_area(inputs: RewardInputs) -> float:
    """Expected correct area, m^2: the mapped area, each cell times the probability that it is in its place.

    The sum over the mapped cells of 1 - exp(-tau^2 / (2 s^2)), tau 0.15 m, s^2 half the trace of the covariance of the
    nearest landmark: the probability that an error of that sigma in two dimensions is below tau.
    """
    area_m2, s2 = mapped(inputs)
    return float(area_m2 @ reliability(s2))


def entropy(inputs: RewardInputs) -> float:
    """Entropy that the grid has lost, nat m^2: ln 2 - H(p) per cell that is mapped, which is right with probability p.

    p = (1 + r) / 2 with the reliability r of `expected_area`; a cell that is not mapped has ln 2.
    """
    area_m2, s2 = mapped(inputs)
    p, q = 0.5 * (1.0 + reliability(s2)), 0.5 * (1.0 - reliability(s2))
    uncertain = -(p * np.log(p) + q * np.log(np.maximum(q, 1e-12)))
    return float(area_m2 @ (math.log(2.0) - uncertain))


def expected_correct_m2(inputs: RewardInputs) -> float:
    """Expected m^2 of floor that the map has in its place, as `correct_coverage` counts it.

    The sum over the FREE and DOOR cells of erf(tau / (sqrt(2) s)), tau 0.25 m, the tolerance of that metric, s^2 half
    the trace of the covariance of the nearest landmark: the probability that a wall drawn with that sigma is off by
    less than tau across its direction.
    """
    area_m2, s2 = mapped(inputs, only_floor=True)
    return float(area_m2 @ erf(WALL_M / np.sqrt(2.0 * s2)))


def reliability(s2: Array) -> Array:
    """(b,) the probability that an error of these variances, m^2, in two dimensions is below tau."""
    probability: Array = 1.0 - np.exp(-(TAU_M**2) / (2.0 * s2))
    return probability


def mapped(inputs: RewardInputs, only_floor: bool = False) -> tuple[Array, Array]:
    """(b,) m^2 of mapped cells, or FREE and DOOR ones, in each block that has some, and (b,) s^2 of its nearest
    landmark, m^2: half the trace of its covariance.
    """
    grid, belief = inputs.grid, inputs.belief
    if inputs.diverged or not len(belief.ids):
        return np.empty(0), np.empty(0)
    return mapped_blocks(grid.label, grid.origin, float(grid.resolution_m), belief.p_map, belief.covs, only_floor)


@compiled
def mapped_blocks(
    label: Bytes, corner: Array, cell_m: float, p_map: Array, covs: Array, only_floor: bool
) -> tuple[Array, Array]:
    """See `mapped`: of a grid (H,W) with its lower left corner (2,), and landmarks (N,2) with covariances (N,2,2)."""
    (height, width), side = label.shape, BLOCK_CELLS
    rows, columns, n = (height + side - 1) // side, (width + side - 1) // side, 0
    area, s2 = np.empty(rows * columns), np.empty(rows * columns)
    for block in range(rows * columns):
        row, column, cells = block // columns * side, block % columns * side, 0
        for i in range(row, min(row + side, height)):
            for j in range(column, min(column + side, width)):
                cells += label[i, j] > 0 and not (only_floor and label[i, j] == OCCUPIED)  # UNKNOWN is 0
        if cells == 0:
            continue
        x, y = corner[0] + (column / side + 0.5) * side * cell_m, corner[1] + (row / side + 0.5) * side * cell_m
        nearest = math.inf
        for k in range(p_map.shape[0]):
            square = (p_map[k, 0] - x) ** 2 + (p_map[k, 1] - y) ** 2
            if square < nearest:
                nearest, s2[n] = square, max(0.5 * (covs[k, 0, 0] + covs[k, 1, 1]), LEAST_VARIANCE)
        area[n] = cells * (cell_m * cell_m)
        n += 1
    return area[:n], s2[:n]


def d_optimality(inputs: RewardInputs) -> float:
    """-1/2 of the mean logarithm of the eigenvalues of pose and landmarks, nat: the volume of the uncertainty."""
    return -0.5 * float(np.mean(np.log(eigenvalues(inputs))))


def a_optimality(inputs: RewardInputs) -> float:
    """-1/2 of the logarithm of their mean, nat: the mean variance."""
    return -0.5 * math.log(float(np.mean(eigenvalues(inputs))))


def t_optimality(inputs: RewardInputs) -> float:
    """1/2 of the logarithm of the mean of their reciprocals, nat: the mean information."""
    return 0.5 * math.log(float(np.mean(1.0 / eigenvalues(inputs))))


def eigenvalues(inputs: RewardInputs) -> Array:
    """(3 + 2N,) the eigenvalues of the covariances of the pose (m^2, rad^2) and of each landmark (m^2), kept finite."""
    of_pose = np.linalg.eigvalsh(inputs.belief.pose_cov)
    xx, xy, yy = inputs.belief.covs[:, 0, 0], inputs.belief.covs[:, 0, 1], inputs.belief.covs[:, 1, 1]
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    found = np.concatenate([of_pose, middle + apart, middle - apart])
    if inputs.diverged:
        found = np.full_like(found, MOST_VARIANCE)
    clipped: Array = np.clip(found, LEAST_VARIANCE, MOST_VARIANCE)
    return clipped


POTENTIALS: dict[str, Potential] = {
    "expected_area": expected_area,
    "entropy": entropy,
    "d_optimality": d_optimality,
    "a_optimality": a_optimality,
    "t_optimality": t_optimality,
}


def register_reward(name: str, potential: Potential) -> None:
    """Let `reward={"custom": {name: weight}}` add the change of a potential to the reward; `info` has `reward_<name>`.

    `potential` maps the `RewardInputs` of a step to a number. A name that was registered before is replaced. Raises
    `ConfigError` for a name of ours and for what is no name.
    """
    if not callable(potential):
        raise ConfigError(f"potential: {shown(potential)}, a function of RewardInputs expected")
    REWARDS.add(name)
    POTENTIALS[name] = potential


NEAR_M = 5.0  # at this distance the nearness of a goal is 1/e


@dataclass(slots=True, eq=False)
class MetricMemory:
    """What the terms were computed from in the step before; plain state."""

    floor_m2: float = 0.0  # mapped floor when the robot was last sure of its pose
    shares: dict[str, float] = field(default_factory=dict)  # c(t-1)
    owed: dict[str, float] = field(default_factory=dict)  # c(0), until the first step pays it
    nearness: float = 0.0  # the potential of `shaping`
    prospect: float = 0.0  # that of `pace`


def coverage(memory: MetricMemory, inputs: RewardInputs) -> float:
    """The mapped floor as a share of the building's, at most 1; 0 after a divergence; or the true coverage."""
    if inputs.true_shares is not None:
        return inputs.true_shares[0]
    return 0.0 if inputs.diverged else min(1.0, memory.floor_m2 / inputs.free_area_m2)


def correct_coverage(memory: MetricMemory, inputs: RewardInputs) -> float:
    """The expected correct floor as a share of the building's, at most 1; or the true correct coverage."""
    if inputs.true_shares is not None:
        return inputs.true_shares[1]
    return min(1.0, expected_correct_m2(inputs) / inputs.free_area_m2)


SHARES: dict[str, Callable[[MetricMemory, RewardInputs], float]] = {
    "coverage": coverage,
    "correct_coverage": correct_coverage,
}
METRIC_TERMS = (*SHARES, "shaping", "pace")


def shares(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> dict[str, float]:
    """c of each metric that has a weight."""
    return {name: share(memory, inputs) for name, share in SHARES.items() if getattr(config, name)}


def start_metrics(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> None:
    """Note c(0), which the first step pays."""
    memory.shares = shares(memory, inputs, config)
    memory.owed = dict(memory.shares)
    memory.prospect = prospect(memory, inputs, config) if config.pace else 0.0


def metric_terms(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> dict[str, float]:
    """The terms of this step; updates `memory`.

    - `coverage`, `correct_coverage`: their increase times the share of the step limit that is left.
    - `shaping`: the increase of F = budget exp(-d / 5 m), d the distance to the nearest goal; F is 0 before the first
      step and after the last one, so that the sum over an episode is 0 (potential-based: Ng, Harada, Russell 1999).
    - `pace`: the increase of `prospect`, so that the sum over an episode is -(1 - c(0)) whatever the robot does.
    """
    found = shares(memory, inputs, config)
    terms = {
        name: memory.owed.pop(name, 0.0) + inputs.budget * (share - memory.shares.get(name, 0.0))
        for name, share in found.items()
    }
    memory.shares = found
    if config.shaping:
        before, memory.nearness = memory.nearness, inputs.budget * nearness(inputs)
        terms["shaping"] = memory.nearness - before
    if config.pace:
        before, memory.prospect = memory.prospect, prospect(memory, inputs, config)
        terms["pace"] = memory.prospect - before
    return terms


def prospect(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> float:
    """(1 - c) times the share of the step limit that is left, the most that can still be earned; 0 after the end."""
    if inputs.over:
        return 0.0
    share = SHARES["correct_coverage" if config.correct_coverage else "coverage"]
    return inputs.budget * (1.0 - share(memory, inputs))


def nearness(inputs: RewardInputs) -> float:
    """exp(-d / 5 m), d the distance to the nearest goal as the crow flies; 0 without one."""
    if not len(inputs.p_goals):
        return 0.0
    away = inputs.p_goals - inputs.belief.T_map_robot[:2]
    return math.exp(-float(np.hypot(away[:, 0], away[:, 1]).min()) / NEAR_M)
