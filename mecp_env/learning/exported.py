"""Models of other libraries: Stable-Baselines3 (.zip), TorchScript (.pt) and ONNX (.onnx), as policies.

Loading a zip or TorchScript can run code, so the caller must trust it. A JSON file of the same name beside a model says
how it is used (docs/submissions.md).
"""

from __future__ import annotations

import importlib
import json
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BeforeValidator

from mecp_env.config import ObservationConfig, as_section, merge
from mecp_env.core.carriers import Bools
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.settings import Settings
from mecp_env.learning.config import WeightError, read_config
from mecp_env.learning.fits import OTHERS, Fit, ModelPolicy, batched, choices_of, fit, with_known_ground
from mecp_env.planning.config import PlanningConfig
from mecp_env.policies.registry import find_modules_here, statistics_of

MOST_BYTES, MOST_UNPACKED = 500_000_000, 1_000_000_000  # of a model file, and of the parts of a zip
ALGORITHMS = {  # the first module or setting of these that a zip names -> "module:class" of the algorithm
    "sb3_contrib.common.maskable": "sb3_contrib:MaskablePPO",
    "sb3_contrib.common.recurrent": "sb3_contrib:RecurrentPPO",
    "n_quantiles": "sb3_contrib:QRDQN",
    "top_quantiles_to_drop_per_net": "sb3_contrib:TQC",
    "delta_std_schedule": "sb3_contrib:ARS",
    "cg_max_steps": "sb3_contrib:TRPO",
    "exploration_fraction": "stable_baselines3:DQN",
    "target_noise_clip": "stable_baselines3:TD3",
    "clip_range": "stable_baselines3:PPO",
    "vf_coef": "stable_baselines3:A2C",
    "policy_delay": "sb3_contrib:CrossQ",
    "target_entropy": "stable_baselines3:SAC",
}
ANY = "stable_baselines3:PPO"
Network = Callable[[Any], Any]  # from an observation, or its parts by name, each with a first axis of 1, to the output


class NotFiniteError(MecpError):
    """Training made a weight infinite or NaN: such weights are not kept."""


