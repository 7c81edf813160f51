"""Policies compared in the same buildings, from the same start poses: episodes, and one row of metrics per policy.

Everything is measured in metres and simulated time, so that every machine gives the same result. Metrics have 95 %
intervals, and differences are paired by building. Trainings that differ in their seed only are taken together.
"""

from __future__ import annotations

import csv
import json
import platform
import re
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.intervals import BUDGET_M_PER_M2, Figures, estimate, over_runs, ratio, share
from mecp_env.core.provenance import checksums, dependencies
from mecp_env.core.work_units import WHOLE, FailedUnit, KeptResults, Shard, run_kept
from mecp_env.policies.registry import Policy, policy_checksum, source_of
from mecp_env.policies.rollout import EpisodeResult, EpisodeTask, first_actions, make_rooms, run_episode
from mecp_env.policies.setting import Setting, plan_names

MEANS = (
    *("correct_over_steps", "correct_over_metres", "correct_coverage"),
    *("auc", "metres_to_90%", "metres_to_99%", "periods_to_90%", "periods_to_99%", "coverage", "metres", "periods"),
    *("decisions", "reward", "pose_error_mean_m", "pose_error_final_m", "log_det_mean", "map_rmse_m"),
    *("landmarks", "landmarks_false", "duplicates", "contacts"),
)
SHARES = ("reached_90%", "reached_99%", "complete", "terminated", "lost", "diverged")
COMPARED = (
    *("correct_over_steps", "correct_over_metres", "correct_coverage", "lost"),
    *("auc", "metres_to_90%", "metres_to_99%", "periods_to_90%", "pose_error_final_m", "complete"),
)
KNOWN = {"truth": "with_the_pose_known", "known": "with_known_correspondences"}  # what is known: key of the difference
NUMBERED = re.compile(r"^(.+)-\d+$")  # a run among several that differ in their seed
SHARES_OF_BUDGET: Array = np.linspace(0.0, 1.5, 61)  # where the mean curve is evaluated


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """The episodes of one policy with one estimator, in the order of the buildings."""

    policy: str
    estimator: str
    episodes: tuple[EpisodeResult, ...]

    def values(self, name: str) -> Array:
        """(n,) one metric, building by building."""
        return np.array([episode.figures[name] for episode in self.episodes])

    def curves(self) -> Array:
        """(n,61) the coverage of each building at shares of its budget of metres."""
        return np.array([e.curve.at(SHARES_OF_BUDGET * e.figures["budget_m"]) for e in self.episodes])


def rows_of(episodes: Iterable[EpisodeResult], order: Sequence[tuple[str, str]]) -> list[Row]:
    """A row per policy and estimator of `order`, over the buildings that all those with any episode have finished."""
    found: dict[tuple[str, str], dict[int, EpisodeResult]] = {key: {} for key in order}
    for episode in episodes:
        found[episode.task.policy, episode.task.setting.estimator][episode.task.building] = episode
    started = {key: results for key, results in found.items() if results}
    common = sorted(set.intersection(*map(set, started.values()))) if started else []
    return [Row(*key, tuple(results[building] for building in common)) for key, results in started.items() if common]


def figures_of(row: Row) -> Figures:
    """All metrics of a row."""
    figures: Figures = {name: estimate(row.values(name)) for name in MEANS}
    figures |= {name: share(row.values(name) > 0.5) for name in SHARES}
    if row.estimator == "truth":
        figures["log_det_mean"] = estimate([])  # a known pose has no covariance
    return figures | {
        "rooms_found": ratio(row.values("rooms_found"), row.values("rooms")),
        "doors_found": ratio(row.values("doors_found"), row.values("doors")),
        "contacts_per_100_m": ratio(100.0 * row.values("contacts"), row.values("metres")),
    }


def difference(row: Row, other: Row) -> Figures:
    """`row` minus `other` in the same buildings: means of paired differences with their intervals."""
    return {name: estimate(row.values(name) - other.values(name)) for name in COMPARED}


