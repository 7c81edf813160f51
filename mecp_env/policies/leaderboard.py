"""The table of results of a frozen benchmark, with reference rows; no name can forge a row.

Reference rows of the frozen benchmarks, which the package contains: figures without episodes.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import Figures, estimate, share

FOLDER = Path(__file__).parent / "references"
SUFFIX = " (reference)"  # no other row can have it: parentheses are no part of a name
UNSAFE = re.compile(r"[^\w .,:/+@=-]")  # marks of Markdown, bars, line breaks, control characters, ...
LONGEST = 80  # characters of a name
SHARES = ("lost", "complete")
DIGITS = 4


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


def rows_of_references(
    submissions: Iterable[Mapping[str, Any]], first: int, tasks: Sequence[str]
) -> list[dict[str, Any]]:
    """The rows of references, from results of submissions: the first so many buildings of those tasks.

    So a result of a large suite gives the row of a smaller one whose buildings are the first of the same.
    """
    return [
        {"task": row["task"], "policy": row["policy"], "estimator": row["estimator"], "figures": compact(row, first)}
        | {name: content[name] for name in ("hours", "seeds") if content.get(name) is not None}
        for content in submissions
        for row in content["results"]
        if row["task"] in tasks and len(row["episodes"]) >= first
    ]


def compact(row: Mapping[str, Any], first: int) -> dict[str, dict[str, float]]:
    """The figures of the first episodes of a row, with few digits."""
    episodes = sorted(row["episodes"], key=lambda episode: episode["building"])[:first]
    figures = {}
    for name in row["figures"]:
        values = [episode[name] for episode in episodes]
        found = share(value > 0.5 for value in values) if name in SHARES else estimate(values)
        figures[name] = {end: round(found[end], DIGITS) for end in ("value", "low", "high")}
    return figures


LESS_IS_BETTER = ("lost",)
TRAINING = ("hours", "seeds")  # what is known of a training
Results = Iterable[Mapping[str, Any]]


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

    def repeats(self, other: Entry) -> bool:
        """True for the same policy with figures that a table shows alike."""
        return self.key == other.key and self._cells() == other._cells()

    def _cells(self) -> dict[str, str]:
        return {task: cell(figure) for task, figure in self.figures.items()}


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
    found = entries_of(references, metric, "", {})
    for source, content in submissions.items():
        found += unrepeated(entries_of(content["results"], metric, source, content), found)
    found.sort(key=lambda entry: entry.total, reverse=metric not in LESS_IS_BETTER)
    return table_of(found)


def table_of(found: Sequence[Entry]) -> str:
    """The lines of a table in their order."""
    tasks = list(dict.fromkeys(task for entry in found for task in entry.figures))
    about = [name for name in TRAINING if any(name in entry.about for entry in found)]
    several = {key for key, count in Counter(entry.key for entry in found).items() if count > 1}
    heads = [*map(safe_name, tasks), *about]
    rows = [line_of(entry, label(entry, several), tasks, about) for entry in found]
    return "\n".join([f"| | {' | '.join(heads)} |", f"|{'---|' * (len(heads) + 1)}", *rows])


def entries_of(results: Results, metric: str, source: str, content: Mapping[str, Any]) -> list[Entry]:
    """A line per policy and estimator; `content` has hours and seeds of all, or each result its own."""
    figures: dict[tuple[str, str], dict[str, Figures]] = {}
    about: dict[tuple[str, str], dict[str, float]] = {}
    for row in results:
        key = row["policy"], row["estimator"]
        figures.setdefault(key, {})[row["task"]] = row["figures"][metric]
        given = {**content, **row}
        about[key] = {name: given[name] for name in TRAINING if given.get(name) is not None}
    return [Entry(key, source, line, about[key]) for key, line in figures.items()]


def unrepeated(entries: Iterable[Entry], known: Sequence[Entry]) -> list[Entry]:
    """The lines that repeat none of those that are known."""
    return [entry for entry in entries if not any(entry.repeats(other) for other in known)]


def label(entry: Entry, several: Iterable[tuple[str, str]]) -> str:
    """The name of a line: the policy, the estimator where it has some ground truth, the file where it matters."""
    policy, estimator = entry.key
    parts = [policy, *([] if estimator == "slam" else [estimator])]
    parts += [entry.source] if entry.source and entry.key in several else []
    return ", ".join(map(safe_name, parts)) + ("" if entry.source else SUFFIX)


def line_of(entry: Entry, name: str, tasks: Sequence[str], about: Sequence[str]) -> str:
    """The line as text; a dash where nothing is known."""
    cells = [cell(entry.figures.get(task)) for task in tasks]
    cells += [f"{entry.about[key]:g}" if key in entry.about else "-" for key in about]
    return f"| {name} | {' | '.join(cells)} |"


def cell(figure: Figures | None) -> str:
    """`value [low, high]`; a dash without one."""
    return "-" if figure is None else f"{figure['value']:.3f} [{figure['low']:.3f}, {figure['high']:.3f}]"
