"""Files that are complete or absent, with checksums; weights as tensors only, never as code."""

from __future__ import annotations

import errno
import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor, nn

from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.paths import write_atomic

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
