"""The algorithms of Stable-Baselines3 with the networks for this observation.

Model files of Stable-Baselines3 and sb3-contrib (.zip). Loading one can run code, so the caller must trust it.
"""

from __future__ import annotations

import importlib
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from pydantic import ValidationError
from sb3_contrib import MaskablePPO, RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv

from mecp_env.core.carriers import Bools
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Settings, describe
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.episode.observations import make_space
from mecp_env.learning import files
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.downsampled import downsampled_space
from mecp_env.learning.encoder import GoalPointerPolicy, ObservationEncoder
from mecp_env.learning.exported import read_fields
from mecp_env.learning.files import WeightError
from mecp_env.learning.fits import fit
from mecp_env.learning.model_policy import ModelPolicy, batched
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


MOST_UNPACKED = 1_000_000_000  # bytes of a model file of Stable-Baselines3
STOCK_CLASSES = {  # module of the policy or of the buffer that a file names -> "module:class" of the algorithm
    "sb3_contrib.common.maskable": "sb3_contrib:MaskablePPO",
    "sb3_contrib.common.recurrent": "sb3_contrib:RecurrentPPO",
    "sb3_contrib.qrdqn": "sb3_contrib:QRDQN",
    "sb3_contrib.tqc": "sb3_contrib:TQC",
    "stable_baselines3.dqn": "stable_baselines3:DQN",
    "stable_baselines3.sac": "stable_baselines3:SAC",
    "stable_baselines3.td3": "stable_baselines3:TD3",
}
ON_POLICY = {  # the first of these settings that a file has
    "clip_range": "stable_baselines3:PPO",
    "cg_max_steps": "sb3_contrib:TRPO",
    "vf_coef": "stable_baselines3:A2C",
}
ANY = "stable_baselines3:PPO"
STATISTICS = ("{stem}_vecnormalize.pkl", "vecnormalize.pkl")  # of `VecNormalize`, beside the file


class StockConfig(Settings):
    """The JSON file that may be beside a model file (docs/submissions.md)."""

    deterministic: bool = True  # the most probable action, else a draw as in training


class StockModel:
    """Acts as an algorithm does; keeps the memory of recurrent networks; normalises as in training."""

    def __init__(self, algorithm: Any, statistics: Any = None, deterministic: bool = True) -> None:
        self.algorithm, self.statistics, self.deterministic = algorithm, statistics, deterministic
        self.takes_masks = isinstance(algorithm, MaskablePPO)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode; all draws in it follow from `seed`."""
        self.memory: Any = None
        self.episode_start = np.ones(1, np.bool_)
        if not self.deterministic:
            torch.manual_seed(seed)

    def predict(self, inputs: Any, mask: Bools | None) -> Any:
        """An action of the algorithm; only MaskablePPO takes the mask."""
        single = batched(inputs)
        batch = single if self.statistics is None else self.statistics.normalize_obs(single)
        masks = {"action_masks": np.asarray(mask)[None]} if self.takes_masks and mask is not None else {}
        actions, self.memory = self.algorithm.predict(
            batch, self.memory, self.episode_start, deterministic=self.deterministic, **masks
        )
        self.episode_start = np.zeros(1, np.bool_)
        return actions[0]


def load_zip(path: Path, trust: bool) -> ModelPolicy:
    """The model in a file of Stable-Baselines3, with the statistics of `VecNormalize` beside it.

    Raises `ConfigError` without `trust` or a file and for spaces that no environment has, `WeightError` for a file with
    another content.
    """
    if not path.is_file():
        raise ConfigError(f"policy: {path}: no such file")
    if not trust:
        raise ConfigError(
            f"policy: {path}: loading a model file of Stable-Baselines3 can run arbitrary code; if you trust its "
            "source, use --trust (load(path, trust=True))"
        )
    module, name = class_of(path).split(":")
    try:
        algorithm = getattr(importlib.import_module(module), name).load(path, device="cpu")
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{path}: cannot be loaded by Stable-Baselines3: {error!r:.300}") from error
    seen = algorithm.observation_space
    parts = {part: space.shape for part, space in seen.spaces.items()} if hasattr(seen, "spaces") else None
    found = fit(seen, algorithm.action_space, str(path))
    model = StockModel(algorithm, statistics_of(path), config_of(path).deterministic)
    return ModelPolicy(model, found, str(path), parts)


def config_of(path: Path) -> StockConfig:
    """What the JSON file beside a model file says; the defaults without one. Raises `ConfigError`."""
    beside = path.with_suffix(".json")
    if not beside.is_file():
        return StockConfig()
    try:
        return StockConfig.model_validate(read_fields(beside))
    except ValidationError as error:
        raise ConfigError(f"{beside}: {describe(error, 'fields', StockConfig)}") from None


def class_of(path: Path) -> str:
    """The algorithm of a model file as "module:class", from names in its text; no code is loaded for that."""
    try:
        with zipfile.ZipFile(path) as archive:
            files.check_archive(archive, MOST_UNPACKED)
            data = json.loads(archive.read("data"))
        named = str(data["policy_class"]["__module__"]), str(data.get("rollout_buffer_class"))
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(f"{path}: not a model file of Stable-Baselines3: {error!r}") from None
    by_module = (found for mark, found in STOCK_CLASSES.items() if any(mark in text for text in named))
    by_setting = (found for setting, found in ON_POLICY.items() if setting in data)
    return next(by_module, None) or next(by_setting, ANY)


def statistics_file(path: Path) -> Path | None:
    """The file with the statistics of `VecNormalize` that belongs to a model file, if there is one."""
    places = (path.with_name(name.format(stem=path.stem)) for name in STATISTICS)
    return next((place for place in places if place.is_file()), None)


def statistics_of(path: Path) -> Any:
    """What normalises the observations of a trusted model file; None without. Raises `WeightError`."""
    from stable_baselines3.common.vec_env import VecNormalize

    place = statistics_file(path)
    if place is None:
        return None
    try:
        with place.open("rb") as file:
            found = pickle.load(file)  # noqa: S301 (the caller trusts the model)
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{place}: cannot be loaded: {error!r:.300}") from error
    if not isinstance(found, VecNormalize):
        raise WeightError(f"{place}: expected the statistics of VecNormalize, got {type(found).__name__}")
    return found
