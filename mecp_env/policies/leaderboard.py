"""The table of results of a frozen benchmark, with reference rows of the package; no name can forge a row."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import Figures
from mecp_env.policies.report_table import cell, markdown_table

FOLDER = Path(__file__).parent / "references"
SUFFIX = " (reference)"  # no other row can have it: parentheses are no part of a name
UNSAFE = re.compile(r"[^\w .,:/+@=-]")  # marks of Markdown, bars, line breaks, control characters, ...
LONGEST = 80  # characters of a name
LESS_IS_BETTER = ("lost",)
TRAINING = ("hours", "seeds")  # what is known of a training


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


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of the table."""

    key: tuple[str, str]  # policy and estimator
    source: str  # name of the file; "" of a reference
    figures: Mapping[str, Figures]  # by task
    about: Mapping[str, float]  # hours and seeds where they are known

    @property
    def total(self) -> float:
        """The sum of the figures, by which lines are sorted."""
        return float(sum(figure["value"] for figure in self.figures.values()))

    @property
    def shown(self) -> Any:
        """The policy and its cells: lines in which these are equal repeat each other."""
        return self.key, {task: cell(figure, ".3f") for task, figure in self.figures.items()}

    def label(self, several: bool) -> str:
        """The policy, the estimator where it has some ground truth, the file where `several` have that policy."""
        policy, estimator = self.key
        parts = [policy, estimator if estimator != "slam" else "", self.source if several else ""]
        return ", ".join(safe_name(part) for part in parts if part) + ("" if self.source else SUFFIX)

    def cells(self, tasks: Sequence[str], about: Sequence[str]) -> list[str]:
        """The figures of the tasks, and hours and seeds; a dash where nothing is known."""
        figures = [cell(self.figures.get(task), ".3f") for task in tasks]
        return figures + [f"{self.about[name]:g}" if name in self.about else "-" for name in about]


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
    found = entries_of({"results": references}, metric, "")
    for source, content in submissions.items():
        known = [entry.shown for entry in found]
        found += [entry for entry in entries_of(content, metric, source) if entry.shown not in known]
    return table_of(sorted(found, key=lambda entry: entry.total, reverse=metric not in LESS_IS_BETTER))


def table_of(found: Sequence[Entry]) -> str:
    """The lines of a table in their order."""
    tasks = list(dict.fromkeys(task for entry in found for task in entry.figures))
    about = [name for name in TRAINING if any(name in entry.about for entry in found)]
    counts = Counter(entry.key for entry in found)
    lines = [[entry.label(counts[entry.key] > 1), *entry.cells(tasks, about)] for entry in found]
    return markdown_table(["", *map(safe_name, tasks), *about], lines)


def entries_of(content: Mapping[str, Any], metric: str, source: str) -> list[Entry]:
    """A line per policy and estimator; `content` has hours and seeds of all, or each of its results its own."""
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in content["results"]:
        rows.setdefault((row["policy"], row["estimator"]), []).append({**content, **row})
    return [
        Entry(
            key,
            source,
            {row["task"]: row["figures"][metric] for row in some},
            {name: some[-1][name] for name in TRAINING if some[-1].get(name) is not None},
        )
        for key, some in rows.items()
    ]
