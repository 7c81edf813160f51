"""Checkpoints: everything that a run needs to continue, as Stable-Baselines3 saves it. Loading one runs no code."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file

from mecp_env.core.paths import write_atomic
from mecp_env.learning import files
from mecp_env.learning.files import WeightError

MOST_BYTES = 4 * files.MOST_POLICY_BYTES  # such weights, the two moments of Adam, and the rest
NUMPY_KEYS = 624  # of the Mersenne Twister

Parts = dict[str, Any]  # `policy` and `policy.optimizer` of Stable-Baselines3, `state` and `random` of the run


class TrainingState(BaseModel):
    """The counters of a run."""

    model_config = ConfigDict(extra="forbid", strict=True)  # checked when a checkpoint is read

    decisions: int = 0
    periods: int = 0  # control steps
    episodes: int = 0
    updates: int = 0  # rollouts that the policy learned from
    seconds: float = 0.0  # of training, over all resumptions
    best_score: float = -1.0  # the largest area under the curve on the validation split
    next_evaluation: int = 0  # in decisions
    evaluated: int = -1  # decisions at the last evaluation
    return_mean: float = 0.0  # running statistics by which rewards are normalised
    return_var: float = 1.0
    return_count: float = 1e-4


class Checkpoints:
    """The checkpoints in a folder: `DECISIONS.zip`."""

    def __init__(self, folder: Path, keep: int) -> None:
        self.folder, self.keep = folder, keep

    def save(self, model: OnPolicyAlgorithm, state: TrainingState) -> Path:
        """Write a checkpoint, then remove the oldest ones. Raises `NotFiniteError` before anything is written."""
        files.check_finite(model.policy)
        path = self.folder / f"{state.decisions:012d}.zip"
        write_checkpoint(path, model.get_parameters() | {"state": state.model_dump(), "random": random_state()})
        for old in self.paths()[: -self.keep]:
            old.unlink()
        return path

    def paths(self) -> list[Path]:
        """The checkpoints, the oldest first."""
        return sorted(path for path in self.folder.glob("*.zip") if path.stem.isdecimal())

    def decisions(self) -> int:
        """The decisions of the newest valid checkpoint; 0 without one."""
        for path in reversed(self.paths()):
            try:
                read_checkpoint(path)
                return int(path.stem)
            except WeightError:
                continue
        return 0

    def load(self, model: OnPolicyAlgorithm, report: Callable[[str], None]) -> TrainingState | None:
        """Restore the newest valid checkpoint into a model; None without a file.

        Damaged ones are skipped, and reported. Raises `WeightError` when none is valid.
        """
        problem: WeightError | None = None
        for path in reversed(self.paths()):
            try:
                return restore(model, read_checkpoint(path), path)
            except WeightError as error:
                problem = error
                report(f"skipped {error}")
        if any(self.folder.glob("*.safetensors")):
            problem = problem or WeightError(
                f"{self.folder}: checkpoints of an older version, which cannot be continued"
            )
        if problem is not None:
            raise problem
        return None


def write_checkpoint(path: Path, parts: Parts) -> None:
    """Write the parts of a checkpoint as one file, atomically."""
    buffer = io.BytesIO()
    save_to_zip_file(buffer, params=parts)
    write_atomic(path, buffer.getvalue())


def read_checkpoint(path: Path) -> Parts:
    """The parts of a checkpoint: tensors and plain data, no code. Raises `WeightError`."""
    try:
        with zipfile.ZipFile(path) as archive:
            files.check_archive(archive, MOST_BYTES)
        parts: Parts = load_from_zip_file(path, device="cpu", load_data=False)[1]
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(f"{path}: damaged, or not a checkpoint: {error!r:.300}") from None
    return parts


def random_state() -> Parts:
    """The states of the generators from which Stable-Baselines3 draws: PyTorch's and NumPy's global ones."""
    generator: Any = np.random.get_state(legacy=True)  # noqa: NPY002
    keys = torch.from_numpy(generator[1].astype(np.int64))
    return {"torch": torch.get_rng_state(), "numpy": keys, "position": generator[2]}


def restore(model: OnPolicyAlgorithm, parts: Parts, path: Path) -> TrainingState:
    """Put a checkpoint into a model. Raises `WeightError`; the model must not be used then."""
    try:
        state = TrainingState(**parts.pop("state"))
        random = parts.pop("random")
        keys, position = random["numpy"].numpy().astype(np.uint32), random["position"]
        if not (keys.shape == (NUMPY_KEYS,) and 0 <= position <= NUMPY_KEYS):
            raise ValueError(f"position: {position!r:.20}, expected 0 to {NUMPY_KEYS}, with {NUMPY_KEYS} keys")
        model.set_parameters(parts, exact_match=True, device="cpu")
        check_moments(model)
        torch.set_rng_state(random["torch"])
        np.random.set_state(("MT19937", keys, position, 0, 0.0))  # noqa: NPY002
    except (LookupError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise WeightError(f"{path}: not a checkpoint of this version: {' '.join(str(error).split()):.300}") from None
    model.num_timesteps = state.decisions
    return state


def check_moments(model: OnPolicyAlgorithm) -> None:
    """Raise `ValueError` for moments of the optimiser that have another shape than their parameter."""
    state = model.policy.optimizer.state
    for parameter, name, moment in [(p, name, moment) for p in state for name, moment in state[p].items()]:
        if moment.shape not in ((), parameter.shape):
            raise ValueError(f"optimizer: {name} is {files.describe_tensor(moment)} for {tuple(parameter.shape)}")
