"""Model files of Stable-Baselines3 and sb3-contrib (.zip). Loading one can run code, so the caller must trust it."""

from __future__ import annotations

import importlib
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from sb3_contrib import MaskablePPO

from mecp_env.core.array_types import Bools
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Settings, describe
from mecp_env.learning import files
from mecp_env.learning.exported import read_fields
from mecp_env.learning.files import WeightError
from mecp_env.learning.fits import fit
from mecp_env.learning.model_policy import ModelPolicy, batched

MOST_UNPACKED = 1_000_000_000  # bytes of a model file of Stable-Baselines3
CLASSES = {  # module of the policy or of the buffer that a file names -> "module:class" of the algorithm
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
    by_module = (found for mark, found in CLASSES.items() if any(mark in text for text in named))
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
