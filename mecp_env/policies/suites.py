"""Frozen benchmarks: buildings, starts, limits and metrics fixed by name and hash; results as JSON, and their table."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, TypeAdapter

from mecp_env.core.errors import ConfigError
from mecp_env.core.files import read_json
from mecp_env.core.intervals import Figures
from mecp_env.core.provenance import checksum, checksum_of_parts, commit
from mecp_env.core.settings import few, guess
from mecp_env.policies.evaluation import Row, figures_of
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.registry import Policy
from mecp_env.policies.report import cell, markdown_table
from mecp_env.policies.rollout import make_rooms, options_of
from mecp_env.policies.setting import Setting

FOLDER = Path(__file__).parent / "references"
SUFFIX = " (reference)"  # no other row can have it: parentheses are no part of a name
UNSAFE = re.compile(r"[^\w .,:/+@=-]")  # marks of Markdown, bars, line breaks, control characters, ...
LONGEST = 80  # characters of a name
LESS_IS_BETTER = ("lost",)
TRAINING = ("hours", "seeds")  # what is known of a training
FORMAT, VERSION = "mecp_env/suite", 1
MOST_BYTES = 50_000_000  # of a result file
Key = tuple[str, str, str]  # of a line: policy, estimator, and name of the file, "" of a reference
SAMPLES = 3  # buildings of each setting whose content is part of the hash
FIXED = ("layout", "start", "max_steps", "robot", "laser", "odometry", "crowd", "clutter", "end")  # of a configuration
EXPECTED = "name result files, as mecp-env submit writes them"
METRICS = ("correct_over_steps", "correct_over_metres", "correct_coverage", "auc", "coverage", "lost", "complete")
ESTIMATORS = ("slam", "known", "truth")
HALLS, CORRIDORS, CHEAP_ROBOT = (
    Setting("", "test", "slam", 1500, f"Active{name}-v0") for name in ("Halls", "Corridors", "CheapRobot")
)
MEDIUM, HARD = (Setting(name, "test", "slam", 3000) for name in ("medium", "hard"))


def safe_name(name: str) -> str:
    """A name as a cell of a table shows it: one line, without characters that have a meaning in Markdown."""
    return UNSAFE.sub("?", name)[:LONGEST]


def check_name(name: str, field: str = "name") -> str:
    """`name` itself. Raises `ConfigError` for one that a table would not show as it is, or an empty one."""
    if not name.strip() or name != safe_name(name):
        raise ConfigError(
            f"{field}: {name!r:.100}, expected at most {LONGEST} letters, digits, spaces and _.,:/+@=- in one line"
        )
    return name


def reference_rows(suite: str, frozen: str) -> list[dict[str, Any]]:
    """The rows of a suite with that hash, as the results of a file; none where the package has none."""
    path = FOLDER / f"{suite}.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return list(content["results"]) if content.get("hash") == frozen else []


def leaderboard(
    submissions: Mapping[str, Mapping[str, Any]],
    metric: str = "correct_over_steps",
    references: Sequence[Mapping[str, Any]] = (),
) -> str:
    """A table with a line per policy and estimator and a column per task, the best first.

    `submissions` are results by the names of their files, which tell policies of one name and different results apart.
    `references` are rows that the package contains; a line of a file that repeats one is left out. Hours and seeds have
    columns where any line has them. No name can add a line or a column.
    """
    found, about = gathered({"": {"results": references}, **submissions}, metric)
    order = ordered(found, metric)
    tasks = list(dict.fromkeys(task for key in order for task in found[key]))
    extra = sorted(set().union(*(about[key] for key in order)))
    lines = [
        [label_of(key, order), *(cell(found[key].get(task), ".3f") for task in tasks)]
        + [about[key].get(name, "-") for name in extra]
        for key in order
    ]
    return markdown_table(["", *map(safe_name, tasks), *extra], lines)


def gathered(
    contents: Mapping[str, Mapping[str, Any]], metric: str
) -> tuple[dict[Key, dict[str, Figures]], dict[Key, dict[str, str]]]:
    """Of each line the figure of each task, and hours and seeds where they are known.

    A content has hours and seeds of all its results, or each of these has its own.
    """
    found: dict[Key, dict[str, Figures]] = {}
    about: dict[Key, dict[str, str]] = {}
    for source, content in contents.items():
        for row in content["results"]:
            key, known = (row["policy"], row["estimator"], source), {**content, **row}
            found.setdefault(key, {})[row["task"]] = row["figures"][metric]
            about[key] = {name: f"{known[name]:g}" for name in TRAINING if known.get(name) is not None}
    return found, about


def ordered(found: Mapping[Key, Mapping[str, Figures]], metric: str) -> list[Key]:
    """The lines, the best first; of those that show the same, the first."""
    once: dict[str, Key] = {}
    for key, figures in found.items():
        once.setdefault(str((key[:2], {task: cell(figure, ".3f") for task, figure in figures.items()})), key)
    totals = {key: sum(figure["value"] for figure in found[key].values()) for key in once.values()}
    return sorted(totals, key=totals.__getitem__, reverse=metric not in LESS_IS_BETTER)


def label_of(key: Key, keys: Sequence[Key]) -> str:
    """The policy, the estimator where it has some ground truth, and the file where several have that policy."""
    policy, estimator, source = key
    several = sum(other[:2] == key[:2] for other in keys) > 1
    parts = [policy, estimator if estimator != "slam" else "", source if several else ""]
    return ", ".join(safe_name(part) for part in parts if part) + ("" if source else SUFFIX)


@dataclass(frozen=True, slots=True)
class Suite:
    """Settings, each with the first so many buildings of its split, and the hash of all that fixes a result."""

    settings: tuple[Setting, ...]
    episodes: int
    frozen: str  # `definition_hash` when the suite was published

    @property
    def tasks(self) -> list[str]:
        """The names of its settings."""
        return [setting.name for setting in self.settings]


SUITES = {
    "active-v1": Suite((HALLS, CORRIDORS, CHEAP_ROBOT), 200, "f3388a4466800053"),
    "active-quick-v1": Suite((HALLS,), 20, "50d59c8d8bb456d8"),
    "coverage-v1": Suite((MEDIUM, HARD), 100, "d1b7f5ea1ca3abcb"),
}


def find_suite(name: str) -> Suite:
    """The suite of that name. Raises `ConfigError` for an unknown one, and for one that this version would change."""
    if name not in SUITES:
        raise ConfigError(f"suite: {name!r:.80}, expected one of {', '.join(SUITES)}{guess(name, SUITES)}")
    suite, found = SUITES[name], definition_hash(name)
    if found != suite.frozen:
        raise ConfigError(
            f"suite: {name} was published with the hash {suite.frozen}, this mecp_env has {found}: "
            "its results cannot be compared; install the version that the suite was published with"
        )
    return suite


@cache
def definition_hash(name: str) -> str:
    """16 hexadecimal digits over settings, configurations, start poses and the first buildings of a suite."""
    suite = SUITES[name]
    parts = [describe(setting) for setting in suite.settings]
    return checksum(json.dumps([parts, suite.episodes, METRICS], sort_keys=True).encode())


def refuse_changes(names: Sequence[str], policies: Sequence[Policy]) -> None:
    """Raise `ConfigError` for a policy whose `settings` change what a suite fixes, such as the laser."""
    for name, policy in zip(names, policies, strict=True):
        fixed = (*FIXED, "slam")  # an estimator is compared by its own benchmarks
        changed = [field for field in options_of(policy) if field in fixed]
        if changed:
            raise ConfigError(
                f"policy: {name!r:.80} has settings of {', '.join(changed)}; a suite fixes {', '.join(fixed)}"
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


def submission(
    name: str, rows: Iterable[tuple[Setting, Sequence[Row]]], command: str, training: Training | None = None
) -> dict[str, Any]:
    """The result of a suite as JSON data: for each setting and policy the figures, and each episode."""
    results = [result_of(setting, row) for setting, some in rows for row in some]
    content = {"format": FORMAT, "version": VERSION, "suite": name, "hash": SUITES[name].frozen}
    about = {key: value for key, value in asdict(training or Training()).items() if value is not None}
    content |= {"command": command, "commit": commit(), **about, "results": results}
    return content | {"checksum": checksum_of(content)}


def result_of(setting: Setting, row: Row) -> dict[str, Any]:
    """The part of a submission that belongs to a row."""
    figures = figures_of(row)
    return {
        "task": setting.name,
        "policy": row.policy,
        "estimator": row.estimator,
        "figures": {metric: figures[metric] for metric in METRICS},
        "episodes": [
            {"building": episode.task.building} | {metric: episode.figures[metric] for metric in METRICS}
            for episode in row.episodes
        ],
    }


def checksum_of(content: Any) -> str:
    """That of the JSON text, which is never in memory at once."""
    return checksum_of_parts(part.encode() for part in json.JSONEncoder(sort_keys=True).iterencode(content))


def read_submission(path: Path) -> dict[str, Any]:
    """A result file. Raises `ConfigError` for another format, version or suite, a wrong hash, or a damaged file."""
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"a folder, or no plain file; {EXPECTED}")
        content = read_json(path, MOST_BYTES)
        check_content(content.pop("checksum"), content)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        fault = f"it has no field {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise ConfigError(f"{path}: no result of a suite ({fault}); {EXPECTED}") from None
    return dict(content)


def check_content(found: Any, content: Any) -> None:
    """Raise `ConfigError` for a content that this version does not read, or without the checksum `found`."""
    format_, version, name, frozen = content["format"], content["version"], content["suite"], content["hash"]
    if (format_, version) != (FORMAT, VERSION):
        raise ConfigError(f"{format_} version {version}, this mecp_env reads {FORMAT} version {VERSION}")
    if not isinstance(name, str) or name not in SUITES:
        raise ConfigError(f"suite {name!r:.80}, this mecp_env has {', '.join(SUITES)}")
    if frozen != SUITES[name].frozen:
        raise ConfigError(f"suite {name} with the hash {frozen}, here {SUITES[name].frozen}")
    if found != (own := checksum_of(content)):
        raise ConfigError(f"its checksum is {found!s:.40}, that of its content {own}; it was changed by hand")
    validated("hours, seeds", Training, {key: content.get(key) for key in TRAINING})
    for row in validated("results", Annotated[list[Result], Field(fail_fast=True)], content.get("results")):
        check_row(row, SUITES[name].tasks)


def check_row(row: Result, tasks: Sequence[str]) -> None:
    """Raise `ConfigError` for a name that would forge rows, another task or estimator, and a missing metric."""
    check_name(row.policy, "results: policy")
    for given, known in ((row.task, tasks), (row.estimator, ESTIMATORS)):
        if given not in known:
            raise ConfigError(f"results: {given!r:.80}, expected one of {', '.join(known)}")
    missing = [metric for metric in METRICS if metric not in row.figures]
    if missing:
        raise ConfigError(f"results: {row.policy} in {row.task} has no {missing[0]}")


def validated(what: str, kind: Any, value: Any) -> Any:
    """`value` as that kind. Raises `ConfigError` that names `what` is wrong."""
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValueError as error:  # of pydantic, too
        raise ConfigError(f"{what}: {' '.join(str(error).split()):.160}") from None
