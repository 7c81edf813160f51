"""Model files of Stable-Baselines3: a zip with a pickle, which is code. Loaded only with explicit trust."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path

from mecp_env.core.errors import ConfigError
from mecp_env.learning.files import WeightError
from mecp_env.learning.models import CLASSES
from mecp_env.learning.predicting import PredictingPolicy

MOST_BYTES, MOST_UNPACKED = 256_000_000, 1_000_000_000
UNREADABLE = (KeyError, TypeError, ValueError, RecursionError, RuntimeError, NotImplementedError, EOFError, OSError)
MARKS = {"sb3_contrib.common.maskable": "maskable_ppo", "sb3_contrib.common.recurrent": "recurrent_ppo"}


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
    return PredictingPolicy(model, "goal" if algorithm == "maskable_ppo" else "velocity", None, str(path))


def check_size(path: Path, unpacked: int) -> None:
    """Raise `WeightError` for a file that is too large, or becomes too large."""
    if path.stat().st_size > MOST_BYTES or unpacked > MOST_UNPACKED:
        raise WeightError(f"{path}: {unpacked} bytes unpacked, at most {MOST_UNPACKED}")


def algorithm_of(path: Path) -> str:
    """The algorithm of a model file, from the name of its policy's class; no code is loaded for that."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_size(path, sum(part.file_size for part in archive.infolist()))
            kind = str(json.loads(archive.read("data"))["policy_class"]["__module__"])
    except WeightError:
        raise
    except (zipfile.BadZipFile, zlib.error, *UNREADABLE) as error:
        raise WeightError(f"{path}: not a model file of Stable-Baselines3: {error!r}") from None
    return next((name for mark, name in MARKS.items() if kind.startswith(mark)), "ppo")
