"""Rewards whose sum is a metric: coverage, or correct coverage, as a mean over the step limit; and shaping.

With c(t) after step t and the limit L, an episode scores (c(0) + ... + c(L-1)) / L, the last value held after its end.
Step t pays what it adds to this score if nothing more is found: (c(t) - c(t-1)) (L - t) / L, and the first step also
c(0). So early floor counts more, every building pays at most 1, and a map that slides off gives back what it had.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mecp_env.config import RewardConfig
from mecp_env.episode.potentials import RewardInputs, expected_correct_m2

NEAR_M = 5.0  # at this distance the nearness of a goal is 1/e


@dataclass(slots=True, eq=False)
class MetricMemory:
    """What the terms were computed from in the step before; plain state."""

    floor_m2: float = 0.0  # mapped floor when the robot was last sure of its pose
    shares: dict[str, float] = field(default_factory=dict)  # c(t-1)
    owed: dict[str, float] = field(default_factory=dict)  # c(0), until the first step pays it
    nearness: float = 0.0  # the potential of the shaping


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
METRIC_TERMS = (*SHARES, "shaping")


def shares(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> dict[str, float]:
    """c of each metric that has a weight."""
    return {name: share(memory, inputs) for name, share in SHARES.items() if getattr(config, name)}


def start_metrics(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> None:
    """Note c(0), which the first step pays."""
    memory.shares = shares(memory, inputs, config)
    memory.owed = dict(memory.shares)


def metric_terms(memory: MetricMemory, inputs: RewardInputs, config: RewardConfig) -> dict[str, float]:
    """The terms of this step; updates `memory`.

    - `coverage`, `correct_coverage`: their increase times the share of the step limit that is left.
    - `shaping`: the increase of F = budget exp(-d / 5 m), d the distance to the nearest goal; F is 0 before the first
      step and after the last one, so that the sum over an episode is 0 (potential-based: Ng, Harada, Russell 1999).
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
    return terms


def nearness(inputs: RewardInputs) -> float:
    """exp(-d / 5 m), d the distance to the nearest goal as the crow flies; 0 without one."""
    if not len(inputs.p_goals):
        return 0.0
    away = inputs.p_goals - inputs.belief.T_map_robot[:2]
    return math.exp(-float(np.hypot(away[:, 0], away[:, 1]).min()) / NEAR_M)
