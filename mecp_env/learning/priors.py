"""Explorers as a score of the goals: what a policy does before it has learned anything."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional

from mecp_env.learning import tables
from mecp_env.policies.active import AHEAD_M, InformationWeights, Triggers
from mecp_env.policies.policy import GAIN, KIND, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, WAIT

START_M = 2.0  # added to every way, so that what lies at hand is not worth all
POWER = 0.7  # of the promise: a room twice as large is not worth twice the way
WINDING = 1.3  # the way from one goal to the next, times the straight line
LEAST_M2 = 0.3  # where no goal promises as much, the nearest is next
LEAST_SCORE = -4.0  # below the best goal's: nothing is ruled out
NOTHING = 1e-6
SELDOM = -1.0  # score of a goal on known ground
LEAST_SIGMA_M = 1e-3, 0.01  # of a predicted pose, for what a map is worth and for its entropy, as `stachniss` has it
INFORMATION, TRIGGERS = InformationWeights(), Triggers()

Explorer = Callable[[Tensor, Tensor, Tensor], Tensor]
Prior = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]  # also of the present drawing sigma (B,1) m


def like_nearest(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) of goals (B,G,9), valid (B,G), promise (B,G) m^2: the shorter the way, the more."""
    return below_best(-torch.log(goals[..., 2] + START_M), valid)


def like_gain(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) the logarithm of what `next_best_view` chooses by: promise^0.7 for the way, alone or with the next goal."""
    much = torch.where(valid, promise, 0.0).amax(-1, keepdim=True) >= LEAST_M2
    value = torch.where(much, promise, 1.0) ** POWER * valid
    way = goals[..., 2] + START_M
    both = value.unsqueeze(-1) + value.unsqueeze(-2)
    pairs = both / (way.unsqueeze(-1) + WINDING * tables.apart(goals) + START_M)
    others = valid.unsqueeze(-2) & ~torch.eye(goals.shape[-2], dtype=torch.bool)
    best = torch.where(others, pairs, 0.0).amax(-1)
    return below_best(torch.log(torch.maximum(best, value / way).clamp(min=NOTHING)), valid)


def like_stachniss(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) nat, the utility by which `stachniss` chooses among goals (B,G,12) with something to see and places.

    The present sigma of the pose counts for all goals alike, so it is left out. It never waits.
    """
    sigma_m, floors = sigma_there(goals), LEAST_SIGMA_M
    worth = 1.0 - torch.exp(-(INFORMATION.tau_m**2) / (2.0 * sigma_m.clamp(min=floors[0]) ** 2))
    known = INFORMATION.cell_nat_m2 * promise * worth + INFORMATION.landmark_nat * goals[..., GAIN]
    known = known - 2.0 * INFORMATION.pose_nat * torch.log(sigma_m.clamp(min=floors[1]))
    moves = valid & (torch.round(goals[..., KIND]) != WAIT)
    scores = below_best(known - INFORMATION.metre_nat * goals[..., PATH], moves)
    return torch.where(valid & ~moves, torch.full_like(scores, LEAST_SCORE), scores)


def like_none(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) all the same."""
    return torch.zeros_like(promise)


def below_best(score: Tensor, valid: Tensor) -> Tensor:
    """(B,G) how far each score lies below the best valid one: -4 to 0; 0 in rows that hold no goal."""
    best = torch.where(valid, score, -torch.inf).amax(-1, keepdim=True)
    return torch.where(valid, (score - best).clamp(min=LEAST_SCORE), 0.0)


def sigma_there(goals: Tensor) -> Tensor:
    """(B,G) m: the drawing sigma on arrival at goals (B,G,12), as predicted."""
    return torch.hypot(goals[..., SIGMA], AHEAD_M * goals[..., SIGMA_RAD])


def with_known_ground(prior: Explorer) -> Explorer:
    """The score of an explorer of new floor, where known ground is among the goals: it seldom drives there."""

    def score(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
        known = valid & (torch.round(goals[..., KIND]) >= PLACE)
        scores = prior(goals, valid & ~known, promise)
        return torch.where(known, torch.full_like(scores, SELDOM), scores)

    return score


def looking_first(prior: Explorer) -> Prior:
    """An explorer's score; while the pose is searched for, it looks elsewhere, as the explorers of `active` do."""

    def score(goals: Tensor, valid: Tensor, promise: Tensor, sigma_m: Tensor) -> Tensor:
        look = valid & (torch.round(goals[..., KIND]) == LOOK)
        scores = prior(goals, valid, promise)
        first = torch.where(look, torch.zeros_like(scores), torch.full_like(scores, LEAST_SCORE))
        return torch.where(look.any(-1, keepdim=True), first * valid, scores)

    return score


def returning_first(prior: Prior) -> Prior:
    """A score; where the place that `returning` drives to takes away enough of the drawing sigma, it comes first.

    It remembers no drive: it returns in every decision for which that holds. The learned part may outweigh it.
    """

    def score(goals: Tensor, valid: Tensor, promise: Tensor, sigma_m: Tensor) -> Tensor:
        scores, there = prior(goals, valid, promise, sigma_m), sigma_there(goals)
        places = valid & (torch.round(goals[..., KIND]) == PLACE)
        of_use = places & (there < sigma_m - TRIGGERS.lost_m)
        cost = torch.where(of_use, there + TRIGGERS.metre * sigma_m * goals[..., PATH], torch.inf)
        best = functional.one_hot(cost.argmin(-1), cost.shape[-1]).bool()
        first = torch.where(best, torch.zeros_like(scores), torch.full_like(scores, SELDOM)) * valid
        return torch.where(of_use.any(-1, keepdim=True), first, scores)

    return score


PRIORS: dict[str, Prior] = {
    "nearest": looking_first(with_known_ground(like_nearest)),
    "gain": looking_first(with_known_ground(like_gain)),
    "returning": returning_first(looking_first(with_known_ground(like_gain))),
    "stachniss": looking_first(like_stachniss),
    "none": looking_first(with_known_ground(like_none)),
}
