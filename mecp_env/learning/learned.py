"""Trained policies: `load("maskable_ppo")`, or the folder of a run. Loading one runs no code.

A policy is built from its configuration and then receives its weights, which are tensors and nothing else. A model
file of Stable-Baselines3 (a zip with a pickle) is code: it is refused unless the caller trusts it.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from mecp_env.config import merge
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess
from mecp_env.episode.actions import make_actions
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.learning import files
from mecp_env.learning.config import ALGORITHMS, TrainConfig, read_config
from mecp_env.learning.downsampled import TRUST, downsample, goal_masks, without_known_ground
from mecp_env.learning.files import WeightError
from mecp_env.learning.models import CLASSES, make_network
from mecp_env.learning.run_folder import CONFIG, POLICY
from mecp_env.policies import active
from mecp_env.policies.registry import WEIGHTS, shipped

FILE_NAME = re.compile(r"[\w.-]{1,100}\.safetensors", re.ASCII)
MOST_BYTES = files.MOST_POLICY_BYTES
MOST_UNPACKED = 1_000_000_000  # bytes of a model file of Stable-Baselines3
MARKS = {"sb3_contrib.common.maskable": "maskable_ppo", "sb3_contrib.common.recurrent": "recurrent_ppo"}


class PredictingPolicy:
    """Takes the most probable action of a model or network, as a function of the observation alone.

    With a configuration the network receives the downsampled observation, else the environment's own.
    """

    def __init__(self, network: Any, actions: str, config: TrainConfig | None, name: str) -> None:
        self.network, self.actions, self.config, self.name = network, actions, config, name
        parts = getattr(network.observation_space, "spaces", {}) if config is None else {}
        self.uncertainty = TRUST in parts if config is None else config.env.observation.uncertainty
        asked_for = {"observation": {part: True for part in ("map", "scan") if part in parts}}
        self.settings: Mapping[str, Any] = merge(dict(active.SETTINGS) if self.uncertainty else {}, asked_for)
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""
        self.memory: Any = None
        self.episode_start = np.ones(1, np.bool_)

    def act(self, observation: dict[str, Any], mask: Any = None) -> Any:
        """A row of the goals, or velocities (2,) float32; `mask` (32,) excludes rows.

        One that was trained without goals on known ground never chooses one, unless there is no other. Raises
        `ConfigError` without the columns that it was trained with.
        """
        if self.uncertainty:
            active.check_columns(observation, self.name)
        if self.actions != "goal":
            return np.asarray(self._predict(observation), np.float32)
        allowed = np.asarray(goal_masks(observation) if mask is None else mask, np.bool_)
        observation = observation if self.uncertainty else without_known_ground(observation)
        mine = allowed & goal_masks(observation)
        if not mine.any() and allowed.any():
            return int(allowed.argmax())
        return int(self._predict(observation, action_masks=mine[None]))

    def _predict(self, observation: dict[str, Any], **masks: Any) -> Any:
        if self.config is None:
            inputs = fitting(observation, self.network.observation_space, self.name)
        else:
            inputs = downsample(observation, self.actions == "goal")
        batch = {name: np.asarray(values)[None] for name, values in inputs.items()}
        actions, self.memory = self.network.predict(batch, self.memory, self.episode_start, deterministic=True, **masks)
        self.episode_start = np.zeros(1, np.bool_)
        return actions[0]


def fitting(observation: dict[str, Any], space: Any, name: str) -> dict[str, Any]:
    """The parts of an observation that are in the space of a model. Raises `ConfigError` where they do not fit."""
    here = {part: np.shape(values) for part, values in observation.items()}
    theirs = {part: box.shape for part, box in getattr(space, "spaces", {}).items()}
    if not theirs or any(here.get(part) != shape for part, shape in theirs.items()):
        raise ConfigError(f"policy: {name} was trained on {theirs or space}, the observation has {here}")
    return {part: observation[part] for part in theirs}


def load(name_or_folder: str | Path, trust: bool = False) -> PredictingPolicy:
    """The policy of that name from `mecp_env/learning/weights`, or that of a run folder.

    With `trust` also the model file of Stable-Baselines3 at that path, which may run arbitrary code while it is loaded.
    From then on PyTorch computes in one thread: one observation is too small for more, and the bits stay the same.
    Raises `ConfigError` for a wrong name or configuration, `WeightError` for weights that are damaged, too large, have
    another checksum, or belong to another network.
    """
    path = Path(name_or_folder)
    torch.set_num_threads(1)
    if path.suffix == ".safetensors":
        raise ConfigError(f"policy: {path} is the weights alone, name the folder that contains them")
    if path.suffix == ".zip" or path.is_file():
        return load_zip(path, trust)
    folder = WEIGHTS / path if str(path) in ALGORITHMS else path
    if not folder.is_dir():
        known = shipped()
        raise ConfigError(f"policy: {path}, expected one of {', '.join(known)}, or a run folder{guess(path, known)}")
    config = TrainConfig.build(read_config(folder / CONFIG))
    network = make_network(config)
    files.put_weights(network, *read_weights(folder, config))
    return PredictingPolicy(network, config.actions, config, str(path))


def read_weights(folder: Path, config: TrainConfig) -> tuple[dict[str, Any], Path]:
    """The weights that `policy.json` of a folder names, and their file. Raises `WeightError`."""
    if not (folder / POLICY).exists():
        raise WeightError(f"{folder}: no policy yet ({POLICY} is missing)")
    about = read_config(folder / POLICY)
    algorithm = about.get("algorithm")
    if algorithm != config.algorithm:
        raise WeightError(f"{folder / POLICY}: weights of {algorithm!r:.80}, {CONFIG} is of {config.algorithm}")
    name, sha256 = about.get("file"), about.get("sha256")
    if not isinstance(name, str) or not isinstance(sha256, str) or not FILE_NAME.fullmatch(name):
        raise WeightError(f"{folder / POLICY}: expected the name of a file in this folder and its SHA-256")
    return files.read_tensors(folder / name, sha256, MOST_BYTES), folder / name


def load_zip(path: Path, trust: bool) -> PredictingPolicy:
    """The model in a file of Stable-Baselines3.

    Raises `ConfigError` without `trust` or a file, `WeightError` for a file with another content.
    """
    if not path.is_file():
        raise ConfigError(f"policy: {path}: no such file")
    if not trust:
        raise ConfigError(
            f"policy: {path}: loading a model file of Stable-Baselines3 can run arbitrary code; if you trust its "
            "source, use --trust (load(path, trust=True))"
        )
    algorithm = algorithm_of(path)
    try:
        model = CLASSES[algorithm].load(path, device="cpu")
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{path}: cannot be loaded by Stable-Baselines3: {error!r:.300}") from error
    actions = "goal" if algorithm == "maskable_ppo" else "velocity"
    expected = spaces.Discrete(GOALS) if actions == "goal" else make_actions(actions).space
    if model.action_space != expected:
        raise ConfigError(f"policy: {path} was trained with the actions {model.action_space}, expected {expected}")
    return PredictingPolicy(model, actions, None, str(path))


def algorithm_of(path: Path) -> str:
    """The algorithm of a model file, from the name of its policy's class; no code is loaded for that."""
    try:
        with zipfile.ZipFile(path) as archive:
            files.check_archive(archive, MOST_UNPACKED)
            kind = str(json.loads(archive.read("data"))["policy_class"]["__module__"])
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(f"{path}: not a model file of Stable-Baselines3: {error!r}") from None
    return next((name for mark, name in MARKS.items() if kind.startswith(mark)), "ppo")
