"""The configuration of a training run: one tree, frozen, validated, unknown names refused, JSON both ways."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import tyro
from pydantic import BeforeValidator, Field, create_model, field_validator, model_validator
from tyro.constructors import PrimitiveConstructorSpec

from mecp_env.config import EnvConfig, merge
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import read_json
from mecp_env.core.settings import Settings, as_many, guess, shown
from mecp_env.episode.tasks import task_fields
from mecp_env.world.config import GeneratorSpec

Algorithm = Literal["ppo", "maskable_ppo", "recurrent_ppo"]
ALGORITHMS = get_args(Algorithm)
CONFIG, MOST_CONFIG_BYTES = "config.json", 1_000_000  # the name in a run folder
SPEC = GeneratorSpec.model_fields
WORDS = {*SPEC["shapes"].default, *SPEC["pieces"].default}  # possible values of the fields with words
FIELDS: dict[str, Any] = {name: (field.annotation, field) for name, field in SPEC.items()}
_BuildingFields = create_model("_BuildingFields", __base__=Settings, **FIELDS)
DERIVED = {
    "layout": "a run has it from its buildings; say buildings.layout (--buildings.layout)",
    "actions": "follows from the algorithm: maskable_ppo chooses goals, ppo and recurrent_ppo velocities",
}


def read_line(words: Sequence[str]) -> dict[str, Any]:
    """`rooms 12 door_width_m 0.7 0.9 shapes L T` of a command line as fields; a word that cannot be a value is a name.

    Raises `ValueError` for a name without a value, and a value without a name.
    """
    fields: dict[str, list[float | str]] = {}
    for word in words:
        values = next(reversed(fields.values()), None)  # of the last name
        value = _as_value(word, expected=values == [])
        if value is None:
            fields[word.replace("-", "_")] = []
        elif values is None:
            raise ValueError(f"{word}: the name of a field comes first, as rooms 12")
        else:
            values.append(value)
    if missing := [name for name, values in fields.items() if not values]:
        raise ValueError(f"{missing[0]}: a value is missing, as rooms 12")
    return {name: found[0] if len(found) == 1 else tuple(found) for name, found in fields.items()}


def _as_value(word: str, expected: bool) -> float | str | None:
    """A word of the line as a value; None for a name, which is any other word where no value is expected."""
    if word in WORDS:
        return word
    try:
        return float(word)
    except ValueError:
        return word if expected and word.replace("-", "_") not in SPEC else None


def as_words(spec: Mapping[str, Any]) -> list[str]:
    """The fields as on a command line."""
    values = {name: value if isinstance(value, tuple | list) else (value,) for name, value in spec.items()}
    return [word for name, found in values.items() for word in (name, *map(str, found))]


OPTION: PrimitiveConstructorSpec[dict[str, Any]] = PrimitiveConstructorSpec(
    nargs="*",
    metavar="[FIELD VALUE ...]",
    instance_from_str=read_line,
    is_instance=lambda value: isinstance(value, dict),
    str_from_instance=as_words,
)


class WeightError(ConfigError):
    """A file of weights is damaged, too large, modified, or of another network."""


class Environment(EnvConfig):
    """The environment, as `gymnasium.make` takes it; the actions follow from the algorithm."""

    layout: Annotated[str, tyro.conf.Suppress] = "two_rooms"
    actions: Annotated[Literal["velocity", "discrete", "goal"], tyro.conf.Suppress] = "velocity"
    start: Literal["layout", "random"] = "random"


class BuildingsConfig(Settings):
    """Where the robot learns: another generated building at every reset, or always the same layout."""

    # distributed over the environments
    difficulty: Annotated[tuple[str, ...], Field(min_length=1), BeforeValidator(as_many)] = ("medium",)
    split: Literal["train", "validation", "test"] = "train"
    # fields of `GeneratorSpec` over the difficulty's own: rooms 12 door_width_m 0.7 0.9 shapes L T
    spec: Annotated[dict[str, Any], OPTION] = Field({})
    layout: str | None = None  # a shipped layout or a file, in place of generated buildings

    @field_validator("spec")
    @classmethod
    def _fields_of_a_building(cls, spec: dict[str, Any]) -> dict[str, Any]:
        """The values as `GeneratorSpec` has them; whether they fit each other depends on the difficulty."""
        made = _BuildingFields(**spec)
        return {name: getattr(made, name) for name in spec}

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.layout is not None and self.spec:
            raise ValueError(f"spec: {shown(self.spec)}, but layout: {shown(self.layout)} is one building; choose one")
        return self


class NetworkConfig(Settings):
    """Sizes of the network (docs/training.md has the picture)."""

    width: int = Field(64, ge=4, le=1024)  # of the code of a goal and of the context
    grid_channels: int = Field(16, ge=2, le=256)  # of the convolutions
    attention: bool = True  # between goals, before they are scored
    # the explorer that the untrained policy imitates; returning and stachniss in a task
    prior: Literal["gain", "nearest", "returning", "stachniss", "none"] = "gain"
    sharpness: float = Field(5.0, ge=0.0, le=100.0)  # of the logits of that explorer
    lstm: int = Field(128, ge=4, le=1024)  # recurrent_ppo
    uncertainty: bool = True  # no: it sees no covariance, prediction or confidence, to measure what they are worth


class PpoConfig(Settings):
    """Hyper-parameters of PPO; a decision is an option (the drive to a goal) or, with velocities, a control step."""

    steps: int = Field(32, ge=2, le=100_000)  # decisions per environment and update
    batch: int = Field(128, ge=2, le=1_000_000)  # decisions per gradient step
    epochs: int = Field(10, ge=1, le=100)
    learning_rate: float = Field(1.5e-3, gt=0.0, le=1.0)
    anneal: bool = True  # the learning rate falls linearly to 0
    gae_lambda: float = Field(0.95, ge=0.0, le=1.0)
    discount: float = Field(1.0, gt=0.0, le=1.0)  # per decision
    discount_m: float = Field(60.0, gt=0.0, le=1e6)  # goals: a reward that many metres later counts 1/e
    clip: float = Field(0.2, gt=0.0, le=1.0)
    entropy: float = Field(0.0, ge=0.0, le=1.0)
    value: float = Field(0.5, ge=0.0, le=10.0)
    gradient_norm: float = Field(0.5, gt=0.0, le=100.0)
    target_kl: float | None = Field(0.03, gt=0.0, le=10.0)  # an update stops early beyond it
    normalise_reward: bool = True  # by the running deviation of the discounted return


class LogConfig(Settings):
    """Evaluations and files."""

    evaluate_every: int = Field(10_000, ge=1)  # decisions
    evaluate_buildings: int = Field(20, ge=0, le=1000)  # of the validation split; 0: no evaluation
    checkpoint_s: float = Field(60.0, ge=0.0, le=86_400.0)  # at most so much training is lost
    keep: int = Field(3, ge=1, le=1000)  # checkpoints
    tensorboard: bool = True


class TrainConfig(Settings):
    """The complete configuration of a training run."""

    algorithm: Annotated[Algorithm, tyro.conf.Suppress] = "maskable_ppo"
    task: str = ""  # of active SLAM, as ActiveHalls-v0: its buildings, robot, observation and reward, if not overridden
    steps: int = Field(100_000, ge=1, le=10**10)  # decisions (ppo, recurrent_ppo: control steps), of all together
    seed: int = Field(0, ge=0, lt=2**31)
    environments: int = Field(16, ge=1, le=1024)
    workers: Literal["batch", "processes", "here"] = "batch"  # few processes; one per environment; none
    buildings: BuildingsConfig = BuildingsConfig()
    env: Environment = Environment()
    network: NetworkConfig = NetworkConfig()
    ppo: PpoConfig = PpoConfig()
    log: LogConfig = LogConfig()

    @classmethod
    def build(cls, fields: Mapping[str, Any]) -> Self:
        """The configuration with `fields` over the defaults of their algorithm.

        Raises `ConfigError` for an unknown name at any level (with the nearest known one), a wrong value, or a field of
        the environment that follows from another one here.
        """
        refuse_derived(fields.get("env"))
        algorithm = check_algorithm(fields.get("algorithm", "maskable_ppo"))
        task = of_task(fields.get("task", ""))
        merged = merge(merge(DEFAULTS[algorithm], task), dict(fields))
        config = cls(**merged | {"algorithm": algorithm})
        check_batches(config)
        check_prior(config)
        check_observation(config)
        return config

    @property
    def actions(self) -> str:
        """The action mode that the algorithm needs."""
        return "goal" if self.algorithm == "maskable_ppo" else "velocity"

    @property
    def score(self) -> str:
        """The metric by which the best policy of a run is chosen."""
        return "correct_over_steps" if self.task else "auc"

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON data from which `build` makes an equal configuration."""
        env = self.env.to_dict()
        del env["layout"], env["actions"]
        return self.model_dump(mode="json") | {"env": env}


