"""Checkpoints: everything that a run needs to continue, as tensors and JSON; loading one runs no code."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ConfigDict, TypeAdapter, ValidationError
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import Tensor

from mecp_env.core.paths import write_atomic
from mecp_env.learning import files
from mecp_env.learning.files import WeightError

VERSION = 2


@dataclass(slots=True)
class TrainingState:
    """The counters of a run."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # checked when a checkpoint is read

    decisions: int = 0
    periods: int = 0  # control steps
    episodes: int = 0
    updates: int = 0
    seconds: float = 0.0  # of training, over all resumptions
    best_score: float = -1.0  # the largest area under the curve on the validation split
    next_evaluation: int = 0  # in decisions
    evaluated: int = -1  # decisions at the last evaluation
    return_mean: float = 0.0  # running statistics by which rewards are normalised
    return_var: float = 1.0
    return_count: float = 1e-4


class Checkpoints:
    """The checkpoints in a folder: `DECISIONS.safetensors`, and `DECISIONS.json`, which is written last."""

    def __init__(self, folder: Path, keep: int) -> None:
        self.folder, self.keep = folder, keep

    def save(self, model: OnPolicyAlgorithm, state: TrainingState) -> Path:
        """Write a checkpoint, then remove the oldest ones. Raises `NotFiniteError` before anything is written."""
        files.check_finite(model.policy)
        data = files.tensor_bytes(tensors_of(model))
        path = self.folder / f"{state.decisions:012d}.json"
        position = random_state()[2]
        about = {"version": VERSION, "sha256": files.checksum(data), "numpy_position": position, "state": asdict(state)}
        write_atomic(path.with_suffix(".safetensors"), data)
        files.write_json(path, about)
        for old in self.paths()[: -self.keep]:
            old.unlink()
            old.with_suffix(".safetensors").unlink(missing_ok=True)
        return path

    def paths(self) -> list[Path]:
        """The checkpoints, the oldest first."""
        return sorted(path for path in self.folder.glob("*.json") if path.stem.isdecimal())

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
                return restore(model, *read_checkpoint(path), path)
            except WeightError as error:
                problem = error
                report(f"skipped {error}")
        if problem is not None:
            raise problem
        return None


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The JSON part and the tensors of a checkpoint. Raises `WeightError`."""
    try:
        about = json.loads(path.read_bytes()[: files.MOST_BYTES])
        if about["version"] != VERSION:
            raise WeightError(f"{path}: checkpoint version {about['version']!r:.20}, expected {VERSION}")
        return about, files.read_tensors(path.with_suffix(".safetensors"), about["sha256"])
    except OSError as error:
        raise WeightError(f"{path}: {error.strerror}") from None
    except (KeyError, TypeError, RecursionError) as error:
        raise WeightError(f"{path}: not a checkpoint: {error!r}") from None
    except json.JSONDecodeError as error:
        raise WeightError(f"{path}: not JSON: {error}") from None


def tensors_of(model: OnPolicyAlgorithm) -> dict[str, Tensor]:
    """Weights, the optimiser's moments, and the states of the random generators."""
    keys = random_state()[1]
    tensors = {f"policy.{name}": tensor for name, tensor in files.weights_of(model.policy).items()}
    tensors |= {"random.torch": torch.get_rng_state(), "random.numpy": torch.from_numpy(keys.astype(np.int64))}
    for index, moments in model.policy.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    return tensors


def random_state() -> Any:
    """The state of NumPy's global generator, from which Stable-Baselines3 draws."""
    return np.random.get_state(legacy=True)  # noqa: NPY002


def restore(model: OnPolicyAlgorithm, about: dict[str, Any], tensors: dict[str, Tensor], path: Path) -> TrainingState:
    """Put a checkpoint into a model. Raises `WeightError`; the model must not be used then."""
    try:
        state = TypeAdapter(TrainingState).validate_json(json.dumps(about["state"]), strict=True)
        keys, position = tensors["random.numpy"].numpy().astype(np.uint32), about["numpy_position"]
        if not (keys.shape == (624,) and 0 <= position <= 624):
            raise ValueError(f"numpy_position: {position!r:.20}, expected 0 to 624, with 624 keys")
        files.put_weights(model.policy, part(tensors, "policy."), path)
        put_moments(model, part(tensors, "optimizer."))
        torch.set_rng_state(tensors["random.torch"])
        np.random.set_state(("MT19937", keys, position, 0, 0.0))  # noqa: NPY002
    except WeightError:
        raise
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, ("state", *first["loc"])))
        raise WeightError(f"{path}: {field}: {first['msg']}") from None
    except (LookupError, ValueError, TypeError, RuntimeError) as error:
        raise WeightError(f"{path}: not a checkpoint of this version: {error!r}") from None
    model.num_timesteps, model._n_updates = state.decisions, state.updates
    return state


def put_moments(model: OnPolicyAlgorithm, tensors: dict[str, Tensor]) -> None:
    """Restore the moments of the optimiser: `index.name` -> tensor."""
    optimizer = model.policy.optimizer
    parameters = optimizer.param_groups[0]["params"]
    moments: dict[int, dict[str, Any]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        if tensor.shape not in ((), parameters[int(index)].shape):
            raise ValueError(f"optimizer.{name} is {files.describe_tensor(tensor)}")
        moments.setdefault(int(index), {})[key] = tensor
    optimizer.load_state_dict(optimizer.state_dict() | {"state": moments})


def part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names start with the prefix, without it."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
