"""Frozen benchmarks: buildings, starts, limits and metrics fixed by name and hash; a result is one JSON file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import Figures
from mecp_env.core.provenance import checksum, commit
from mecp_env.core.settings import guess
from mecp_env.policies.comparison import Row, figures_of
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import make_rooms
from mecp_env.policies.setting import Setting

FORMAT, VERSION = "mecp_env/suite", 1
SAMPLES = 3  # buildings of each setting whose content is part of the hash
FIXED = ("layout", "start", "max_steps", "robot", "laser", "odometry", "crowd", "clutter", "end")  # of a configuration
METRICS = ("correct_over_steps", "correct_over_metres", "correct_coverage", "auc", "coverage", "lost", "complete")


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


def submission(name: str, rows: Iterable[tuple[Setting, Sequence[Row]]], command: str) -> dict[str, Any]:
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
    content |= {"command": command, "commit": commit(), "results": results}
    return content | {"checksum": checksum(json.dumps(content, sort_keys=True).encode())}


def read_submission(path: Path) -> dict[str, Any]:
    """A result file. Raises `ConfigError` for another format, version or suite, a wrong hash, or a damaged file."""
    try:
        content = json.loads(path.read_text())
        found = content.pop("checksum")
        format_, version, name, frozen = (content[key] for key in ("format", "version", "suite", "hash"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: no result of a suite ({type(error).__name__}: {error})") from None
    if (format_, version) != (FORMAT, VERSION):
        raise ConfigError(f"{path}: {format_} version {version}, this mecp_env reads {FORMAT} version {VERSION}")
    if name not in SUITES:
        raise ConfigError(f"{path}: suite {name!r:.80}, this mecp_env has {', '.join(SUITES)}")
    if frozen != SUITES[name].frozen:
        raise ConfigError(f"{path}: suite {name} with the hash {frozen}, here {SUITES[name].frozen}")
    if found != checksum(json.dumps(content, sort_keys=True).encode()):
        raise ConfigError(f"{path}: its checksum {found} is that of another content; it was changed by hand")
    return dict(content)


def leaderboard(submissions: Iterable[dict[str, Any]], metric: str = "correct_over_steps") -> str:
    """A table with a line per policy and estimator and a column per task, the best first."""
    found: dict[tuple[str, str], dict[str, Figures]] = {}
    for result in [result for content in submissions for result in content["results"]]:
        row = found.setdefault((result["policy"], result["estimator"]), {})
        row[result["task"]] = result["figures"][metric]
    tasks = list(dict.fromkeys(task for row in found.values() for task in row))
    ordered = sorted(found.items(), key=lambda item: -sum(figure["value"] for figure in item[1].values()))
    lines = [f"| | {' | '.join(tasks)} |", f"|{'---|' * (len(tasks) + 1)}"]
    return "\n".join([*lines, *(line_of(name, row, tasks) for name, row in ordered)])


def line_of(name: tuple[str, str], row: dict[str, Figures], tasks: Sequence[str]) -> str:
    """A line of the table, of a policy and its estimator."""
    label = name[0] if name[1] == "slam" else ", ".join(name)
    return f"| {label} | {' | '.join(cell(row.get(task)) for task in tasks)} |"


def cell(figure: Figures | None) -> str:
    """`value [low, high]`; a dash without one."""
    return "-" if figure is None else f"{figure['value']:.3f} [{figure['low']:.3f}, {figure['high']:.3f}]"