def compared(row: Row, rows: Sequence[Row], reference: str) -> Figures:
    """A row as JSON data: its metrics, its difference to the reference, and the cost of uncertainty.

    The reference is the row of that policy with the same estimator; the cost of uncertainty, in rows with
    `estimator="truth"`, is that row minus the row of the same policy without the ground-truth pose; the cost of wrong
    correspondences, in rows with `estimator="known"`, likewise.
    """
    page: Figures = {"policy": row.policy, "estimator": row.estimator, "figures": figures_of(row)}
    first = next((other for other in rows if (other.policy, other.estimator) == (reference, row.estimator)), row)
    if first is not row:
        page["against_reference"] = difference(row, first)
    estimated = next((other for other in rows if other.policy == row.policy), row)
    if estimated is not row and row.estimator in KNOWN:
        page[KNOWN[row.estimator]] = difference(row, estimated)
    return page | {"curve": [estimate(column) for column in row.curves().T]}


def timing(rows: Sequence[Row]) -> dict[str, float]:
    """Decisions per second of CPU time, by policy: the only figures that another run does not repeat."""
    rates: dict[str, float] = {}
    for row in rows:
        seconds = sum(episode.act_s for episode in row.episodes)
        rates.setdefault(row.policy, float(row.values("decisions").sum() / max(seconds, 1e-9)))
    return rates


def seeds_of(rows: Sequence[Row]) -> list[Figures]:
    """A part for each group of runs `NAME-0`, `NAME-1`, ...: `policy` (`NAME-*`), `seeds`, `figures`, `differences`.

    `differences`, by the name of another group or policy, are means of the runs minus that, in the same buildings, with
    intervals over runs and buildings. Only rows of one estimator, which the caller selects, can be compared.
    """
    together = by_name(rows)
    return [
        {
            "policy": name,
            "estimator": runs[0].estimator,
            "seeds": len(runs),
            "figures": differences(runs),
            "differences": {other: differences(runs, row) for other, row in together.items() if other != name},
        }
        for name, runs in together.items()
        if len(runs) > 1
    ]


