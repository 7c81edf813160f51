"""Frozen benchmarks: buildings, starts, limits and metrics fixed by name and hash; a result is one JSON file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, TypeAdapter

from mecp_env.core.errors import ConfigError
from mecp_env.core.files import read_json
from mecp_env.core.provenance import checksum, checksum_of_parts, commit
from mecp_env.core.settings import few, guess
from mecp_env.policies.comparison import Row, figures_of
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.leaderboard import TRAINING, check_name
from mecp_env.policies.leaderboard import leaderboard as leaderboard
from mecp_env.policies.registry import Policy
from mecp_env.policies.rollout import make_rooms, options_of
from mecp_env.policies.setting import Setting

FORMAT, VERSION = "mecp_env/suite", 1
MOST_BYTES = 50_000_000  # of a result file
SAMPLES = 3  # buildings of each setting whose content is part of the hash
FIXED = ("layout", "start", "max_steps", "robot", "laser", "odometry", "crowd", "clutter", "end")  # of a configuration
METRICS = ("correct_over_steps", "correct_over_metres", "correct_coverage", "auc", "coverage", "lost", "complete")
ESTIMATORS = ("slam", "known", "truth")


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure of a result file with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Result:
    """The part of a result file that belongs to a task, a policy and an estimator."""

    task: str
    policy: str
    estimator: str
    figures: Annotated[dict[str, Interval], BeforeValidator(few)]
    episodes: Annotated[list[Annotated[dict[str, float], BeforeValidator(few)]], Field(fail_fast=True)]


@dataclass(frozen=True, slots=True)
class Suite:
    """Settings, each with the first so many buildings of its split, and the hash of all that fixes a result."""

    settings: tuple[Setting, ...]
    episodes: int
    frozen: str  # `definition_hash` when the suite was published


SUITES = {
    "active-v1": Suite(
        tuple(
            Setting("", "test", "slam", 1500, task)
            for task in ("ActiveHalls-v0", "ActiveCorridors-v0", "ActiveCheapRobot-v0")
        ),
        200,
        "f3388a4466800053",
    ),
    "active-quick-v1": Suite((Setting("", "test", "slam", 1500, "ActiveHalls-v0"),), 20, "50d59c8d8bb456d8"),
    "coverage-v1": Suite(
        tuple(Setting(name, "test", "slam", 3000) for name in ("medium", "hard")), 100, "d1b7f5ea1ca3abcb"
    ),
}


def find_suite(name: str) -> Suite:
    """The suite of that name. Raises `ConfigError` for an unknown one, and for one that this version would change."""
    if name not in SUITES:
        raise ConfigError(f"suite: {name!r:.80}, expected one of {', '.join(SUITES)}{guess(name, SUITES)}")
    found = definition_hash(name)
    if found != SUITES[name].frozen:
        raise ConfigError(
            f"suite: {name} was published with the hash {SUITES[name].frozen}, this mecp_env has {found}: "
            "its results cannot be compared; install the version that the suite was published with"
        )
    return SUITES[name]


@cache
def definition_hash(name: str) -> str:
    """16 hexadecimal digits over settings, configurations, start poses and the first buildings of a suite."""
    suite = SUITES[name]
    parts = [describe(setting) for setting in suite.settings]
    return checksum(json.dumps([parts, suite.episodes, METRICS], sort_keys=True).encode())


def refuse_changes(names: Sequence[str], policies: Sequence[Policy]) -> None:
    """Raise `ConfigError` for a policy whose `settings` change what a suite fixes, such as the laser."""
    for name, policy in zip(names, policies, strict=True):
        changed = [field for field in options_of(policy) if field in FIXED]
        if changed:
            raise ConfigError(
                f"policy: {name!r:.80} has settings of {', '.join(changed)}; a suite fixes {', '.join(FIXED)}"
            )


def describe(setting: Setting) -> dict[str, Any]:
    """What fixes the results of a setting: its fields, the configuration but for the estimator, some buildings."""
    env = make_rooms(setting, Nearest())
    config = env.unwrapped.config.to_dict()  # type: ignore[attr-defined]
    fixed = {name: config[name] for name in FIXED}
    begins = []
    for building in range(SAMPLES):
        env.reset(seed=building, options={"building": building})
        view = env.unwrapped.view()  # type: ignore[attr-defined]
        begins.append([view.segments.round(6).tolist(), view.T_world_robot.round(6).tolist()])
    env.close()
    return {"setting": setting.named(), "config": fixed, "buildings": checksum(json.dumps(begins).encode())}


@dataclass(frozen=True, slots=True)
class Training:
    """What a submission says of the training of its policies; None where it says nothing."""

    hours: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] | None = None

    def named(self) -> dict[str, float]:
        """The fields that are known."""
        return {name: value for name, value in (("hours", self.hours), ("seeds", self.seeds)) if value is not None}


def submission(
    name: str, rows: Iterable[tuple[Setting, Sequence[Row]]], command: str, training: Training | None = None
) -> dict[str, Any]:
    """The result of a suite as JSON data: for each setting and policy the figures, and each episode."""
    results = [
        {
            "task": setting.task or setting.difficulty,
            "policy": row.policy,
            "estimator": row.estimator,
            "figures": {metric: figures_of(row)[metric] for metric in METRICS},
            "episodes": [
                {"building": episode.task.building} | {metric: episode.figures[metric] for metric in METRICS}
                for episode in row.episodes
            ],
        }
        for setting, some in rows
        for row in some
    ]
    content = {"format": FORMAT, "version": VERSION, "suite": name, "hash": SUITES[name].frozen}
    content |= {"command": command, "commit": commit(), **(training or Training()).named(), "results": results}
    return content | {"checksum": checksum_of(content)}


def checksum_of(content: Any) -> str:
    """That of the JSON text, which is never in memory at once."""
    return checksum_of_parts(part.encode() for part in json.JSONEncoder(sort_keys=True).iterencode(content))


def read_submission(path: Path) -> dict[str, Any]:
    """A result file. Raises `ConfigError` for another format, version or suite, a wrong hash, or a damaged file."""
    try:
        content = read_json(path, MOST_BYTES)
        found = content.pop("checksum")
        format_, version, name, frozen = (content[key] for key in ("format", "version", "suite", "hash"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: no result of a suite ({type(error).__name__}: {error})") from None
    if (format_, version) != (FORMAT, VERSION):
        raise ConfigError(f"{path}: {format_} version {version}, this mecp_env reads {FORMAT} version {VERSION}")
    check_suite(path, name, frozen)
    own = checksum_of(content)
    if found != own:
        raise ConfigError(f"{path}: its checksum is {found!s:.40}, that of its content {own}; it was changed by hand")
    check_results(path, content.get("results"), SUITES[name])
    try:
        TypeAdapter(Training).validate_python({key: content.get(key) for key in TRAINING})
    except ValueError as error:
        raise ConfigError(f"{path}: hours, seeds: {' '.join(str(error).split()):.160}") from None
    return dict(content)


def check_suite(path: Path, name: Any, frozen: Any) -> None:
    """Raise `ConfigError` for the name of no suite, and for a hash that is not that of the suite."""
    if not isinstance(name, str) or name not in SUITES:
        raise ConfigError(f"{path}: suite {name!r:.80}, this mecp_env has {', '.join(SUITES)}")
    if frozen != SUITES[name].frozen:
        raise ConfigError(f"{path}: suite {name} with the hash {frozen}, here {SUITES[name].frozen}")


def check_results(path: Path, results: Any, suite: Suite) -> None:
    """Raise `ConfigError` for results of another form or task, a name that forges rows, and a missing metric."""
    try:
        found = TypeAdapter(Annotated[list[Result], Field(fail_fast=True)]).validate_python(results)
    except ValueError as error:  # of pydantic, too
        raise ConfigError(f"{path}: results: {' '.join(str(error).split()):.160}") from None
    for row in found:
        check_row(path, row, suite)
    missing = [(row, metric) for row in found for metric in METRICS if metric not in row.figures]
    for row, metric in missing[:1]:
        raise ConfigError(f"{path}: results: {row.policy} in {row.task} has no {metric}")


def check_row(path: Path, row: Result, suite: Suite) -> None:
    """Raise `ConfigError` for a policy whose name would forge rows, another task, and an unknown estimator."""
    check_name(row.policy, f"{path}: results: policy")
    tasks = [setting.task or setting.difficulty for setting in suite.settings]
    for given, known in ((row.task, tasks), (row.estimator, ESTIMATORS)):
        if given not in known:
            raise ConfigError(f"{path}: results: {given!r:.80}, expected one of {', '.join(known)}")
