"""The observation as a network wants it: numbers of size 1, labels as what they mean, padding with a mask.

All here is fixed arithmetic (the normalisation of the inputs); nothing is learned. B is the number of observations;
there are 32 rows of goals and 128 of landmarks.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from mecp_env.policies.active import AHEAD_M

NEAR_M = 10.0  # a length that is large for the network
WIDE_M = 10.0  # a goal that is wider counts as so wide
CROWD_M = 3.0  # goals as near to each other are neighbours
HALF_M = 9.6  # of the grid's window
KINDS = 4  # of goals with something left to see
MORE_KINDS = (4, 5, 6)  # a place on known ground, waiting, a look elsewhere
VARIANCE_FLOOR = 1e-8
GOAL_COLUMNS, PROMISE_COLUMNS, LANDMARK_COLUMNS, POSE_COLUMNS = 24, 4, 9, 9
PREDICTED_COLUMNS, TRUST_COLUMNS = 6, 3  # with `uncertainty`


def goal_rows(goals: Tensor) -> tuple[Tensor, Tensor]:
    """The goals (B,32,9) as numbers (B,32,24), and which rows hold one (B,32) bool; the others are 0.

    Place, way, detour, width, kind, level and visits; whether it lies in the room to be completed now; how many goals
    share its room or lie near; how many are nearer. Of goals (B,32,12) six numbers more: the kinds of known ground, and
    what is predicted.
    """
    valid = goals[..., 8] > 0.5
    x, y, path, size, kind, _, level, visits = goals[..., :8].unbind(-1)
    straight = torch.hypot(x, y)
    far = torch.clamp(straight, min=1e-3)
    size = torch.clamp(size, max=WIDE_M)
    kinds = (
        (functional.one_hot(kind.long().clamp(0, KINDS - 1), KINDS) * (kind < KINDS).unsqueeze(-1)).float().unbind(-1)
    )
    columns = [
        *(x / NEAR_M, y / NEAR_M, x / far, y / far, straight / NEAR_M),
        *(path / NEAR_M, torch.log1p(path), torch.exp(-path / 2.0), torch.clamp(path / far, max=5.0) / 5.0),
        *(size / 2.0, torch.log1p(size), *kinds, level / 5.0, visits / 2.0),
        *relations(goals, valid),
        *predictions(goals),
    ]
    rows = torch.stack(columns, -1)
    return rows * valid.unsqueeze(-1), valid


def predictions(goals: Tensor) -> tuple[Tensor, ...]:
    """The kinds of known ground, and what is predicted of the way to each goal: six columns (B,32), or none."""
    if goals.shape[-1] <= 9:
        return ()
    sigma_m, sigma_rad, gain = goals[..., 9:12].unbind(-1)
    kinds = (torch.round(goals[..., 4]) == kind for kind in MORE_KINDS)
    return *(kind.float() for kind in kinds), log_sigma(sigma_m**2), log_sigma(sigma_rad**2), torch.log1p(gain) / 2.0


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
    """How each goal stands to the others: seven columns (B,32)."""
    both = valid.unsqueeze(-1) & valid.unsqueeze(-2)
    room, path, door = goals[..., 5], goals[..., 2], (torch.round(goals[..., 4]) == 3) & valid
    same = (room.unsqueeze(-1) == room.unsqueeze(-2)) & both
    near = (apart(goals) < CROWD_M) & both
    nearer = (path.unsqueeze(-1) > path.unsqueeze(-2)) & both
    first = torch.where(valid, path, torch.full_like(path, torch.inf)).amin(-1, keepdim=True)
    ahead = torch.where(valid, path - first, torch.zeros_like(path))
    total = valid.float().sum(-1, keepdim=True).expand_as(path)
    doors = door.float().sum(-1, keepdim=True).expand_as(path)
    counts = (same.float().sum(-1), near.float().sum(-1), nearer.float().sum(-1), total, doors)
    return *(count / 8.0 for count in counts), ahead / NEAR_M, (nearer.sum(-1) == 0).float()


def apart(goals: Tensor) -> Tensor:
    """(B,32,32) m: how far the goals lie from each other in a straight line."""
    x, y = (place.unsqueeze(-1) - place.unsqueeze(-2) for place in goals[..., :2].unbind(-1))
    return torch.sqrt(x * x + y * y)


def landmark_rows(landmarks: Tensor) -> tuple[Tensor, Tensor]:
    """The landmarks (B,128,8) as numbers (B,128,9), and which rows hold one (B,128) bool; the others are 0."""
    valid = landmarks[..., 7] > 0.5
    x, y, xx, _, yy, _, kind = landmarks[..., :7].unbind(-1)
    far = torch.hypot(x, y)
    kinds = functional.one_hot(kind.long().clamp(0, 2), 3).float().unbind(-1)
    columns = [x / NEAR_M, y / NEAR_M, far / NEAR_M, torch.exp(-far / 2.0), log_sigma(xx), log_sigma(yy), *kinds]
    return torch.stack(columns, -1) * valid.unsqueeze(-1), valid


def pose_row(pose: Tensor, cov: Tensor) -> Tensor:
    """Pose (B,4) and covariance (B,6) as numbers (B,9)."""
    xx, xy, xt, yy, yt, tt = cov.unbind(-1)
    deviations = [log_sigma(value) for value in (xx, yy, tt)]
    correlations = [
        cross / torch.sqrt(torch.clamp(a * b, min=VARIANCE_FLOOR**2)).clamp(min=1e-9)
        for cross, a, b in ((xy, xx, yy), (xt, xx, tt), (yt, yy, tt))
    ]
    home = torch.hypot(pose[..., 0], pose[..., 1])
    columns = [*deviations, *(value.clamp(-1.0, 1.0) for value in correlations), home / 20.0]
    return torch.cat([torch.stack(columns, -1), pose[..., 2:4]], -1)


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
    return half, _sum_of_nine(half) / _sum_of_nine(torch.ones_like(half[0, 0]))


def _sum_of_nine(maps: Tensor) -> Tensor:
    """(...,n,n) sums of the cells around each one, without those outside."""
    n = maps.shape[-1]
    wide = functional.pad(maps, (1, 1, 1, 1))
    rows = wide[..., :n] + wide[..., 1 : n + 1] + wide[..., 2:]
    return rows[..., :n, :] + rows[..., 1 : n + 1, :] + rows[..., 2:, :]
