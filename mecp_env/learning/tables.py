"""The observation as a network wants it: numbers of size 1, labels as what they mean, padding with a mask.

All here is fixed arithmetic (the normalisation of the inputs); nothing is learned. B is the number of observations;
there are 32 rows of goals and 128 of landmarks.

Explorers as a score of the goals: what a policy does before it has learned anything.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor
from torch.nn import functional

from mecp_env.planning.goal_list import AHEAD_M
from mecp_env.policies.active import InformationWeights, Triggers
from mecp_env.policies.registry import GAIN, KIND, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, WAIT

NEAR_M = 10.0  # a length that is large for the network
WIDE_M = 10.0  # a goal that is wider counts as so wide
CROWD_M = 3.0  # goals as near to each other are neighbours
HALF_M = 9.6  # of the grid's window
KINDS = 4  # of goals with something left to see
MORE_KINDS = (4, 5, 6)  # a place on known ground, waiting, a look elsewhere
VARIANCE_FLOOR = 1e-8
GOAL_COLUMNS, PROMISE_COLUMNS, LANDMARK_COLUMNS, POSE_COLUMNS = 24, 4, 9, 9
PREDICTED_COLUMNS, TRUST_COLUMNS = 6, 3  # with `uncertainty`
WAY_SCALES = [NEAR_M, NEAR_M, 1.0, 1.0, NEAR_M, NEAR_M, 1.0, 1.0, 5.0]  # what columns of goals are divided by
OTHER_SCALES = [2.0, 1.0, *[1.0] * KINDS, 5.0, 2.0, *[8.0] * 5, NEAR_M, 1.0]
GOAL_SCALES = torch.tensor([*WAY_SCALES, *OTHER_SCALES, *[1.0] * 5, 2.0])


def goal_rows(goals: Tensor) -> tuple[Tensor, Tensor]:
    """The goals (B,32,9) as numbers (B,32,24), and which rows hold one (B,32) bool; the others are 0.

    Place, way, detour, width, kind, level and visits; whether it lies in the room to be completed now; how many goals
    share its room or lie near; how many are nearer. Of goals (B,32,12) six numbers more: the kinds of known ground, and
    what is predicted.
    """
    valid = goals[..., 8] > 0.5
    x, y, path, size, kind, _, level, visits = goals[..., :8].unbind(-1)
    straight = torch.hypot(x, y)
    far, size = torch.clamp(straight, min=1e-3), torch.clamp(size, max=WIDE_M)
    way = [path, torch.log1p(path), torch.exp(-0.5 * path), torch.clamp(path / far, max=5.0)]
    first = torch.stack([x, y, x / far, y / far, straight, *way, size, torch.log1p(size)], -1)
    others = torch.stack([level, visits, *relations(goals, valid), *predictions(goals)], -1)
    rows = torch.cat([first, one_hot(kind, KINDS), others], -1)
    return rows / GOAL_SCALES[: rows.shape[-1]] * valid.unsqueeze(-1), valid


def one_hot(kind: Tensor, kinds: int) -> Tensor:
    """(...,kinds) 1 for the kind, a whole number, and 0 for the others; all 0 for any other kind."""
    return (kind.unsqueeze(-1) == torch.arange(kinds)).float()


def predictions(goals: Tensor) -> tuple[Tensor, ...]:
    """Kinds of known ground, and what is predicted of the way to each goal: six columns (B,32) or none, not scaled."""
    if goals.shape[-1] <= 9:
        return ()
    sigma_m, sigma_rad, gain = goals[..., 9:12].unbind(-1)
    kinds = (torch.round(goals[..., 4]) == kind for kind in MORE_KINDS)
    return *(kind.float() for kind in kinds), log_sigma(sigma_m**2), log_sigma(sigma_rad**2), torch.log1p(gain)


def without_uncertainty(observations: dict[str, Tensor]) -> dict[str, Tensor]:
    """Downsampled observations with 0 for all covariances, predictions and the confidence."""
    goals, landmarks = observations["goals"].clone(), observations["landmarks"].clone()
    goals[..., 9:], landmarks[..., 2:5] = 0.0, 0.0
    zero = {name: torch.zeros_like(observations[name]) for name in ("pose_cov", "localisation") if name in observations}
    return observations | zero | {"goals": goals, "landmarks": landmarks}


def promise_rows(promise: Tensor, score: Tensor, goals: Tensor) -> Tensor:
    """The promise (B,32) m^2 and an explorer's score (B,32) of the goals as numbers (B,32,4)."""
    per_m = torch.sqrt(promise) / (goals[..., 2] + 1.0)
    return torch.stack([promise / 20.0, torch.log1p(promise) / 2.0, per_m, score], -1)