class StockConfig(Settings):
    """The JSON file that may be beside a model file of Stable-Baselines3."""

    deterministic: bool = True  # the most probable action, else a draw as in training
    planning: PlanningConfig = PlanningConfig()  # fields other than those of the environment: which rows there are

    def asked_of(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Fields of an environment with those of the planning that are set here."""
        given = self.planning.model_dump(exclude_unset=True)
        return merge(settings, {"planning": given}) if given else settings


class ExportedConfig(StockConfig):
    """The JSON file beside a network."""

    observation: Annotated[ObservationConfig, BeforeValidator(lambda value: as_section("observation", value))] = (
        ObservationConfig()
    )
    actions: Literal["velocity", "discrete", "goal"]
    reward: dict[str, Any] | str = ""  # as in `EnvConfig`; "": that of the environment

    def fit(self) -> Fit:
        """The environment of these fields."""
        observation = self.observation.model_dump(include=self.observation.model_fields_set)
        settings = self.asked_of(with_known_ground(observation))
        return Fit(self.actions, settings | ({"reward": self.reward} if self.reward else {}))


Beside = TypeVar("Beside", bound=StockConfig)


def read_beside(path: Path, kind: type[Beside]) -> Beside:
    """The JSON file beside a model file. Raises `ConfigError`."""
    beside = path.with_suffix(".json")
    fields = read_config(beside)
    try:
        return kind(**fields)
    except ConfigError as error:
        raise ConfigError(f"{beside}: {error}") from None


def check_file(path: Path, danger: str = "", trust: bool = True) -> None:
    """Raise `ConfigError` for a file that is not there or too large, and for one with a `danger` without `trust`."""
    if not path.is_file():
        raise ConfigError(f"policy: {path}: no such file")
    if path.stat().st_size > MOST_BYTES:
        raise ConfigError(f"policy: {path}: {path.stat().st_size} bytes, at most {MOST_BYTES}")
    if not trust:
        raise ConfigError(f"policy: {path}: {danger}; if you trust its source, use --trust (load(path, trust=True))")


class StockModel:
    """Acts as an algorithm or policy of Stable-Baselines3 does; keeps the memory of recurrent networks.

    `prepare` makes the batch of one that it was trained on from an observation.
    """

    def __init__(self, algorithm: Any, prepare: Callable[[Any], Any] = batched, deterministic: bool = True) -> None:
        self.algorithm, self.prepare, self.deterministic = algorithm, prepare, deterministic
        self.takes_masks = "action_masks" in signature(algorithm.predict).parameters
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode; all draws in it follow from `seed`."""
        self.memory: Any = None
        self.episode_start = np.ones(1, np.bool_)
        if not self.deterministic:
            self.algorithm.set_random_seed(seed)

    def predict(self, inputs: Any, mask: Bools | None) -> Any:
        """An action of the algorithm; only MaskablePPO takes the mask."""
        masks = {"action_masks": np.asarray(mask)[None]} if self.takes_masks and mask is not None else {}
        actions, self.memory = self.algorithm.predict(
            self.prepare(inputs), self.memory, self.episode_start, deterministic=self.deterministic, **masks
        )
        self.episode_start = np.zeros(1, np.bool_)
        return actions[0]


def load_zip(path: Path, trust: bool) -> ModelPolicy:
    """The model in a file of Stable-Baselines3, with the statistics of `VecNormalize` beside it.

    Raises `ConfigError` without `trust` or a file and for spaces that no environment has, `WeightError` for a file with
    another content.
    """
    check_file(path, "loading a model file of Stable-Baselines3 can run arbitrary code", trust)
    module, name = class_of(path).split(":")
    find_modules_here()  # of the user: the class of a policy, or of its features
    try:
        algorithm = getattr(importlib.import_module(module), name).load(path, device="cpu")
        check_finite(algorithm.policy)
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{path}: cannot be loaded by Stable-Baselines3: {error!r:.300}") from error
    seen, statistics = algorithm.observation_space, statistics_of(path)
    if statistics is None and was_normalised(path, seen):
        raise ConfigError(
            f"policy: {path} was trained on observations that VecNormalize made, and its statistics are not beside it "
            f"as {path.stem}_vecnormalize.pkl; venv.save(...) writes them"
        )
    parts = {part: space.shape for part, space in seen.spaces.items()} if hasattr(seen, "spaces") else None
    found = fit(seen, algorithm.action_space, str(path), statistics is not None)
    config = read_beside(path, StockConfig) if path.with_suffix(".json").is_file() else StockConfig()
    found = replace(found, settings=config.asked_of(found.settings))
    prepare = batched if statistics is None else normalisation(statistics)
    return ModelPolicy(StockModel(algorithm, prepare, config.deterministic), found, str(path), parts)


def weights_of(policy: Any) -> dict[str, Any]:
    """The parameters of a policy by name, each once."""
    return {name: parameter.detach() for name, parameter in policy.named_parameters()}


def check_finite(policy: Any) -> None:
    """Raise `NotFiniteError` for a policy with a weight that is infinite or NaN."""
    for name, weight in weights_of(policy).items():
        if not bool(weight.isfinite().all()):
            raise NotFiniteError(f"weights: {name} is not finite any more; a smaller ppo.learning_rate?")


def check_archive(archive: zipfile.ZipFile, most_bytes: int) -> None:
    """Raise `ValueError` for an archive that unpacks to more bytes, or has a part with a wrong checksum."""
    unpacked = sum(part.file_size for part in archive.infolist())
    if unpacked > most_bytes:
        raise ValueError(f"{unpacked} bytes unpacked, at most {most_bytes}")
    if archive.testzip():
        raise ValueError("wrong checksum")


def class_of(path: Path) -> str:
    """The algorithm of a model file as "module:class", from names in its text; no code is loaded for that."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive, MOST_UNPACKED)
            data = json.loads(archive.read("data"))
        named = " ".join([str(data["policy_class"]["__module__"]), str(data.get("rollout_buffer_class")), *data])
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(
            f"{path}: not a model file of Stable-Baselines3, as model.save writes it: {error!r}"
        ) from None
    return next((found for mark, found in ALGORITHMS.items() if mark in named), ANY)


def was_normalised(path: Path, space: Any) -> bool:
    """True for the file of a model whose observations `VecNormalize` made: the last ones, saved there, left the space.

    Where only rewards were normalised, they are inside.
    """
    from stable_baselines3.common.save_util import load_from_zip_file

    saved = load_from_zip_file(path, device="cpu")[0] or {}
    last: Any = saved.get("_last_obs")
    if last is None or saved.get("_last_original_obs") is None:
        return False
    rows = zip(*last.values(), strict=True) if isinstance(last, dict) else last
    return not all(space.contains(dict(zip(last, row, strict=True)) if isinstance(last, dict) else row) for row in rows)


def normalisation(place: Path) -> Callable[[Any], Any]:
    """What makes a normalised batch with the trusted statistics of a `VecNormalize`. Raises `WeightError`."""
    try:
        found = pickle.loads(place.read_bytes())  # noqa: S301 (the caller trusts the model)
    except Exception as error:  # the file's own code may raise anything
        raise WeightError(f"{place}: cannot be loaded: {error!r:.300}") from error
    if not hasattr(found, "normalize_obs"):
        raise WeightError(f"{place}: expected the statistics of VecNormalize, got {type(found).__name__}")
    return lambda seen: found.normalize_obs(batched(seen))


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
        wrong_choice = count and output.size == 1 and output[0] not in range(count)
        if wrong_choice or not np.isfinite(output).all() or output.size not in ((1, count) if count else (2,)):
            expected = f"{count} numbers, or the number of the action" if count else "2 numbers"
            raise ConfigError(
                f"policy: {self.name} returned {output.size} numbers ({output[:3]}), expected {expected}, finite"
            )
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


def load_script(path: Path, trust: bool = False) -> ModelPolicy:
    """The network in a TorchScript file. Raises `ConfigError`, also without `trust` or the JSON file."""
    check_file(path, "TorchScript is a program, which may read and write files", trust)
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
    config = read_beside(path, ExportedConfig)
    return ModelPolicy(ExportedModel(network, config, str(path)), config.fit(), str(path))


def script_network(path: Path) -> Network:
    """The function of a trusted TorchScript file, from arrays to an array."""
    import torch

    try:
        module = torch.jit.load(str(path), map_location="cpu").eval()
    except Exception as error:  # damaged bytes may raise anything
        raise ConfigError(
            f"policy: {path}: cannot be loaded as TorchScript, which torch.jit.script(module).save writes; for weights "
            f"of torch.save, name a class that loads them ({OTHERS}): {error!r:.120}"
        ) from None

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
