"""A policy that points: each goal is scored by its own code and the context, whatever its row (Vinyals et al. 2015)."""

from __future__ import annotations

from typing import Any

import torch
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from mecp_env.learning.encoder import layers, of_rows


class PointerHeads(nn.Module):
    """Scores of the goals for the actor, a code for the critic.

    A score is that of an explorer (`priors`), times a sharpness, and what is learned on top, which is 0 at the start:
    an untrained policy does as that explorer. The sharpness is learned, too.
    """

    def __init__(self, width: int, goals: int, sharpness: float) -> None:
        super().__init__()
        self.width, self.goals = width, goals
        self.latent_dim_pi, self.latent_dim_vf = goals, width
        self.sharpness = nn.Parameter(torch.tensor(float(sharpness)))
        self.score = nn.Sequential(layers(2 * width, width), nn.Linear(width, 1))
        self.critic = layers(width, width)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """What actor and critic make of the features."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        """(B,G) scores; those of rows without a goal are 0, the mask bars them."""
        n = self.goals
        context, codes, valid, prior = torch.split(features, [self.width, n * self.width, n, n], -1)
        codes = codes.unflatten(-1, (n, self.width))
        beside = context.unsqueeze(1).expand(-1, n, -1)
        learned = of_rows(self.score, torch.cat([codes, beside], -1), valid > 0.5).squeeze(-1)
        return (learned + self.sharpness * prior) * valid

    def forward_critic(self, features: Tensor) -> Tensor:
        """(B,width) from the context alone."""
        code: Tensor = self.critic(features[..., : self.width])
        return code


class GoalPointerPolicy(MaskableMultiInputActorCriticPolicy):
    """The policy of `maskable_ppo`: one encoder for actor and critic."""

    def __init__(self, *args: Any, width: int, sharpness: float, **kwargs: Any) -> None:
        self.sizes = (width, sharpness)
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        width, sharpness = self.sizes
        self.mlp_extractor = PointerHeads(width, int(self.action_space.n), sharpness)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()  # the scores are the logits
        last = self.mlp_extractor.score[-1]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)