def relations(goals: Tensor, valid: Tensor) -> tuple[Tensor, ...]:
    """How each goal stands to the others: seven columns (B,32), before they are scaled."""
    both = valid.unsqueeze(-1) & valid.unsqueeze(-2)
    room, path = goals[..., 5], goals[..., 2]
    same = ((room.unsqueeze(-1) == room.unsqueeze(-2)) & both).sum(-1)
    near = ((apart(goals) < CROWD_M) & both).sum(-1)
    nearer = ((path.unsqueeze(-1) > path.unsqueeze(-2)) & both).sum(-1)
    first = torch.where(valid, path, torch.inf).amin(-1, keepdim=True)
    ahead = torch.where(valid, path - first, 0.0)
    doors = (torch.round(goals[..., 4]) == 3) & valid
    total, doors = (marked.sum(-1, keepdim=True).expand_as(path) for marked in (valid, doors))
    return same, near, nearer, total, doors, ahead, nearer == 0


def apart(goals: Tensor) -> Tensor:
    """(B,32,32) m: how far the goals lie from each other in a straight line."""
    x, y = (place.unsqueeze(-1) - place.unsqueeze(-2) for place in goals[..., :2].unbind(-1))
    return torch.sqrt(x * x + y * y)


def landmark_rows(landmarks: Tensor) -> tuple[Tensor, Tensor]:
    """The landmarks (B,128,8) as numbers (B,128,9), and which rows hold one (B,128) bool; the others are 0."""
    valid = landmarks[..., 7] > 0.5
    x, y, xx, _, yy, _, kind = landmarks[..., :7].unbind(-1)
    far = torch.hypot(x, y)
    near = torch.stack([x, y, far], -1) / NEAR_M
    sigmas = log_sigma(torch.stack([xx, yy], -1))
    rows = torch.cat([near, torch.exp(-0.5 * far).unsqueeze(-1), sigmas, one_hot(kind.clamp(0, 2), 3)], -1)
    return rows * valid.unsqueeze(-1), valid


def pose_row(pose: Tensor, cov: Tensor) -> Tensor:
    """Pose (B,4) and covariance (B,6) as numbers (B,9)."""
    xx, xy, xt, yy, yt, tt = cov.unbind(-1)
    products = torch.stack([xx, xx, yy], -1) * torch.stack([yy, tt, tt], -1)
    scales = torch.sqrt(torch.clamp(products, min=VARIANCE_FLOOR**2)).clamp(min=1e-9)
    correlations = (torch.stack([xy, xt, yt], -1) / scales).clamp(-1.0, 1.0)
    home = torch.hypot(pose[..., 0], pose[..., 1]).unsqueeze(-1)
    return torch.cat([log_sigma(torch.stack([xx, yy, tt], -1)), correlations, home / 20.0, pose[..., 2:4]], -1)


def drawing_sigma(cov: Tensor) -> Tensor:
    """(B,1) m: standard deviation of where a wall is drawn ahead, by the covariance (B,6) of the pose."""
    return torch.sqrt(0.5 * (cov[:, :1] + cov[:, 3:4]) + AHEAD_M**2 * cov[:, 5:6])


def log_sigma(variance: Tensor) -> Tensor:
    """The logarithm of a deviation, about -1 to 1 for 1 mm to 1 m."""
    return 0.5 * torch.log10(torch.clamp(variance, min=VARIANCE_FLOOR)) / 2.0 + 0.75


def at_goals(maps: Tensor, goals: Tensor) -> Tensor:
    """What maps (B,C,n,n) of the grid's window show at the goals: (B,32,C+1), the last is 1 inside the window.

    The robot is in the middle and looks up: forward is the first axis backwards, left the second one backwards.
    """
    place = torch.stack([-goals[..., 1], -goals[..., 0]], -1) / HALF_M
    seen = functional.grid_sample(maps, place.unsqueeze(1), align_corners=False).squeeze(2).transpose(1, 2)
    inside = (place.abs().amax(-1) <= 1.0).float()
    return torch.cat([seen, inside.unsqueeze(-1)], -1)


