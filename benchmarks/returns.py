"""Returns: does what a policy is paid rank policies as the metric does?

Each policy explores the same buildings of the split `test` from the same starts, with the default reward of the task.
The metric is the mean over the step limit of coverage, or of correct coverage in the tasks of active SLAM. `tau` is
Kendall's rank correlation of mean return and mean metric over the policies, `tau_apart` that over the pairs whose
difference in the metric, paired by building, has an interval without 0 (`pairs_apart`, of all pairs). `r` is Pearson's
correlation over all episodes of all policies. `random_of_nearest` is the return of the random policy as a share of that
of `nearest`, beside the same share of the metric. The benchmark fails where a policy that is better by the metric is
worse by the return, both with intervals without 0.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.stats import kendalltau

from benchmarks.common import Figures, Options, correlation, estimate, ratio
from benchmarks.tables import one_table
from benchmarks.uncertainty import buildings_of, checked, rows_of
from mecp_env.core.carriers import Array
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.evaluation import Evaluation, Row
from mecp_env.policies.report import cell
from mecp_env.policies.setting import Setting

GOALS = ("random_goal", "nearest", "gain", "next_best_view", "maskable_ppo")
ACTING = ("returning", "stachniss")  # read predictions, which only the tasks of active SLAM show
VELOCITIES = ("standing", "random_walk")
SETTINGS: dict[str, Setting] = {
    "First": Setting("easy", "test", "slam", 500),
    **{name: Setting(name, "test", "slam", 3000) for name in ("easy", "medium", "hard")},
    **{name: Setting("", "test", "slam", fields["max_steps"], name) for name, fields in TASKS.items()},
}
SETS = tuple(SETTINGS)
BUILDINGS, QUICK_BUILDINGS = 20, 2
COVERAGE, CORRECT = "coverage_over_steps", "correct_over_steps"
REFERENCE, RANDOM = "nearest", "random_goal"
AGREEMENT = ("tau", "tau_apart", "pairs_apart", "r", "random_of_nearest", "random_of_nearest_metric")


def run(options: Options) -> Figures:
    """The figures of each task."""
    counts = buildings_of(options, SETTINGS, QUICK_BUILDINGS if options.quick else BUILDINGS)
    evaluations = {
        name: Evaluation(policies_of(name, options), SETTINGS[name], buildings, known_pose=False)
        for name, buildings in counts.items()
    }
    return {"tasks": {name: summarise(name, rows) for name, rows in rows_of(evaluations, options).items()}}


def policies_of(name: str, options: Options) -> tuple[str, ...]:
    """The policies that apply in a task. Raises `ConfigError` for an unknown one."""
    return checked(options.policies or (*GOALS, *(ACTING if name in TASKS else ()), *VELOCITIES))


def summarise(name: str, rows: list[Row]) -> Figures:
    """How return and metric agree in a task."""
    returns = {row.policy: row.values("reward") for row in rows}
    metric = {row.policy: row.values(CORRECT if name in TASKS else COVERAGE) for row in rows}
    pairs = list(combinations(returns, 2))
    ways = {pair: [way(of[pair[0]] - of[pair[1]]) for of in (returns, metric)] for pair in pairs}
    apart = [pair for pair in pairs if ways[pair][1][1]]  # whose metric differs for sure
    agree = {pair: ways[pair][0][0] * ways[pair][1][0] > 0.0 for pair in apart}
    means = [[of[policy].mean() for of in (returns, metric)] for policy in returns]
    figures: Figures = {
        "policies": {
            policy: {"return": estimate(returns[policy]), "metric": estimate(metric[policy])} for policy in returns
        },
        "tau": float(kendalltau(*np.array(means).T)[0]) if len(means) > 1 else 1.0,
        "tau_apart": float(np.mean([1.0 if agree[pair] else -1.0 for pair in apart])) if apart else 1.0,
        "pairs_apart": [len(apart), len(pairs)],
        "r": correlation(np.stack(list(returns.values())), np.stack(list(metric.values()))),
        "contradictions": [list(pair) for pair in apart if ways[pair][0][1] and not agree[pair]],
    }
    if REFERENCE in returns and RANDOM in returns:
        figures["random_of_nearest"] = ratio(returns[RANDOM], returns[REFERENCE])
        figures["random_of_nearest_metric"] = ratio(metric[RANDOM], metric[REFERENCE])
    return figures


def way(difference: Array) -> tuple[float, bool]:
    """The mean of a paired difference, and whether its 95 % interval is without 0; one building has no interval."""
    found = estimate(difference)
    return float(difference.mean()), found["n"] > 1 and bool(found["low"] > 0.0 or found["high"] < 0.0)


def faults(figures: Figures) -> list[str]:
    """The pairs that the return puts in the wrong order."""
    return [
        f"{name}: the metric puts {first} and {second} in another order than the return"
        for name, task in figures["tasks"].items()
        for first, second in task["contradictions"]
    ]


def report(figures: Figures) -> str:
    """How they agree in each task, and the returns of all policies."""
    tasks = figures["tasks"]
    agreement = {name: {key: task[key] for key in AGREEMENT if key in task} for name, task in tasks.items()}
    returns: dict[str, Figures] = {}
    for name, task in tasks.items():
        for policy, of in task["policies"].items():
            both = f"{cell(of['return'], '.3f')} / {of['metric']['value']:.3f}"
            returns.setdefault(policy, {})[name] = both
    return f"{one_table(agreement)}\n\n## Return / metric by policy and task\n\n{one_table(returns)}"
