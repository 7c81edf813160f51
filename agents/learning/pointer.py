"""A policy that points: each goal is scored by its own code and the context, whatever its row (Vinyals et al. 2015)."""

from __future__ import annotations

from typing import Any

import torch
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from agents.learning.encoder import layers

START_M = 1.0  # added to every way, so that what lies at hand is not worth all
LEAST_M2 = 0.3  # a goal that promises less counts as one that promises so much


def like_nearest(way: Tensor, promise: Tensor) -> Tensor:
    """(B,G) the nearer, the more."""
    return -torch.log(way + START_M)


def like_gain(way: Tensor, promise: Tensor) -> Tensor:
    """(B,G) the logarithm of sqrt(promise) / (way + 1 m), by which `gain` chooses."""
    return 0.5 * torch.log(promise.clamp(min=LEAST_M2)) - torch.log(way + START_M)


def like_none(way: Tensor, promise: Tensor) -> Tensor:
    """(B,G) all the same."""
    return torch.zeros_like(way)


PRIORS = {"nearest": like_nearest, "gain": like_gain, "none": like_none}


class PointerHeads(nn.Module):
    """Scores of the goals for the actor, a code for the critic.

    A score is that of an explorer, times a sharpness, and what is learned on top, which is 0 at the start: an untrained
    policy does as that explorer. The sharpness is learned, too.
    """

    def __init__(self, width: int, goals: int, prior: str, sharpness: float) -> None:
        super().__init__()
        self.width, self.goals = width, goals
        self.latent_dim_pi, self.latent_dim_vf = goals, width
        self.prior = PRIORS[prior]
        self.sharpness = nn.Parameter(torch.tensor(float(sharpness)))
        self.score = nn.Sequential(layers(2 * width, width), nn.Linear(width, 1))
        self.critic = layers(width, width)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """What actor and critic make of the features."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        """(B,G) scores; those of rows without a goal are 0, the mask bars them."""
        n = self.goals
        context, codes, valid, way, promise = torch.split(features, [self.width, n * self.width, n, n, n], -1)
        codes = codes.unflatten(-1, (n, self.width))
        beside = context.unsqueeze(1).expand(-1, n, -1)
        learned: Tensor = self.score(torch.cat([codes, beside], -1)).squeeze(-1)
        return (learned + self.sharpness * self.prior(way, promise)) * valid

    def forward_critic(self, features: Tensor) -> Tensor:
        """(B,width) from the context alone."""
        code: Tensor = self.critic(features[..., : self.width])
        return code


class GoalPointerPolicy(MaskableMultiInputActorCriticPolicy):
    """The policy of `maskable_ppo`: one encoder for actor and critic."""

    def __init__(self, *args: Any, width: int, prior: str, sharpness: float, **kwargs: Any) -> None:
        self.sizes = (width, prior, sharpness)
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        width, prior, sharpness = self.sizes
        self.mlp_extractor = PointerHeads(width, int(self.action_space.n), prior, sharpness)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scores are the logits
        last = self.mlp_extractor.score[-1]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)
