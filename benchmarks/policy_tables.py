"""What follows from results of policies: tables of README.md and docs/submissions.md, and rows of the package.

`python -m benchmarks.pages` writes them. The price of uncertainty follows from results/task_*_price.json, the frozen
benchmarks from results/suites/*.json. The tables are between `<!-- policies: NAME -->` and `<!-- end -->`; no figure is
copied by hand.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, Figures, estimate, share
from mecp_env.policies import suites
from mecp_env.policies.report import cell, markdown_table

ROOT = RESULTS.parents[1]
TASKS = ("halls", "corridors", "cheap_robot")
PRICE_RESULTS = tuple(RESULTS / f"task_{name}_price.json" for name in TASKS)  # also with known pairs and the true pose
GREEDY = ("nearest", "next_best_view")  # explorers that know no uncertainty, whose price is shown
SUITE_RESULTS = RESULTS / "suites"  # a file of `mecp-env evaluate --suite` for each submission
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "submissions.md")
SHARES, DIGITS = ("lost", "complete"), 4  # of reference rows
HEADLINE_METRIC = "correct_over_steps"
PLACE = re.compile(r"(<!-- policies: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def tables() -> dict[str, str]:
    """The text of each place by its name."""
    return {"price": price_table(), "suites": suite_tables(SUITE_RESULTS)}


def price_table() -> str:
    """The price of uncertainty in all tasks."""
    results = [json.loads(path.read_text()) for path in PRICE_RESULTS]
    lines = [price(result["setting"]["task"], policy, result["rows"]) for result in results for policy in GREEDY]
    return markdown_table(["task, policy", "estimator", "known correspondences", "true pose", "price"], lines)


def suite_tables(folder: Path) -> str:
    """The table of each frozen benchmark, from the result files in a folder. Raises `ConfigError` for a wrong file."""
    results = {path.name: suites.read_submission(path) for path in sorted(folder.glob("*.json"))}
    return "\n\n".join(suite_table(name, results) for name in suites.SUITES)


def suite_table(name: str, results: dict[str, Figures]) -> str:
    """The results of one of them, the best first."""
    ours = {file: content for file, content in results.items() if content["suite"] == name}
    heading = f"`{name}`, hash {suites.SUITES[name].frozen}"
    return (
        f"{heading}, correct coverage over steps:\n\n{suites.leaderboard(ours)}"
        if ours
        else f"{heading}: no result yet."
    )


def price(task: str, policy: str, rows: list[Figures]) -> list[str]:
    """A line of the price of uncertainty: correct coverage over steps, and truth minus estimator, paired."""
    of_policy = {row["estimator"]: row for row in rows if row["policy"] == policy}
    figures = [of_policy[name]["figures"][HEADLINE_METRIC] for name in ("slam", "known", "truth")]
    cost = of_policy["truth"]["with_the_pose_known"][HEADLINE_METRIC]
    return [f"`{task}`, {policy}", *(cell(figure, ".3f") for figure in (*figures, cost))]


def updated(text: str, parts: dict[str, str]) -> str:
    """A document with the tables of its places."""
    return PLACE.sub(lambda place: f"{place[1]}{parts[place[2]]}\n{place[3]}", text)


def reference_rows() -> dict[Path, str]:
    """The content of each file of reference rows that the package contains, a file for each suite.

    A suite takes its own results, and those of a larger suite whose first buildings are the same.
    """
    contents = [suites.read_submission(path) for path in sorted(SUITE_RESULTS.glob("*.json"))]
    return {
        suites.FOLDER / f"{name}.json": json.dumps(
            {"suite": name, "hash": suite.frozen, "results": rows_of(name, suite, contents)}, separators=(",", ":")
        )
        + "\n"
        for name, suite in suites.SUITES.items()
    }


def rows_of(name: str, suite: suites.Suite, contents: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a suite; its own result replaces that of a larger suite."""
    usable = [content for content in contents if settings_in(suite, suites.SUITES[content["suite"]])]
    ordered = sorted(usable, key=lambda content: content["suite"] == name)
    rows = rows_of_references(ordered, suite.episodes, suite.tasks)
    return list({(row["task"], row["policy"], row["estimator"]): row for row in rows}.values())


def settings_in(small: suites.Suite, large: suites.Suite) -> bool:
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
        | {name: content[name] for name in suites.TRAINING if content.get(name) is not None}
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
