"""Writes the reference rows that the package contains, from the results in benchmarks/results/suites.

    python -m benchmarks.reference_rows

A suite takes its own results, and those of a larger suite whose first buildings are the same.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mecp_env.core.files import write_atomic
from mecp_env.core.intervals import estimate, share
from mecp_env.policies.suites import FOLDER, SUITES, TRAINING, Suite, read_submission

RESULTS = Path(__file__).parent / "results" / "suites"
SHARES = ("lost", "complete")
DIGITS = 4


def main() -> None:
    """Write a file for each suite."""
    contents = [read_submission(path) for path in sorted(RESULTS.glob("*.json"))]
    for name, suite in SUITES.items():
        content = {"suite": name, "hash": suite.frozen, "results": rows_of(name, suite, contents)}
        write_atomic(FOLDER / f"{name}.json", (json.dumps(content, separators=(",", ":")) + "\n").encode())


def rows_of(name: str, suite: Suite, contents: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a suite; its own result replaces that of a larger suite."""
    usable = [content for content in contents if settings_in(suite, SUITES[content["suite"]])]
    ordered = sorted(usable, key=lambda content: content["suite"] == name)
    rows = rows_of_references(ordered, suite.episodes, suite.tasks)
    return list({(row["task"], row["policy"], row["estimator"]): row for row in rows}.values())


def settings_in(small: Suite, large: Suite) -> bool:
    """True when every episode of a suite is one of another suite."""
    return set(map(str, small.settings)) <= set(map(str, large.settings)) and small.episodes <= large.episodes


def rows_of_references(
    submissions: Iterable[Mapping[str, Any]], first: int, tasks: Sequence[str]
) -> list[dict[str, Any]]:
    """The rows of references, from results of submissions: the first so many buildings of those tasks.

    So a result of a large suite gives the row of a smaller one whose buildings are the first of the same.
    """
    return [
        {"task": row["task"], "policy": row["policy"], "estimator": row["estimator"], "figures": compact(row, first)}
        | {name: content[name] for name in TRAINING if content.get(name) is not None}
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


if __name__ == "__main__":
    main()
