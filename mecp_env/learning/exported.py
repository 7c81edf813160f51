"""Networks as TorchScript (.pt) or ONNX (.onnx), with a JSON file beside them that names observation and actions."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ValidationError

from mecp_env.config import ObservationConfig, as_section
from mecp_env.core.carriers import Bools
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Settings, describe
from mecp_env.learning.fits import Fit, choices_of, with_known_ground
from mecp_env.learning.model_policy import ModelPolicy, batched

MOST_BYTES, MOST_JSON_BYTES = 500_000_000, 100_000  # of a network, and of the file beside it
Network = Callable[[Any], Any]  # from an observation, or its parts by name, each with a first axis of 1, to the output


class ExportedConfig(Settings):
    """The JSON file beside a network (docs/submissions.md)."""

    observation: Annotated[ObservationConfig, BeforeValidator(lambda value: as_section("observation", value))] = (
        ObservationConfig()
    )
    actions: Literal["velocity", "discrete", "goal"]
    deterministic: bool = True  # the largest of the outputs, else a draw from their softmax
    reward: dict[str, Any] | str = ""  # as in `EnvConfig`; "": that of the environment

    def fit(self) -> Fit:
        """The environment of these fields."""
        observation = self.observation.model_dump(include=self.observation.model_fields_set)
        settings = with_known_ground(observation)
        return Fit(self.actions, settings | ({"reward": self.reward} if self.reward else {}))


class ExportedModel:
    """Chooses an action from the output of a network: an action, or one number per action."""

    def __init__(self, network: Network, config: ExportedConfig, name: str) -> None:
        self.network, self.config, self.name = network, config, name
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode; all draws in it follow from `seed`."""
        self.random = np.random.default_rng(seed)

    def predict(self, inputs: Any, mask: Bools | None) -> Any:
        """An action. Raises `ConfigError` for an output of another size, or one that is not finite."""
        output, count = np.asarray(self.network(batched(inputs))).ravel(), choices_of(self.config.actions)
        check_output(output, count, self.name)
        if not count:
            return output
        return output[0] if output.size == 1 else self._chosen(output.astype(np.float64), mask)

    def _chosen(self, logits: Any, mask: Bools | None) -> int:
        if mask is not None and np.any(mask):
            logits = np.where(mask, logits, -np.inf)
        if self.config.deterministic:
            return int(logits.argmax())
        weights = np.exp(logits - logits.max())
        return int(self.random.choice(len(weights), p=weights / weights.sum()))


def check_output(output: Any, count: int, name: str) -> None:
    """Raise `ConfigError` for an output (n,) that is no choice among `count` actions; with 0, that is no velocities."""
    if not np.isfinite(output).all() or output.size not in ((1, count) if count else (2,)):
        expected = f"{count} numbers, or the number of the action" if count else "2 numbers"
        raise ConfigError(f"policy: {name} returned {output.size} numbers ({output[:3]}), expected {expected}")


def load_script(path: Path, trust: bool = False) -> ModelPolicy:
    """The network in a TorchScript file. Raises `ConfigError` without `trust`: its operations may read and write files.

    Raises `ConfigError`, too, for a file that cannot be loaded, and without the JSON file.
    """
    check_file(path)
    if not trust:
        raise ConfigError(
            f"policy: {path}: TorchScript is a program, which may read and write files; if you trust its source, "
            "use --trust (load(path, trust=True))"
        )
    return exported_policy(path, script_network(path))


def load_onnx(path: str | Path, trust: bool = False) -> ModelPolicy:
    """The network in an ONNX file, which is data and needs no `trust`.

    Raises `ConfigError`, also without onnxruntime.
    """
    check_file(Path(path))
    return exported_policy(Path(path), onnx_network(Path(path)))


def exported_policy(path: Path, network: Network) -> ModelPolicy:
    """The policy of a network with the JSON file beside it. Raises `ConfigError`."""
    beside = path.with_suffix(".json")
    if not beside.is_file():
        raise ConfigError(
            f'policy: {path}: {beside.name} is missing beside it, such as {{"observation": "flat", "actions": "goal"}}'
        )
    try:
        config = ExportedConfig.model_validate(read_fields(beside))
    except ValidationError as error:
        raise ConfigError(f"{beside}: {describe(error, 'fields', ExportedConfig)}") from None
    return ModelPolicy(ExportedModel(network, config, str(path)), config.fit(), str(path))


def read_fields(path: Path) -> dict[str, Any]:
    """The fields in a small JSON file. Raises `ConfigError` for another content."""
    if path.stat().st_size > MOST_JSON_BYTES:
        raise ConfigError(f"{path}: more than {MOST_JSON_BYTES} bytes, no description of a network")
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None
    if not isinstance(fields, dict):
        raise ConfigError(f"{path}: expected an object of fields, found {type(fields).__name__}")
    return fields


def check_file(path: Path) -> None:
    """Raise `ConfigError` for a file that is not there, or too large."""
    if not path.is_file():
        raise ConfigError(f"policy: {path}: no such file")
    if path.stat().st_size > MOST_BYTES:
        raise ConfigError(f"policy: {path}: {path.stat().st_size} bytes, at most {MOST_BYTES}")


def script_network(path: Path) -> Network:
    """The function of a trusted TorchScript file, from arrays to an array."""
    import torch

    try:
        module = torch.jit.load(str(path), map_location="cpu").eval()
    except Exception as error:  # damaged bytes may raise anything
        raise ConfigError(f"policy: {path}: cannot be loaded as TorchScript: {error!r:.200}") from None

    def run(batch: Any) -> Any:
        arrays = batch if isinstance(batch, dict) else {"": batch}
        tensors = {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in arrays.items()}
        with torch.no_grad():
            return module(tensors if isinstance(batch, dict) else tensors[""]).numpy()

    return run


def onnx_network(path: Path) -> Network:
    """The function of an ONNX file, from arrays to its first output; parts of an observation are inputs by name."""
    try:
        onnxruntime = importlib.import_module("onnxruntime")
    except ModuleNotFoundError:
        raise ConfigError(f"policy: {path} needs onnxruntime: pip install onnxruntime") from None
    try:
        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:  # damaged bytes may raise anything
        raise ConfigError(f"policy: {path}: cannot be loaded as ONNX: {error!r:.200}") from None
    names = [found.name for found in session.get_inputs()]

    def run(batch: Any) -> Any:
        inputs = {name: batch[name] for name in names} if isinstance(batch, dict) else {names[0]: batch}
        return session.run(None, inputs)[0]

    return run
