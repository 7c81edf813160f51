"""Trained policies: `load("maskable_ppo")`, or the folder of a run. Loading one runs no code.

A policy is built from its configuration and then receives its weights, which are tensors and nothing else. A model
file of Stable-Baselines3 (a zip with a pickle) is code: it is refused unless the caller trusts it.

Weights are kept as safetensors, tensors only, with checksums; the files are complete or absent.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.core.files import read_bytes, write_atomic
from mecp_env.core.settings import guess
from mecp_env.learning.config import ALGORITHMS, CONFIG, TrainConfig, WeightError, read_config
from mecp_env.learning.encoder import make_network
from mecp_env.learning.exported import NotFiniteError, StockModel, check_finite, load_script, load_zip, weights_of
from mecp_env.learning.fits import OTHERS, Fit, ModelPolicy, batched, downsample
from mecp_env.policies import active
from mecp_env.policies.registry import WEIGHTS, shipped

FILE_NAME = re.compile(r"[\w.-]{1,100}\.safetensors", re.ASCII)
EXPECTED = (
    "a run folder, or a model file (.zip of Stable-Baselines3, .pt of TorchScript, .onnx) expected; "
    f"a class loads others ({OTHERS})"
)
MOST_BYTES = 300_000_000  # of weights: more than the largest network of a configuration has
POLICY = "policy.json"  # of a run folder: names the file of the weights, with its checksum
NAME_LENGTH = 12  # of the checksum in the name of a file of weights


class LearnedPolicy(ModelPolicy):
    """Takes the most probable action of a network of ours, as a function of the observation alone."""

    def __init__(self, network: Any, config: TrainConfig, name: str) -> None:
        self.network, self.config = network, config
        fit = Fit(config.actions, dict(active.SETTINGS) if config.env.observation.uncertainty else {})
        goals = config.actions == "goal"
        super().__init__(StockModel(network, lambda seen: batched(downsample(seen, goals))), fit, name)


def load(name_or_folder: str | Path, trust: bool = False) -> ModelPolicy:
    """The policy of that name from `mecp_env/learning/weights`, or that of a run folder.

    With `trust` also the model file of Stable-Baselines3 (.zip) or TorchScript (.pt) at that path, which may run
    arbitrary code.
    From then on PyTorch computes in one thread: one observation is too small for more, and the bits stay the same.
    Raises `ConfigError` for a wrong name or configuration, `WeightError` for weights that are damaged, too large, have
    another checksum, or belong to another network.
    """
    path = Path(name_or_folder)
    torch.set_num_threads(1)
    if path.is_file() or path.suffix in (".pt", ".zip", ".safetensors"):
        return load_file(path, trust)
    folder = WEIGHTS / path if str(path) in ALGORITHMS else path
    if not folder.is_dir():
        known = shipped()
        raise ConfigError(f"policy: {path}, expected one of {', '.join(known)}, or a run folder{guess(path, known)}")
    if not (folder / CONFIG).exists():
        raise ConfigError(f"policy: {path} is a folder without {CONFIG}, so no run of mecp-env train; {EXPECTED}")
    config = TrainConfig.build(read_config(folder / CONFIG))
    network = make_network(config)
    put_weights(network, weights_file(folder, config))
    return LearnedPolicy(network, config, str(path))


def load_file(path: Path, trust: bool) -> ModelPolicy:
    """The policy in a model file of another library. Raises `ConfigError` for another kind of file."""
    if path.suffix == ".safetensors":
        raise ConfigError(f"policy: {path} is the weights alone, name the folder that contains them")
    parts: list[str] = []
    with suppress(Exception), zipfile.ZipFile(path) as archive:  # damaged bytes may raise anything
        parts = archive.namelist()
    script = path.suffix in (".pt", ".pth") or any(part.endswith("/constants.pkl") for part in parts)
    if script and "data" not in parts:
        return load_script(path, trust)
    if path.suffix == ".zip" or parts:
        return load_zip(path, trust)
    raise ConfigError(f"policy: {path} is no trained policy; {EXPECTED}")


def weights_file(folder: Path, config: TrainConfig) -> Path:
    """The file of the weights that `policy.json` of a folder names, with that checksum. Raises `WeightError`."""
    if not (folder / POLICY).exists():
        raise WeightError(f"{folder}: no policy yet ({POLICY} is missing)")
    about = read_config(folder / POLICY)
    algorithm, name, expected = (about.get(field) for field in ("algorithm", "file", "sha256"))
    if algorithm != config.algorithm:
        raise WeightError(f"{folder / POLICY}: weights of {algorithm!r:.80}, {CONFIG} is of {config.algorithm}")
    if not isinstance(name, str) or not FILE_NAME.fullmatch(name):
        raise WeightError(f"{folder / POLICY}: expected the name of a file in this folder and its SHA-256")
    path = folder / name
    try:
        found = checksum(read_bytes(path, MOST_BYTES))
    except LayoutError as error:
        raise WeightError(f"{path}: {error}") from None
    if found != expected:
        raise WeightError(f"{path}: its SHA-256 is {found}, expected {expected}: damaged or modified")
    return path


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, atomically."""
    write_atomic(path, (json.dumps(value, indent=2) + "\n").encode())


def checksum(data: bytes) -> str:
    """SHA-256 of some bytes, as text."""
    return hashlib.sha256(data).hexdigest()


def tensor_bytes(tensors: Mapping[str, Tensor]) -> bytes:
    """A safetensors file of some tensors."""
    plain = {name: tensor.detach().contiguous().clone() for name, tensor in tensors.items()}
    return bytes(safetensors.torch.save(plain))


def put_weights(policy: nn.Module, path: Path) -> None:
    """Give a policy the weights in a file. Raises `WeightError` for another format or architecture, and for NaN."""
    try:
        safetensors.torch.load_model(policy, path)
        check_finite(policy)
    except safetensors.SafetensorError as error:
        raise WeightError(f"{path}: not a safetensors file: {error}") from None
    except RuntimeError as error:
        raise WeightError(f"{path}: of another architecture: {' '.join(str(error).split()):.300}") from None
    except NotFiniteError as error:
        raise WeightError(f"{path}: {error}") from None


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
