"""The networks for this observation, in algorithms of Stable-Baselines3; padding of sets and tables has no influence.

A policy that points: each goal is scored by its own code and the context, whatever its row (Vinyals et al. 2015).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO, RecurrentPPO
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn
from torch.nn import functional

from mecp_env.episode.observation_arrays import GOALS
from mecp_env.episode.observations import make_space
from mecp_env.learning import tables
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.fits import downsampled_space
from mecp_env.learning.sb3_batch import OptionBuffer
from mecp_env.policies.explorers import LANDMARK_VALID
from mecp_env.policies.registry import VALID

LAYERS = 8  # of the grid
SCALES = 3
NEVER = -1e9  # a logit of what may not be chosen
CLASSES: dict[str, type[OnPolicyAlgorithm]] = {"ppo": PPO, "maskable_ppo": MaskablePPO, "recurrent_ppo": RecurrentPPO}
FIRST_LOG_STD = -0.7  # of velocities: half of the largest


def layers(*sizes: int) -> nn.Sequential:
    """Linear layers of these sizes, each followed by a ReLU."""
    parts: list[nn.Module] = []
    for before, after in pairwise(sizes):
        parts += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*parts)


def of_rows(network: nn.Module, rows: Tensor, valid: Tensor) -> Tensor:
    """(B,n,w) what a network makes of the valid rows (B,n,c), one by one; 0 in the others, which cost nothing."""
    places = valid.flatten().nonzero().squeeze(1)
    codes: Tensor = network(rows.flatten(0, 1).index_select(0, places))
    spread = codes.new_zeros(valid.numel(), codes.shape[-1]).index_copy(0, places, codes)
    return spread.unflatten(0, valid.shape)


def used_rows(valid: Tensor) -> int:
    """How many rows there are up to the last one that is valid (B,n) in any observation, at least 1."""
    used = (valid > 0.5).any(0).nonzero()
    return int(used[-1]) + 1 if len(used) else 1


def pooled(codes: Tensor, valid: Tensor) -> Tensor:
    """(B,2w) mean and maximum of codes (B,n,w) >= 0 over the valid rows; 0 where there is none."""
    kept = codes * valid.unsqueeze(-1)
    count = valid.sum(-1, keepdim=True).clamp(min=1)
    return torch.cat([kept.sum(1) / count, kept.amax(1)], -1)


class GridEncoder(nn.Module):
    """A small convolutional network: coarse over the whole window, fine around the robot."""

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        c = channels
        self.local = nn.Sequential(
            nn.Conv2d(LAYERS, c, 3, padding=1), nn.ReLU(), nn.Conv2d(c, c, 3, padding=1), nn.ReLU()
        )
        self.whole = nn.Sequential(nn.Conv2d(c, 2 * c, 3, 2, 1), nn.ReLU(), nn.Flatten())
        self.near = nn.Sequential(
            nn.Conv2d(LAYERS, c, 3, 2, 1), nn.ReLU(), nn.Conv2d(c, 2 * c, 3, 2, 1), nn.ReLU(), nn.AvgPool2d(2)
        )
        self.out = layers(2 * c * 36 + 2 * c * 16, width)

    def forward(self, coarse: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
        """A code (B,width), and maps (B,16+C,12,12): what the grid shows at each place, as it is and as learned."""
        half, wide = tables.surroundings(coarse)
        learned = self.local(half)
        code: Tensor = self.out(torch.cat([self.whole(learned), self.near(near).flatten(1)], 1))
        return code, torch.cat([half, wide, learned], 1)


class Attention(nn.Module):
    """Each goal looks at the valid ones, the nearer the more; permutation of the rows permutes what comes out."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.per_m = nn.Parameter(torch.tensor(0.2))
        self.out = nn.Linear(width, width)

    def forward(self, codes: Tensor, valid: Tensor, apart_m: Tensor) -> Tensor:
        """New codes (B,G,width) >= 0 from codes, valid (B,G) and distances (B,G,G)."""
        match = self.query(codes) @ self.key(codes).transpose(1, 2) / codes.shape[-1] ** 0.5
        logits = match - functional.softplus(self.per_m) * apart_m
        weights = torch.softmax(logits.masked_fill(~valid.unsqueeze(1), NEVER), -1)
        return functional.relu(codes + self.out(weights @ self.value(codes)))


