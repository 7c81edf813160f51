"""Weights of policies as safetensors: tensors only, never code; files with checksums, complete or absent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor, nn

from mecp_env.core.errors import MecpError
from mecp_env.core.files import write_atomic
from mecp_env.learning.config import WeightError

MOST_POLICY_BYTES = 16_000_000  # of the weights of a policy
POLICY = "policy.json"  # of a run folder: names the file of the weights, with its checksum
NAME_LENGTH = 12  # of the checksum in the name of a file of weights


class NotFiniteError(MecpError):
    """Training made a weight infinite or NaN: such weights are not kept."""


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, atomically."""
    write_atomic(path, (json.dumps(value, indent=2) + "\n").encode())


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


def weights_of(policy: nn.Module) -> dict[str, Tensor]:
    """The parameters of a policy by name, each once."""
    return {name: parameter.detach() for name, parameter in policy.named_parameters()}


def tensor_bytes(tensors: Mapping[str, Tensor]) -> bytes:
    """A safetensors file of some tensors."""
    plain = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    return bytes(safetensors.torch.save(plain))


def check_finite(policy: nn.Module) -> None:
    """Raise `NotFiniteError` for a policy with a weight that is infinite or NaN."""
    for name, weight in weights_of(policy).items():
        if not bool(weight.isfinite().all()):
            raise NotFiniteError(f"weights: {name} is not finite any more; a smaller ppo.learning_rate?")


def put_weights(policy: nn.Module, weights: dict[str, Tensor], path: Path) -> None:
    """Give a policy its weights. Raises `WeightError` unless names, shapes and types are those of its parameters."""
    mine = weights_of(policy)
    found, expected = (
        {name: f"{tuple(tensor.shape)} {tensor.dtype}" for name, tensor in tensors.items()}
        for tensors in (weights, mine)
    )
    wrong = sorted(name for name in found | expected if found.get(name) != expected.get(name))
    if wrong:
        difference = f"{wrong[0]} is {found.get(wrong[0], 'missing')}, expected {expected.get(wrong[0], 'none')}"
        raise WeightError(f"{path}: of another architecture, {difference} (and {len(wrong) - 1} more)")
    for name, given in weights.items():
        if not bool(given.isfinite().all()):
            raise WeightError(f"{path}: {name} is not finite")
    for name, parameter in mine.items():
        parameter.copy_(weights[name])


def save_policy(folder: Path, policy: nn.Module, algorithm: str, facts: Mapping[str, Any]) -> None:
    """Write weights, then `policy.json`, which names them with their checksum, then remove older ones.

    Raises `NotFiniteError`; the previous weights then stay.
    """
    check_finite(policy)
    data = tensor_bytes(weights_of(policy))
    sha256 = checksum(data)
    name = f"policy-{sha256[:NAME_LENGTH]}.safetensors"
    write_atomic(folder / name, data)
    write_json(folder / POLICY, {"algorithm": algorithm, "file": name, "sha256": sha256, "bytes": len(data), **facts})
    for old in folder.glob("policy-*.safetensors"):
        if old.name != name:
            old.unlink()