def by_name(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows under `NAME-*` where two or more are called `NAME-NUMBER`, the others under their own names."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(NUMBERED.sub(r"\1-*", row.policy), []).append(row)
    return {name if len(runs) > 1 else runs[0].policy: runs for name, runs in found.items()}


def differences(runs: Sequence[Row], others: Sequence[Row] = ()) -> Figures:
    """The compared metrics: mean of the runs, minus that of the others where there are any."""

    def table(rows: Sequence[Row], name: str) -> Any:
        return np.stack([row.values(name) for row in rows]) if rows else None

    return {name: over_runs(table(runs, name), table(others, name)) for name in COMPARED}


@dataclass(slots=True, eq=False)
class Evaluation:
    """The policies, where they are compared, and the episodes that are finished."""

    policies: tuple[str, ...]
    setting: Setting
    episodes: int  # buildings, one episode in each
    known_pose: bool = True  # each policy once more with the ground-truth pose
    known_correspondences: bool = False  # and once more with known correspondences
    reference: str = "nearest"  # the policy to which the others are compared
    trust: bool = False  # load model files that may run arbitrary code
    shard: Shard = WHOLE  # of the buildings
    results: list[EpisodeResult] = field(default_factory=list)
    failures: list[FailedUnit] = field(default_factory=list)
    interrupted: bool = False

    @property
    def settings(self) -> list[Setting]:
        """One per estimator."""
        wanted = {"known": self.known_correspondences, "truth": self.known_pose}
        others = [name for name, on in wanted.items() if on and name != self.setting.estimator]
        return [self.setting, *(replace(self.setting, estimator=name) for name in others)]

    def tasks(self) -> list[EpisodeTask]:
        """All episodes, building by building: after an interruption, the finished ones can be compared."""
        checksums = {name: policy_checksum(name) for name in self.policies}
        return [
            EpisodeTask(name, building, setting, self.trust, checksum, source_of(name))
            for building in self.shard.part(range(self.episodes))
            for setting in self.settings
            for name, checksum in checksums.items()
        ]

    def kept(self, folder: Path) -> KeptResults:
        """The finished episodes in a folder. Raises `ConfigError` for those of other code or another setting."""
        return KeptResults(folder, EpisodeResult, {**self.setting.run_key(), **dependencies(), **checksums()})

    def run(self, kept: KeptResults, jobs: int, cluster: str = "") -> Generator[EpisodeResult | FailedUnit]:
        """Each episode: first those that are kept already, then the others as they are finished (see `run_kept`)."""
        tasks = {task.name: task for task in self.tasks()}
        with closing(run_kept(run_episode, tasks, kept, jobs, cluster)) as finished:
            for _, result in finished:
                (self.failures if isinstance(result, FailedUnit) else self.results).append(result)
                yield result

    def rows(self) -> list[Row]:
        """One row per policy and estimator, over the buildings that all of them have finished."""
        names = dict.fromkeys(self.policies)
        return rows_of(self.results, [(name, setting.estimator) for setting in self.settings for name in names])

    def unrepeatable(self, policies: Sequence[Policy]) -> list[str]:
        """The names of the policies that act differently when the beginning of an episode is repeated.

        Raises `MecpError` for a wrong setting, a first plan that cannot be read, or a policy whose first actions fail.
        """
        found = []
        for name, policy in zip(self.policies, policies, strict=True):
            env = make_rooms(self.setting, policy)
            first, again = (first_actions(env, policy, name) for _ in range(2))
            if not all(map(np.array_equal, first, again)):
                found.append(name)
            env.close()
        return found

    def check_buildings(self, policies: Sequence[Policy]) -> None:
        """Raise `MecpError` for too many generated buildings."""
        if self.setting.layout or not policies:
            return
        env = make_rooms(self.setting, policies[0])
        try:
            env.reset(seed=0, options={"building": self.episodes - 1})
        except ConfigError as error:
            raise ConfigError(
                f"episodes: {self.episodes}, each in a building of {self.setting.split!r}; {error}"
            ) from None
        env.close()

    def figures(self, rows: Sequence[Row], command: str) -> Figures:
        """The result as JSON data. Apart from date, command and `timing`, every repetition gives the same."""
        return {
            "date": datetime.now(UTC).date().isoformat(),
            "command": command,
            "system": f"{platform.system()} {platform.machine()}, python {platform.python_version()}",
            "setting": self.setting.named(),
            "plans": plan_names(self.setting)[: self.episodes],
            "budget_m_per_m2": BUDGET_M_PER_M2,
            "reference": self.reference,
            "buildings": len(rows[0].episodes),
            "interrupted": self.interrupted,
            "failures": sorted(str(failure) for failure in self.failures),
            "rows": [compared(row, rows, self.reference) for row in rows],
            "seeds": seeds_of([row for row in rows if row.estimator == self.setting.estimator]),
            "timing": timing(rows),
        }

    def write_episodes(self, path: Path) -> None:
        """Write one CSV row per episode, in the order of policy, estimator and building."""
        ordered = sorted(self.results, key=lambda e: (e.task.policy, e.task.setting.estimator, e.task.building))
        with path.open("w", encoding="utf-8", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(["policy", "estimator", "building", *ordered[0].figures])
            for result in ordered:
                task = result.task
                lines.writerow([task.policy, task.setting.estimator, task.building, *result.figures.values()])


def write_result(figures: Figures, text: str, json_path: Path, page_path: Path) -> None:
    """Write the figures as JSON, and the page, each whole or not at all."""
    write_atomic(json_path, (json.dumps(figures, indent=1) + "\n").encode())
    write_atomic(page_path, text.encode())
