"""The tables of README.md and of docs/policies.md and tasks.md, from results: `python -m benchmarks.policy_tables`.

results/policies.json has the coverage of generated buildings, results/task_*.json the tasks of active SLAM,
results/kth_plans.json real floor plans, and results/suites/*.json the frozen benchmarks.

They are between `<!-- policies: NAME -->` and `<!-- end -->`; no figure is copied by hand.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common import RESULTS
from mecp_env.core.intervals import Figures
from mecp_env.policies import suites
from mecp_env.policies.report_table import (
    DIFFERENCES,
    HEADLINE,
    Column,
    cell,
    labelled,
    markdown_table,
    seeds_table,
    table,
)

ROOT = RESULTS.parents[1]
RESULT = RESULTS / "policies.json"
TASKS = ("halls", "corridors", "cheap_robot")
PRICE_RESULTS = tuple(RESULTS / f"task_{name}_price.json" for name in TASKS)  # also with known pairs and the true pose
ACTING_RESULTS = tuple(RESULTS / f"task_{name}_acting.json" for name in TASKS)  # more policies, the estimator alone
LEARNED_RESULT = RESULTS / "task_halls_learned.json"
PLAN_RESULT = RESULTS / "kth_plans.json"
GREEDY = ("nearest", "next_best_view")  # explorers that know no uncertainty, whose price is shown
SUITE_RESULTS = RESULTS / "suites"  # a file of `mecp-env evaluate --suite` for each submission
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "policies.md", ROOT / "docs" / "tasks.md")
HEADLINE_METRIC = "correct_over_steps"
ACTING: tuple[Column, ...] = (
    ("correct coverage over steps", HEADLINE_METRIC, ".3f", 1.0),
    ("at the end, %", "correct_coverage", ".1f", 100.0),
    ("coverage, %", "coverage", ".1f", 100.0),
    ("lost, %", "lost", ".0f", 100.0),
    ("pose error, cm", "pose_error_mean_m", ".0f", 100.0),
)
AGAINST: tuple[Column, ...] = (
    ("correct coverage over steps", HEADLINE_METRIC, "+.3f", 1.0),
    ("at the end, %", "correct_coverage", "+.1f", 100.0),
    ("lost, %", "lost", "+.0f", 100.0),
)
ON_PLANS: tuple[Column, ...] = (
    ("area under coverage over metres", "auc", ".3f", 1.0),
    ("coverage, %", "coverage", ".1f", 100.0),
    ("correct coverage, %", "correct_coverage", ".1f", 100.0),
    ("m in all", "metres", ".0f", 1.0),
    ("lost, %", "lost", ".0f", 100.0),
)
ON_PLANS_AGAINST: tuple[Column, ...] = (
    ("area under coverage over metres", "auc", "+.3f", 1.0),
    ("correct coverage, %", "correct_coverage", "+.1f", 100.0),
    ("lost, %", "lost", "+.0f", 100.0),
)
PLACE = re.compile(r"(<!-- policies: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def tables(result: Figures) -> dict[str, str]:
    """The text of each place by its name."""
    rows, setting = result["rows"], result["setting"]
    estimated = [row for row in rows if row["estimator"] == setting["estimator"]]
    return (
        task_tables()
        | learned_tables()
        | plan_tables()
        | {"suites": suite_tables(SUITE_RESULTS)}
        | {
            "where": f"{result['buildings']} buildings, `{setting['difficulty']}`, split `{setting['split']}`:",
            "short": table(measured(HEADLINE, rows, "figures"), labelled(estimated)),
            "headline": table(measured(HEADLINE, rows, "figures"), labelled(rows)),
            "differences": table(
                measured(DIFFERENCES, rows, "against_reference"), labelled(estimated, "against_reference")
            ),
            "known": table(measured(DIFFERENCES, rows, "with_the_pose_known"), labelled(rows, "with_the_pose_known")),
        }
    )


def measured(columns: Sequence[Column], rows: list[Figures], part: str) -> list[Column]:
    """The columns whose figures a result has; one of an older version has no correct coverage."""
    some = next((row[part] for row in rows if part in row), {})
    return [column for column in columns if column[1] in some]


def task_tables() -> dict[str, str]:
    """The places of the tasks: the price of uncertainty in all, and the policies in each."""
    prices, acting = (
        [json.loads(path.read_text()) for path in paths if path.exists()] for paths in (PRICE_RESULTS, ACTING_RESULTS)
    )
    lines = [price(result["setting"]["task"], policy, result["rows"]) for result in prices for policy in GREEDY]
    heads = ["task, policy", "estimator", "known correspondences", "true pose", "price"]
    places = {result["setting"]["task"].removesuffix("-v0"): of_task(result) for result in acting}
    return places | {"price": markdown_table(heads, lines)}


def of_task(result: Figures) -> str:
    """The policies in a task with the estimator: their figures, and the differences to the reference."""
    estimated = [row for row in result["rows"] if row["estimator"] == "slam"]
    where = f"{result['buildings']} buildings, split `{result['setting']['split']}`:"
    difference = f"Difference to `{result['reference']}`, in the same buildings:"
    against = table(AGAINST, labelled(estimated, "against_reference"))
    return "\n\n".join([where, table(ACTING, labelled(estimated)), difference, against])


def learned_tables() -> dict[str, str]:
    """The places of learned policies: each run, and the seeds taken together."""
    if not LEARNED_RESULT.exists():
        return {}
    learned = json.loads(LEARNED_RESULT.read_text())
    return {"learned": of_task(learned), "seeds": seeds_table(learned, AGAINST)}


def plan_tables() -> dict[str, str]:
    """The place of the real floor plans."""
    if not PLAN_RESULT.exists():
        return {}
    result = json.loads(PLAN_RESULT.read_text())
    where = f"{result['buildings']} episodes in {result['setting']['plans']} plans:"
    difference = f"Difference to `{result['reference']}`, in the same episodes:"
    against = table(ON_PLANS_AGAINST, labelled(result["rows"], "against_reference"))
    return {"plans": "\n\n".join([where, table(ON_PLANS, labelled(result["rows"])), difference, against])}


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


def updated(text: str, result: Figures) -> str:
    """A document with the tables of a result."""
    parts = tables(result)
    return PLACE.sub(lambda place: f"{place[1]}{parts.get(place[2], '')}\n{place[3]}", text)


def main() -> int:
    """Update the documents."""
    result = json.loads(RESULT.read_text())
    for path in DOCUMENTS:
        path.write_text(updated(path.read_text(), result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
