"""Uncertainty: quality over odometry noise and over laser range, of policies with three estimators.

The environment is a task of active SLAM, in the first buildings of its split `test`, with one field changed at each
point: `odometry.scale` multiplies the sigmas of the odometry (the share of steps with slip stays), and
`laser.max_range_m` is the range. Each policy explores the same buildings from the same starts with the full estimator,
with known correspondences, and with the true pose. Quality is the area under the correct coverage over the control
steps. The price of uncertainty is that of the true pose minus that of the estimator, the price of wrong
correspondences that of known ones minus that of the estimator, paired by building. So is what a policy gains, with the
full estimator, over the greedy one, `next_best_view`. An episode is lost as in docs/policies.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from matplotlib.figure import Figure

from benchmarks.common import Figures, OptionError, Options, chosen, estimate, in_parallel, share
from benchmarks.plots import Panel, panel_rows
from benchmarks.tables import one_table, sections
from mecp_env.core.settings import guess
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.evaluation import Evaluation, Row
from mecp_env.policies.registry import make_policy
from mecp_env.policies.report import cell
from mecp_env.policies.rollout import EpisodeResult, run_episode
from mecp_env.policies.setting import Setting
from mecp_env.world.config import SPLITS

TASK = "ActiveHalls-v0"
POLICIES = ("nearest", "next_best_view", "gain", "pause", "returning", "stachniss")
ESTIMATORS = {"slam": "estimator", "known": "known correspondences", "truth": "true pose"}
BASE = "base"  # the task as it is
SCALES, RANGES_M = (2.0, 4.0, 8.0), (3.0, 5.0, 8.0, 30.0)
CHANGES: dict[str, dict[str, Any]] = {  # point -> what differs from the task
    BASE: {},
    **{f"odometry_x{scale:g}": {"odometry": {"scale": scale}} for scale in SCALES},
    **{f"range_{metres:g}_m": {"laser": {"max_range_m": metres}} for metres in RANGES_M},
}
BUILDINGS, QUICK_BUILDINGS = 50, 1
MOST = len(SPLITS["test"])  # buildings
SETS = tuple(CHANGES)
QUICK = (BASE, "odometry_x8")
METRIC = "correct_over_steps"
KEPT = (METRIC, "correct_coverage", "coverage", "lost", "pose_error_mean_m", "map_rmse_m")
GREEDY = "next_best_view"  # to which the others are compared
PRICES = {"price": ("truth", "slam"), "price_known": ("known", "slam")}
DIFFERENCES = {  # heading of each; `over` only where the greedy policy is one of them
    "price": "price of uncertainty",
    "price_known": "price of wrong correspondences",
    "over": f"over `{GREEDY}`",
}


def checked(policies: Sequence[str]) -> tuple[str, ...]:
    """The names of policies, each once. Raises `ConfigError` for an unknown one."""
    for policy in policies:
        make_policy(policy)
    return tuple(dict.fromkeys(policies))


def buildings_of(options: Options, settings: Iterable[str], each: int) -> Mapping[str, int]:
    """Number of buildings in each setting, or in those of --sets. Raises `OptionError` for more than the split has."""
    if options.buildings > MOST:
        raise OptionError(f"--buildings {options.buildings}: the split has {MOST}")
    return chosen(options, dict.fromkeys(settings, options.buildings or each), most=MOST)


def rows_of(evaluations: Mapping[str, Evaluation], options: Options) -> dict[str, list[Row]]:
    """The rows of each evaluation, which has all its episodes then."""
    tasks = [(name, task) for name, of in evaluations.items() for task in of.tasks()]
    units = {f"{name} {task.setting.name} {task.name}": task for name, task in tasks}
    for (name, _), result in zip(tasks, in_parallel(run_episode, EpisodeResult, units, options), strict=True):
        evaluations[name].results.append(result)
    return {name: of.rows() for name, of in evaluations.items()}


def run(options: Options) -> Figures:
    """Results of every point, policy and estimator.

    Raises `OptionError` for an unknown task, `ConfigError` for an unknown policy.
    """
    task = options.task or TASK
    if task not in TASKS:
        raise OptionError(f"--task {task}: expected one of {', '.join(TASKS)}{guess(task, TASKS)}")
    policies = checked(options.policies or POLICIES)
    points = QUICK if options.quick and not options.sets else CHANGES
    counts = buildings_of(options, points, QUICK_BUILDINGS if options.quick else BUILDINGS)
    setting = Setting("", "test", "slam", TASKS[task]["max_steps"], task)
    evaluations = {
        point: Evaluation(policies, replace(setting, env=CHANGES[point]), buildings, known_correspondences=True)
        for point, buildings in counts.items()
    }
    of_points = {point: of_policies(rows) for point, rows in rows_of(evaluations, options).items()}
    return {"task": task, "range_m": range_of(task), "points": of_points}


def range_of(task: str) -> float:
    """The range of the laser of a task, m."""
    return float(TASKS[task]["laser"]["max_range_m"])


def of_policies(rows: Sequence[Row]) -> Figures:
    """Results of each policy at one point: each estimator, the prices, and the gain over the greedy one, if there."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        found.setdefault(row.policy, {})[row.estimator] = row
    figures: Figures = {}
    for policy, of in found.items():
        score = {name: row.values(METRIC) for name, row in of.items()}
        gains = {name: score[more] - score[less] for name, (more, less) in PRICES.items()}
        if GREEDY in found:
            gains["over"] = score["slam"] - found[GREEDY]["slam"].values(METRIC)
        figures[policy] = {name: figures_of(of[name]) for name in ESTIMATORS}
        figures[policy] |= {name: estimate(gain) for name, gain in gains.items()}
    return figures


