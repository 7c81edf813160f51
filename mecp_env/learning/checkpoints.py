"""Checkpoints: all that a run needs to go on, in one file that is written whole; the last few are kept."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import Tensor

from mecp_env.core.exit_codes import complain
from mecp_env.learning import files
from mecp_env.learning.files import WeightError

FORMAT, VERSION = "mecp_env/checkpoint", 1
ENDING, SUM_ENDING = ".safetensors", ".sha256"


@dataclass(slots=True)
class Progress:
    """How far a run has come."""

    decisions: int = 0
    steps: int = 0
    episodes: int = 0
    updates: int = 0
    seconds: float = 0.0  # of training, over all resumptions
    best_score: float = -1.0  # the largest area under the curve on the validation split
    next_evaluation: int = 0  # in decisions
    evaluated: int = -1  # after so many decisions, the last time
    return_mean: float = 0.0  # the running figures by which rewards are normalised
    return_var: float = 1.0
    return_count: float = 1e-4


class Checkpoints:
    """The checkpoints in a folder."""

    def __init__(self, folder: Path, keep: int) -> None:
        self.folder, self.keep = folder, keep

    def save(self, model: OnPolicyAlgorithm, progress: Progress) -> Path:
        """Write a checkpoint, then remove the oldest ones. Raises `NotFiniteError` before anything is written."""
        files.check_finite(model.policy)
        data = files.tensor_bytes(tensors_of(model, progress))
        path = self.folder / f"{progress.decisions:012d}{ENDING}"
        files.write_whole(path.with_suffix(SUM_ENDING), files.checksum(data).encode())
        files.write_whole(path, data)
        for old in self.paths()[: -self.keep]:
            old.unlink()
            old.with_suffix(SUM_ENDING).unlink(missing_ok=True)
        return path

    def paths(self) -> list[Path]:
        """The checkpoints, the oldest first."""
        return sorted(self.folder.glob(f"[0-9]*{ENDING}"))

    def decisions(self) -> int:
        """After so many decisions the newest sound checkpoint was written; 0 where there is none."""
        for path in reversed(self.paths()):
            with suppress(WeightError, ValueError):  # damaged; a file of somebody else, whose name is no number
                read(path)
                return int(path.stem)
        return 0

    def load(self, model: OnPolicyAlgorithm) -> Progress | None:
        """Put the newest sound checkpoint into a model; None where there is no file.

        A damaged one is passed over with a line on stderr. Raises `WeightError` when none is sound.
        """
        problem: WeightError | None = None
        for path in reversed(self.paths()):
            try:
                return put(model, read(path), path)
            except WeightError as error:
                problem = error
                complain("resume", f"passed over {error}")
        if problem is not None:
            raise problem
        return None


def read(path: Path) -> dict[str, Tensor]:
    """The tensors of a checkpoint. Raises `WeightError`."""
    try:
        sha256 = path.with_suffix(SUM_ENDING).read_text().strip()
    except OSError as error:
        raise WeightError(f"{path}: its checksum cannot be read: {error.strerror}") from None
    return files.tensors_in(files.read_checked(path, sha256), path)


def tensors_of(model: OnPolicyAlgorithm, progress: Progress) -> dict[str, Tensor]:
    """Weights, the optimiser's memory, random numbers and progress, as tensors."""
    kind, keys, position, *_ = np.random.get_state(legacy=True)  # noqa: NPY002 (it is what Stable-Baselines3 draws from)
    assert kind == "MT19937"
    state = {"format": FORMAT, "version": VERSION, "numpy_position": position, "progress": asdict(progress)}
    tensors = {f"policy.{name}": tensor for name, tensor in files.weights_of(model.policy).items()}
    tensors |= {"random.torch": torch.get_rng_state(), "random.numpy": torch.from_numpy(keys.astype(np.int64))}
    for index, memory in model.policy.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": torch.as_tensor(value) for name, value in memory.items()}
    return tensors | {"state": torch.tensor(list(json.dumps(state).encode()), dtype=torch.uint8)}


def put(model: OnPolicyAlgorithm, tensors: dict[str, Tensor], path: Path) -> Progress:
    """Put a checkpoint's tensors into a model. Raises `WeightError`; the model is then to be thrown away."""
    try:
        state = json.loads(bytes(tensors["state"].tolist()))
        if (state["format"], state["version"]) != (FORMAT, VERSION):
            raise WeightError(f"{path}: {state['format']} {state['version']}, this is {FORMAT} {VERSION}")
        progress = Progress(**state["progress"])
        keys, position = tensors["random.numpy"].numpy().astype(np.uint32), state["numpy_position"]
    except (KeyError, ValueError, TypeError) as error:
        raise WeightError(f"{path}: no checkpoint of this version: {error!r}") from None
    files.put_weights(model.policy, part(tensors, "policy."), path)
    put_optimizer(model, part(tensors, "optimizer."))
    torch.set_rng_state(tensors["random.torch"])
    np.random.set_state(("MT19937", keys, position))  # noqa: NPY002
    model.num_timesteps = progress.decisions
    model._n_updates = progress.updates
    return progress


def put_optimizer(model: OnPolicyAlgorithm, tensors: dict[str, Tensor]) -> None:
    """Give the optimiser its memory back: `index.name` -> tensor."""
    optimizer = model.policy.optimizer
    memory: dict[int, dict[str, Any]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        memory.setdefault(int(index), {})[key] = tensor
    optimizer.load_state_dict(optimizer.state_dict() | {"state": memory})


def part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names begin so, without that beginning."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