def surroundings(coarse: Tensor) -> tuple[Tensor, Tensor]:
    """The coarse grid (B,8,24,24) at 1.6 m per cell, (B,8,12,12), and its means over 4.8 m, (B,8,12,12)."""
    half = (
        coarse[..., ::2, ::2] + coarse[..., ::2, 1::2] + coarse[..., 1::2, ::2] + coarse[..., 1::2, 1::2]
    ) / 4.0  # as avg_pool2d, which takes five times as long
    return half, _sum_of_nine(half) / _cells_around(half.shape[-1])


def _sum_of_nine(maps: Tensor) -> Tensor:
    """(...,n,n) sums of the cells around each one, without those outside."""
    n = maps.shape[-1]
    wide = functional.pad(maps, (1, 1, 1, 1))
    rows = wide[..., :n] + wide[..., 1 : n + 1] + wide[..., 2:]
    return rows[..., :n, :] + rows[..., 1 : n + 1, :] + rows[..., 2:, :]


@functools.cache
def _cells_around(n: int) -> Tensor:
    """(n,n) how many cells `_sum_of_nine` adds."""
    with torch.inference_mode(False):
        return _sum_of_nine(torch.ones(n, n))


START_M = 2.0  # added to every way, so that what lies at hand is not worth all
POWER = 0.7  # of the promise: a room twice as large is not worth twice the way
WINDING = 1.3  # the way from one goal to the next, times the straight line
LEAST_M2 = 0.3  # where no goal promises as much, the nearest is next
LEAST_SCORE = -4.0  # below the best goal's: nothing is ruled out
NOTHING = 1e-6
SELDOM = -1.0  # score of a goal on known ground
LEAST_SIGMA_M = 1e-3, 0.01  # of a predicted pose, for what a map is worth and for its entropy, as `stachniss` has it
INFORMATION, TRIGGERS = InformationWeights(), Triggers()


def like_nearest(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) of goals (B,G,9), valid (B,G), promise (B,G) m^2: the shorter the way, the more."""
    return below_best(-torch.log(goals[..., 2] + START_M), valid)


def like_gain(goals: Tensor, valid: Tensor, promise: Tensor) -> Tensor:
    """(B,G) the logarithm of what `next_best_view` chooses by: promise^0.7 for the way, alone or with the next goal."""
    much = torch.where(valid, promise, 0.0).amax(-1, keepdim=True) >= LEAST_M2
    value = torch.where(much, promise, 1.0) ** POWER * valid
    way = goals[..., 2] + START_M
    both = value.unsqueeze(-1) + value.unsqueeze(-2)
    pairs = both / (way.unsqueeze(-1) + WINDING * apart(goals) + START_M)
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
    return torch.where(valid & ~moves, LEAST_SCORE, scores)


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


def returning_first(scores: Tensor, goals: Tensor, valid: Tensor, sigma_m: Tensor) -> Tensor:
    """Scores (B,G); where the place that `returning` drives to takes away enough of the drawing sigma, it comes first.

    It remembers no drive: it returns in every decision for which that holds. The learned part may outweigh it.
    """
    there = sigma_there(goals)
    places = valid & (torch.round(goals[..., KIND]) == PLACE)
    of_use = places & (there < sigma_m - TRIGGERS.lost_m)
    cost = torch.where(of_use, there + TRIGGERS.metre * sigma_m * goals[..., PATH], torch.inf)
    best = functional.one_hot(cost.argmin(-1), cost.shape[-1]).bool()
    return torch.where(of_use.any(-1, keepdim=True), torch.where(best, 0.0, SELDOM) * valid, scores)


EXPLORERS = {"nearest": like_nearest, "gain": like_gain, "returning": like_gain, "none": like_none}  # of new floor


def prior_scores(name: str, goals: Tensor, valid: Tensor, promise: Tensor, sigma_m: Tensor) -> Tensor:
    """(B,G) how an explorer scores the goals, while the drawing sigma is (B,1) m.

    One that explores new floor seldom drives to known ground. While the pose is searched for, each looks elsewhere, as
    the explorers of `active` do.
    """
    kind = torch.round(goals[..., KIND])
    if name == "stachniss":
        scores = like_stachniss(goals, valid, promise)
    else:
        known = valid & (kind >= PLACE)
        scores = torch.where(known, SELDOM, EXPLORERS[name](goals, valid & ~known, promise))
    look = valid & (kind == LOOK)
    scores = torch.where(look.any(-1, keepdim=True), torch.where(look, 0.0, LEAST_SCORE) * valid, scores)
    return returning_first(scores, goals, valid, sigma_m) if name == "returning" else scores
