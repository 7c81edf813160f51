"""Model files of Stable-Baselines3 from elsewhere: a zip with a pickle in it, which is code. Only on explicit trust."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from mecp_env.core.errors import ConfigError
from mecp_env.learning.files import WeightError
from mecp_env.learning.models import CLASSES

MOST_BYTES, MOST_UNPACKED = 256_000_000, 1_000_000_000
DATA = "data"
UNREADABLE = (KeyError, TypeError, ValueError, RecursionError, RuntimeError, NotImplementedError, EOFError, OSError)
MARKS = {"sb3_contrib.common.maskable": "maskable_ppo", "sb3_contrib.common.recurrent": "recurrent_ppo"}


class ForeignAgent:
    """A model that somebody trained with Stable-Baselines3 on this environment's own observation."""

    def __init__(self, model: OnPolicyAlgorithm, algorithm: str, name: str) -> None:
        self.model, self.name = model, name
        self.masked = algorithm == "maskable_ppo"
        self.actions = "goal" if self.masked else "velocity"
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode."""
        self.memory: Any = None
        self.begins = np.ones(1, np.bool_)

    def act(self, observation: dict[str, Any], mask: Any = None) -> Any:
        """The most probable action."""
        more = {"action_masks": mask} if self.masked else {}
        action, self.memory = self.model.predict(observation, self.memory, self.begins, deterministic=True, **more)
        self.begins = np.zeros(1, np.bool_)
        return int(action) if self.masked else np.asarray(action, np.float32)


def load_zip(path: Path, trust: bool) -> ForeignAgent:
    """The model in a file of Stable-Baselines3.

    Raises `ConfigError` without `trust` or a file, `WeightError` for a file that holds something else.
    """
    if not path.is_file():
        raise ConfigError(f"policy: {path}: no such file")
    if not trust:
        raise ConfigError(
            f"policy: {path}: a model file of Stable-Baselines3 runs code when it is loaded; if you know where it "
            "comes from, say so with --trust (load(path, trust=True))"
        )
    algorithm = algorithm_of(path)
    try:
        model = CLASSES[algorithm].load(path, device="cpu")
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{path}: cannot be loaded by Stable-Baselines3: {error!r:.300}") from error
    return ForeignAgent(model, algorithm, str(path))


def algorithm_of(path: Path) -> str:
    """Which algorithm a model file is of, by the name of its policy's class; nothing is loaded for that."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(part.file_size for part in archive.infolist()))
            kind = str(json.loads(archive.read(DATA))["policy_class"]["__module__"])
    except (zipfile.BadZipFile, zlib.error, *UNREADABLE) as error:
        raise WeightError(f"{path}: no model file of Stable-Baselines3: {error!r}") from None
    return next((name for mark, name in MARKS.items() if kind.startswith(mark)), "ppo")


def check_size(path: Path, unpacked: int) -> None:
    """Raise `WeightError` for a file that is too large, or that becomes too large."""
    if path.stat().st_size > MOST_BYTES or unpacked > MOST_UNPACKED:
        raise WeightError(f"{path}: {unpacked} bytes unpacked, at most {MOST_UNPACKED}")