VELOCITY: dict[str, Any] = {
    "steps": 2_000_000,
    "network": {"width": 32, "grid_channels": 8},
    "ppo": {"steps": 128, "batch": 512, "epochs": 3, "learning_rate": 3e-4, "discount": 0.995},
    "log": {"evaluate_every": 100_000, "evaluate_buildings": 8},
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "maskable_ppo": {},
    "ppo": VELOCITY,
    "recurrent_ppo": merge(VELOCITY, {"ppo": {"epochs": 2}}),
}


def of_task(name: Any) -> dict[str, Any]:
    """The fields of a training in a task; none for "". Raises `ConfigError` for an unknown task."""
    if name == "":
        return {}
    fields = {key: value for key, value in task_fields(name).items() if key not in DERIVED}
    env = {key: fields.pop(key) for key in EnvConfig.model_fields if key in fields}
    return {"env": env, "buildings": {"spec": fields}}


def check_algorithm(name: Any) -> str:
    """`name` if it is an algorithm. Raises `ConfigError` with those there are."""
    if name not in ALGORITHMS:
        raise ConfigError(f"algorithm: {name!r:.80} is not one of {', '.join(ALGORITHMS)}{guess(name, ALGORITHMS)}")
    return str(name)


def refuse_derived(env: Any) -> None:
    """Raise `ConfigError` for fields of the environment that are set by other names; they would not count."""
    for name in env if isinstance(env, Mapping) else ():
        if name in DERIVED:
            raise ConfigError(f"env.{name}: {DERIVED[name]}")