class ObservationEncoder(BaseFeaturesExtractor):
    """Features (B,F) of an observation: its context, and with a prior a code of each goal for a head that points.

    With a `prior` (rows) the observation has a `promise`, and the features are, one after the other: context (width),
    codes (32 x width), valid (32), the prior's score (32).
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        width: int,
        channels: int,
        attention: bool,
        prior: str | None = None,
        uncertainty: bool = True,
    ) -> None:
        goals = observation_space["goals"].shape
        assert goals is not None
        predicted = "localisation" in observation_space.spaces
        super().__init__(observation_space, width + (goals[0] * (width + 2) if prior else 0))
        self.prior, self.uncertainty = prior, uncertainty
        self.grid = GridEncoder(channels, width)
        promises = tables.PROMISE_COLUMNS if prior else 0
        columns = tables.GOAL_COLUMNS + tables.PREDICTED_COLUMNS * predicted
        self.goal = layers(columns + SCALES * LAYERS + channels + 2 + promises, width, width)
        self.attention = Attention(width) if attention else None
        self.landmark = layers(tables.LANDMARK_COLUMNS, width // 2, width // 2)
        pose = tables.POSE_COLUMNS + tables.TRUST_COLUMNS * predicted
        self.context = layers(width + 2 * width + width + pose, width)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Features (B,F); a compact observation, its grids in 0..1, the tables as they are."""
        if not self.uncertainty:
            observations = tables.without_uncertainty(observations)
        table, landmarks = observations["goals"], observations["landmarks"]
        goals = table[:, : used_rows(table[..., VALID])]
        grid, maps = self.grid(observations["coarse"], observations["near"])
        rows, valid = tables.goal_rows(goals)
        around = [tables.at_goals(layer, goals) for layer in (observations["coarse"], maps)]
        score = None
        if self.prior is not None:
            promise = observations["promise"][:, : goals.shape[1]]
            sigma_m = tables.drawing_sigma(observations["pose_cov"])
            score = tables.prior_scores(self.prior, goals, valid, promise, sigma_m)
            around.append(tables.promise_rows(promise, score, goals))
        codes = of_rows(self.goal, torch.cat([rows, *around], -1), valid)
        if self.attention is not None:
            codes = self.attention(codes, valid, tables.apart(goals))
        known_rows, known = tables.landmark_rows(landmarks[:, : used_rows(landmarks[..., LANDMARK_VALID])])
        pose = [tables.pose_row(observations["pose"], observations["pose_cov"])]
        pose += [observations["localisation"]] if "localisation" in observations else []
        parts = [grid, pooled(codes, valid), pooled(of_rows(self.landmark, known_rows, known), known), *pose]
        context = self.context(torch.cat(parts, -1))
        if score is None:
            return context
        columns = torch.cat([codes * valid.unsqueeze(-1), valid.unsqueeze(-1), score.unsqueeze(-1)], -1)
        width, empty = codes.shape[-1], table.shape[1] - goals.shape[1]
        found, marks, scores = functional.pad(columns, (0, 0, 0, empty)).split([width, 1, 1], -1)
        return torch.cat([context, found.flatten(1), marks.flatten(1), scores.flatten(1)], -1)


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


def policy_arguments(config: TrainConfig) -> tuple[Any, dict[str, Any]]:
    """The class of the policy (or its name for Stable-Baselines3) and its keywords."""
    network = config.network
    encoder = {"width": network.width, "channels": network.grid_channels}
    encoder |= {"attention": network.attention, "uncertainty": network.uncertainty}
    common: dict[str, Any] = {"features_extractor_class": ObservationEncoder}
    if config.algorithm == "maskable_ppo":
        mine = {"width": network.width, "sharpness": network.sharpness}
        return GoalPointerPolicy, common | mine | {"features_extractor_kwargs": encoder | {"prior": network.prior}}
    heads = {"pi": [network.width], "vf": [network.width]}
    common |= {"features_extractor_kwargs": encoder, "net_arch": heads, "log_std_init": FIRST_LOG_STD}
    if config.algorithm == "recurrent_ppo":
        return "MultiInputLstmPolicy", common | {"lstm_hidden_size": network.lstm}
    return "MultiInputPolicy", common


def make_model(config: TrainConfig, venv: VecEnv, seed: int) -> OnPolicyAlgorithm:
    """The algorithm of a configuration on some environments; the policy's weights follow from the seed."""
    ppo = config.ppo
    policy, keywords = policy_arguments(config)
    buffer = {"rollout_buffer_class": OptionBuffer} if config.algorithm == "maskable_ppo" else {}
    return CLASSES[config.algorithm](
        policy,
        venv,
        learning_rate=(lambda left: ppo.learning_rate * max(0.0, left)) if ppo.anneal else ppo.learning_rate,
        n_steps=ppo.steps,
        batch_size=min(ppo.batch, ppo.steps * config.environments),
        n_epochs=ppo.epochs,
        gamma=ppo.discount,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip,
        ent_coef=ppo.entropy,
        vf_coef=ppo.value,
        max_grad_norm=ppo.gradient_norm,
        target_kl=ppo.target_kl,
        policy_kwargs=keywords,
        seed=seed,
        device="cpu",
        **buffer,
    )


def make_network(config: TrainConfig) -> BasePolicy:
    """The network of a configuration, without environment and algorithm; its weights are still random."""
    policy, keywords = policy_arguments(config)
    if isinstance(policy, str):
        policy = CLASSES[config.algorithm].policy_aliases[policy]
    goals = config.actions == "goal"
    actions = spaces.Discrete(GOALS) if goals else spaces.Box(-1.0, 1.0, (2,), np.float32)
    seen = downsampled_space(make_space(False, 0, 1.0, config.env.observation.uncertainty), goals)
    made: BasePolicy = policy(seen, actions, lambda _: 0.0, **keywords)
    made.set_training_mode(False)
    return made
