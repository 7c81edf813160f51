"""The algorithms of Stable-Baselines3 with the networks for this observation."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO, RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv

from mecp_env.core.errors import ConfigError
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.episode.observations import make_space
from mecp_env.learning import files
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.downsampled import downsampled_space
from mecp_env.learning.encoder import GoalPointerPolicy, ObservationEncoder
from mecp_env.learning.sb3_batch import OptionBuffer

CLASSES: dict[str, type[OnPolicyAlgorithm]] = {
    "ppo": PPO,
    "maskable_ppo": MaskablePPO,
    "recurrent_ppo": RecurrentPPO,
}
FIRST_LOG_STD = -0.7  # of velocities: half of the largest


def policy_arguments(config: TrainConfig) -> tuple[Any, dict[str, Any]]:
    """The class of the policy (or its name for Stable-Baselines3) and its keywords."""
    network = config.network
    encoder = {"width": network.width, "channels": network.grid_channels, "attention": network.attention}
    encoder |= {"uncertainty": network.uncertainty}
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


def check_size(config: TrainConfig) -> None:
    """Raise `ConfigError` for a network whose weights would be refused at loading."""
    torch.set_num_threads(1)  # workers may be forked later, which threads of PyTorch would not survive
    size = len(files.tensor_bytes(files.weights_of(make_network(config))))
    network = config.network
    if size > files.MOST_POLICY_BYTES:
        raise ConfigError(
            f"network.width: {network.width} (grid_channels {network.grid_channels}, lstm {network.lstm}) makes a file "
            f"of {size} bytes of weights, at most {files.MOST_POLICY_BYTES}"
        )
