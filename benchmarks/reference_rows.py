"""Writes the reference rows that the package contains, from the results in benchmarks/results/suites.

    python -m benchmarks.reference_rows

A suite takes the results of its own, and those of a larger suite whose first buildings are its own.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mecp_env.core.files import write_atomic
from mecp_env.policies.leaderboard import FOLDER, rows_of_references
from mecp_env.policies.suites import SUITES, Suite, read_submission

RESULTS = Path(__file__).parent / "results" / "suites"


def main() -> None:
    """Write a file for each suite."""
    contents = [read_submission(path) for path in sorted(RESULTS.glob("*.json"))]
    for name, suite in SUITES.items():
        content = {"suite": name, "hash": suite.frozen, "results": rows_of(name, suite, contents)}
        write_atomic(FOLDER / f"{name}.json", (json.dumps(content, separators=(",", ":")) + "\n").encode())


def rows_of(name: str, suite: Suite, contents: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a suite; a result of its own replaces that of a larger suite."""
    tasks = [setting.task or setting.difficulty for setting in suite.settings]
    usable = [content for content in contents if settings_in(suite, SUITES[content["suite"]])]
    ordered = sorted(usable, key=lambda content: content["suite"] == name)
    rows = rows_of_references(ordered, suite.episodes, tasks)
    return list({(row["task"], row["policy"], row["estimator"]): row for row in rows}.values())


def settings_in(small: Suite, large: Suite) -> bool:
    """True when every episode of a suite is one of another suite."""
    return set(map(str, small.settings)) <= set(map(str, large.settings)) and small.episodes <= large.episodes


if __name__ == "__main__":
    main()
