"""Builders of what the parts of an episode pass on."""

from typing import Any

from mecp_env.episode.potentials import RewardInputs
from mecp_env.episode.rewards import Happened
from mecp_env.slam.messages import Belief, SemanticGrid


def reward_inputs(belief: Belief, grid: SemanticGrid, **fields: Any) -> RewardInputs:
    return RewardInputs(belief=belief, grid=grid, **fields)


def happened(**fields: Any) -> Happened:
    return Happened(**fields)
