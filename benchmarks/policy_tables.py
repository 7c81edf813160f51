"""The tables of README.md and docs/submissions.md, from results: `python -m benchmarks.policy_tables`.

The price of uncertainty follows from results/task_*_price.json, the frozen benchmarks from results/suites/*.json. The
tables are between `<!-- policies: NAME -->` and `<!-- end -->`; no figure is copied by hand.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from benchmarks.common import RESULTS, Figures
from mecp_env.policies import suites
from mecp_env.policies.report import cell, markdown_table

ROOT = RESULTS.parents[1]
TASKS = ("halls", "corridors", "cheap_robot")
PRICE_RESULTS = tuple(RESULTS / f"task_{name}_price.json" for name in TASKS)  # also with known pairs and the true pose
GREEDY = ("nearest", "next_best_view")  # explorers that know no uncertainty, whose price is shown
SUITE_RESULTS = RESULTS / "suites"  # a file of `mecp-env evaluate --suite` for each submission
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "submissions.md")
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


def main() -> int:
    """Update the documents."""
    for path in DOCUMENTS:
        path.write_text(updated(path.read_text(), tables()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
