"""Explorers as a score of the goals: what a policy does before it has learned anything."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from mecp_env.learning import tables

START_M = 2.0  # added to every way, so that what lies at hand is not worth all
POWER = 0.7  # of the promise: a room twice as large is not worth twice the way
WINDING = 1.3  # the way from one goal to the next, times the straight line
LEAST_M2 = 0.3  # where no goal promises as much, the nearest is next
LEAST_SCORE = -4.0  # below the best goal's: nothing is ruled out
NOTHING = 1e-6
NEW_KINDS = 4  # goals of these kinds have something left to see
SELDOM = -1.0  # score of a goal on known ground
LOOK = 6  # kind of a look elsewhere, while the pose is searched for

Prior = Callable[[Tensor, Tensor, Tensor], Tensor]


def like_nearest(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) of goals (B,G,9), valid (B,G), promise (B,G) m^2: the shorter the way, the more."""
    return below_best(-torch.log(goals[..., 2] + START_M), valid)


def like_gain(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) the logarithm of what `gain` chooses by: promise^0.7 for the way, alone or with the best goal to go on to.

    Its caution where the pose is unsure is left to learning.
    """
    much = torch.where(valid, promise, 0.0).amax(-1, keepdim=True) >= LEAST_M2
    value = torch.where(much, promise, 1.0) ** POWER * valid
    way = goals[..., 2] + START_M
    both = value.unsqueeze(-1) + value.unsqueeze(-2)
    pairs = both / (way.unsqueeze(-1) + WINDING * tables.apart(goals) + START_M)
    others = valid.unsqueeze(-2) & ~torch.eye(goals.shape[-2], dtype=torch.bool)
    best = torch.where(others, pairs, 0.0).amax(-1)
    return below_best(torch.log(torch.maximum(best, value / way).clamp(min=NOTHING)), valid)


def like_none(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) all the same."""
    return torch.zeros_like(promise)


def below_best(score: Tensor, valid: Tensor) -> Tensor:
    """(B,G) how far each score lies below the best valid one: -4 to 0; 0 in rows that hold no goal."""
    best = torch.where(valid, score, -torch.inf).amax(-1, keepdim=True)
    return torch.where(valid, (score - best).clamp(min=LEAST_SCORE), 0.0)


def with_known_ground(prior: Prior) -> Prior:
    """An explorer's score where goals on known ground are among the others: it seldom drives there.

    While the pose is searched for, it looks elsewhere, as the explorers that act on their uncertainty do.
    """

    def score(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
        kind = torch.round(goals[..., 4])
        known, look = valid & (kind >= NEW_KINDS), valid & (kind == LOOK)
        scores = prior(goals, valid & ~known, promise)
        scores = torch.where(known, torch.full_like(scores, SELDOM), scores)
        first = torch.where(look, torch.zeros_like(scores), torch.full_like(scores, LEAST_SCORE))
        return torch.where(look.any(-1, keepdim=True), first * valid, scores)

    return score


PRIORS: dict[str, Prior] = {"nearest": like_nearest, "gain": like_gain, "none": like_none}
