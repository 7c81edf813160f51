"""Files that are complete or absent, with checksums; weights as tensors only, never as code.

Checkpoints: everything that a run needs to continue, as Stable-Baselines3 saves it. Loading one runs no code.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
from pydantic import BaseModel, ConfigDict
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file
from torch import Tensor, nn

from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.files import write_atomic

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

MOST_POLICY_BYTES = 16_000_000  # of the weights of a policy; `mecp_env.learning.learned` loads no larger file


class WeightError(ConfigError):
    """A file of weights is damaged, too large, modified, or of another network."""


class NotFiniteError(MecpError):
    """Training made a weight infinite or NaN: such weights are not kept."""


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, atomically."""
    write_atomic(path, (json.dumps(value, indent=2) + "\n").encode())


def lock(path: Path) -> Any:
    """Hold a file for this process, until the returned object is closed or the process has ended, killed or not.

    Raises `BlockingIOError` when another process holds it. Without such locks on a system it holds nothing. (`flock`
    locks would be inherited by forked workers, which outlive a killed process for a while.)
    """
    file = path.open("a", encoding="utf-8")
    if fcntl is None:
        return file
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        if error.errno in (errno.EACCES, errno.EAGAIN):
            raise BlockingIOError(*error.args) from None
        raise
    return file


def checksum(data: bytes) -> str:
    """SHA-256 of some bytes, as text."""
    return hashlib.sha256(data).hexdigest()


def read_tensors(path: Path, sha256: str, most_bytes: int) -> dict[str, Tensor]:
    """The tensors in a file. Raises `WeightError` when it is missing, too large, or has another checksum or format."""
    try:
        size = path.stat().st_size
        if size > most_bytes:
            raise WeightError(f"{path}: {size} bytes, at most {most_bytes}")
        data = path.read_bytes()
    except OSError as error:
        raise WeightError(f"{path}: {error.strerror}") from None
    if checksum(data) != sha256:
        raise WeightError(f"{path}: its SHA-256 is {checksum(data)}, expected {sha256}: damaged or modified")
    try:
        tensors: dict[str, Tensor] = safetensors.torch.load(data)
    except (safetensors.SafetensorError, ValueError, KeyError) as error:
        raise WeightError(f"{path}: not a safetensors file: {error}") from None
    return tensors


def check_archive(archive: zipfile.ZipFile, most_bytes: int) -> None:
    """Raise `ValueError` for an archive that unpacks to more bytes, or has a part with a wrong checksum."""
    unpacked = sum(part.file_size for part in archive.infolist())
    if unpacked > most_bytes:
        raise ValueError(f"{unpacked} bytes unpacked, at most {most_bytes}")
    if archive.testzip():
        raise ValueError("wrong checksum")


def tensor_bytes(tensors: dict[str, Tensor]) -> bytes:
    """A safetensors file of some tensors."""
    plain = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    return bytes(safetensors.torch.save(plain))


def weights_of(policy: nn.Module) -> dict[str, Tensor]:
    """The parameters of a policy by name, each once."""
    return {name: parameter.detach() for name, parameter in policy.named_parameters()}


def check_finite(policy: nn.Module) -> None:
    """Raise `NotFiniteError` for a policy with a weight that is infinite or NaN."""
    for name, weight in weights_of(policy).items():
        if not bool(weight.isfinite().all()):
            raise NotFiniteError(f"weights: {name} is not finite any more; a smaller ppo.learning_rate?")


def put_weights(policy: nn.Module, weights: dict[str, Tensor], path: Path) -> None:
    """Give a policy its weights. Raises `WeightError` unless names, shapes and types are those of its parameters."""
    mine = weights_of(policy)
    for what, names in (("without", set(mine) - set(weights)), ("with unknown", set(weights) - set(mine))):
        if names:
            raise WeightError(f"{path}: of another architecture, {what} {min(names)!r} (and {len(names) - 1} more)")
    for name, parameter in mine.items():
        given = weights[name]
        if given.shape != parameter.shape or given.dtype != parameter.dtype:
            found, expected = describe_tensor(given), describe_tensor(parameter)
            raise WeightError(f"{path}: of another architecture, {name} is {found}, expected {expected}")
        if not bool(given.isfinite().all()):
            raise WeightError(f"{path}: {name} is not finite")
    for name, parameter in mine.items():
        parameter.copy_(weights[name])


def describe_tensor(tensor: Tensor) -> str:
    """Shape and type of a tensor."""
    return f"{tuple(tensor.shape)} {str(tensor.dtype).removeprefix('torch.')}"


MOST_BYTES = 4 * MOST_POLICY_BYTES  # such weights, the two moments of Adam, and the rest
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
        check_finite(model.policy)
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
            check_archive(archive, MOST_BYTES)
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
            raise ValueError(f"optimizer: {name} is {describe_tensor(moment)} for {tuple(parameter.shape)}")
