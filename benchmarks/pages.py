"""Writes again what follows from the files of results: pages, tables of documents, reference rows of the package.

python -m benchmarks.pages

The price of uncertainty follows from results/task_*_price.json, the frozen benchmarks from results/suites/*.json. The
tables of README.md and docs/submissions.md are between `<!-- policies: NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, Figures, estimate, page_of, share
from mecp_env.policies import suites
from mecp_env.policies.report import cell, markdown_table

ROOT = RESULTS.parents[1]
TASKS = ("halls", "corridors", "cheap_robot")  # with known pairs and the true pose in results/task_*_price.json
GREEDY = ("nearest", "next_best_view")  # explorers that know no uncertainty, whose price is shown
SUITE_RESULTS = RESULTS / "suites"  # a file of `mecp-env evaluate --suite` for each submission
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "submissions.md")
SHARES, DIGITS = ("lost", "complete"), 4  # of reference rows
METRIC = "correct_over_steps"
PLACE = re.compile(r"(<!-- policies: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages() -> Iterator[tuple[Path, str]]:
    """Each file of results of a benchmark, and the page that belongs to it."""
    for path in sorted(RESULTS.glob("*.json")):
        content = json.loads(path.read_text())
        if "benchmark" in content:  # other results are those of `mecp-env evaluate`
            name = "against" if "against" in content["figures"] else content["benchmark"]
            yield path, page_of(content, importlib.import_module(f"benchmarks.{name}"), f"{path.stem}.png")


def tables() -> dict[str, str]:
    """The text of each place by its name."""
    return {"price": price_table(), "suites": suite_tables(SUITE_RESULTS)}


def price_table() -> str:
    """The price of uncertainty in all tasks: correct coverage over steps, and truth minus estimator, paired."""
    lines = []
    for result in (json.loads((RESULTS / f"task_{name}_price.json").read_text()) for name in TASKS):
        for policy in GREEDY:
            of = {row["estimator"]: row for row in result["rows"] if row["policy"] == policy}
            figures = [of[name]["figures"][METRIC] for name in ("slam", "known", "truth")]
            cells = [cell(figure, ".3f") for figure in (*figures, of["truth"]["with_the_pose_known"][METRIC])]
            lines.append([f"`{result['setting']['task']}`, {policy}", *cells])
    return markdown_table(["task, policy", "estimator", "known correspondences", "true pose", "price"], lines)


def suite_tables(folder: Path) -> str:
    """The table of each frozen benchmark, from the result files in a folder. Raises `ConfigError` for a wrong file."""
    results = {path.name: suites.read_submission(path) for path in sorted(folder.glob("*.json"))}
    parts = []
    for name, suite in suites.SUITES.items():
        ours = {file: content for file, content in results.items() if content["suite"] == name}
        table = f", correct coverage over steps:\n\n{suites.leaderboard(ours)}" if ours else ": no result yet."
        parts.append(f"`{name}`, hash {suite.frozen}{table}")
    return "\n\n".join(parts)


def updated(text: str, parts: dict[str, str]) -> str:
    """A document with the tables of its places."""
    return PLACE.sub(lambda place: f"{place[1]}{parts[place[2]]}\n{place[3]}", text)


def reference_rows() -> dict[Path, str]:
    """The content of each file of reference rows that the package contains, a file for each suite.

    A suite takes its own results, and those of a larger suite whose first buildings are the same.
    """
    contents = [suites.read_submission(path) for path in sorted(SUITE_RESULTS.glob("*.json"))]
    files = {}
    for name, suite in suites.SUITES.items():
        content = {"suite": name, "hash": suite.frozen, "results": rows_of(name, suite, contents)}
        files[suites.FOLDER / f"{name}.json"] = json.dumps(content, separators=(",", ":")) + "\n"
    return files


def rows_of(name: str, suite: suites.Suite, contents: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a suite: the first so many buildings of each result; its own replaces that of a larger suite."""
    usable = [content for content in contents if settings_in(suite, suites.SUITES[content["suite"]])]
    rows = {}
    for content in sorted(usable, key=lambda content: content["suite"] == name):
        training = {key: content[key] for key in suites.TRAINING if content.get(key) is not None}
        for row in content["results"]:
            if row["task"] in suite.tasks and len(row["episodes"]) >= suite.episodes:
                key = {part: row[part] for part in ("task", "policy", "estimator")}
                rows[tuple(key.values())] = key | {"figures": compact(row, suite.episodes)} | training
    return list(rows.values())


def settings_in(small: suites.Suite, large: suites.Suite) -> bool:
    """True when every episode of a suite is one of another suite."""
    return set(map(str, small.settings)) <= set(map(str, large.settings)) and small.episodes <= large.episodes


def compact(row: Mapping[str, Any], first: int) -> Figures:
    """The figures of the first episodes of a row, with few digits."""
    episodes = sorted(row["episodes"], key=lambda episode: episode["building"])[:first]
    figures = {}
    for name in row["figures"]:
        values = [episode[name] for episode in episodes]
        found = share(value > 0.5 for value in values) if name in SHARES else estimate(values)
        figures[name] = {end: round(found[end], DIGITS) for end in ("value", "low", "high")}
    return figures


def main() -> int:
    """Write them."""
    for path, page in pages():
        path.with_suffix(".md").write_text(page)
    for document in DOCUMENTS:
        document.write_text(updated(document.read_text(), tables()))
    for path, rows in reference_rows().items():
        path.write_text(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