def figures_of(row: Row) -> Figures:
    """The metrics of a policy with one estimator."""
    return {name: estimate(row.values(name)) for name in KEPT} | {"lost": share(row.values("lost") > 0.5)}


def report(figures: Figures) -> str:
    """One table per point with one row per policy."""
    parts = {}
    for point, policies in figures["points"].items():
        count = next(iter(policies.values()))["price"]["n"]
        title = f"{title_of(point, figures['range_m'])}, {count} building{'s' * (count > 1)}"
        parts[title] = one_table({policy: row_of(of) for policy, of in policies.items()})
    return f"Task: `{figures['task']}`.\n\n{sections(parts)}"


def row_of(found: Figures) -> dict[str, str]:
    """The cells of a policy by their headings."""
    qualities = {title: cell(found[name][METRIC], ".3f") for name, title in ESTIMATORS.items()}
    lost = {f"lost, {title}, %": cell(found[name]["lost"], ".0f", 100.0) for name, title in ESTIMATORS.items()}
    return qualities | lost | {title: cell(found[key], "+.3f") for key, title in DIFFERENCES.items() if key in found}


def title_of(point: str, range_m: float) -> str:
    """What a point changes, in words."""
    scale = CHANGES[point].get("odometry", {}).get("scale", 1.0)
    metres = CHANGES[point].get("laser", {}).get("max_range_m", range_m)
    return f"Odometry noise x{scale:g}, range {metres:g} m"


def axes_of(figures: Figures) -> dict[str, dict[str, str]]:
    """Of the figure: the name of each axis with its points and their labels, in order."""
    ranges = {metres: f"range_{metres:g}_m" for metres in RANGES_M} | {figures["range_m"]: BASE}
    axes = {
        "odometry noise": {BASE: "x1"} | {f"odometry_x{scale:g}": f"x{scale:g}" for scale in SCALES},
        "laser range": {point: f"{metres:g} m" for metres, point in sorted(ranges.items())},
    }
    there = {axis: {p: label for p, label in of.items() if p in figures["points"]} for axis, of in axes.items()}
    return {axis: labels for axis, labels in there.items() if labels}


def figure(figures: Figures) -> Figure:
    """A row per axis: all policies with each estimator."""
    points = figures["points"]
    rows: dict[str, dict[str, Panel]] = {}
    for axis, labels in axes_of(figures).items():
        for key, title in ESTIMATORS.items():
            lines = {name: [points[p][name][key][METRIC] for p in labels] for name in next(iter(points.values()))}
            rows.setdefault(axis, {})[title] = Panel(list(labels.values()), lines)
    return panel_rows(rows, "correct coverage over steps")