def check_batches(config: TrainConfig) -> None:
    """Raise `ConfigError` where a batch of an update is a single decision: its advantage has no deviation.

    sb3-contrib divides by that deviation all the same, and every weight becomes NaN; Stable-Baselines3 does not.
    """
    decisions, batch = config.ppo.steps * config.environments, config.ppo.batch
    if config.algorithm == "ppo" or batch >= decisions or decisions % batch != 1:
        return
    better = next(size for size in count(batch + 1) if decisions % size != 1)
    raise ConfigError(
        f"ppo.batch: {batch} leaves a last batch of 1 of the {decisions} decisions of an update (ppo.steps "
        f"{config.ppo.steps} x environments {config.environments}), at least 2; ppo.batch {better} does not"
    )


def check_prior(config: TrainConfig) -> None:
    """Raise `ConfigError` for a prior that reads predictions where the network has none."""
    prior, visible = config.network.prior, config.env.observation.uncertainty
    if prior not in ("returning", "stachniss") or (visible and config.network.uncertainty):
        return
    why = "network.uncertainty hides" if visible else "only a `task` shows"
    raise ConfigError(f"network.prior: {prior} reads predictions, which {why}; expected one of gain, nearest, none")


def check_observation(config: TrainConfig) -> None:
    """Raise `ConfigError` for another observation than the network reads."""
    given = config.env.observation.format
    if given != "dict":
        raise ConfigError(f"env.observation.format: {given!r}, expected 'dict': these networks read tables and grids")


def read_config(path: Path) -> dict[str, Any]:
    """The fields in a small JSON file. Raises `ConfigError` for another kind of file."""
    try:
        fields = read_json(path, MOST_CONFIG_BYTES, once_each)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None
    if not isinstance(fields, dict):
        raise ConfigError(f"{path}: expected an object of fields, found {type(fields).__name__}")
    return fields


def once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of a JSON file. Raises `ConfigError` for a key that is given twice: only the last would count."""
    for name, times in Counter(name for name, _ in pairs).items():
        if times > 1:
            raise ConfigError(f"{name:.80}: given {times} times in one object, once expected")
    return dict(pairs)
