"""The commands `evaluate`, `submit` and `leaderboard`: compare policies in the same buildings, or in a benchmark."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro
from pydantic import Field

from mecp_env.cli import base
from mecp_env.cli.base import INTERRUPTED, Line, OutFolder, Steps, check_word, echo, print_error
from mecp_env.cli.options import (
    DifficultyName,
    EnvironmentFields,
    Estimator,
    Reading,
    ReadsPlans,
    SplitName,
    TaskName,
    WithModules,
    named_fields,
)
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import exists, write_atomic
from mecp_env.core.intervals import Figures
from mecp_env.core.settings import guess
from mecp_env.core.work_units import FailedUnit, KeptResults, Shard
from mecp_env.policies import report, suites
from mecp_env.policies.evaluation import Evaluation, Row, write_result
from mecp_env.policies.registry import EXPLORERS, LEARNED, OURS, make_policy, policy_names, training_hours
from mecp_env.policies.setting import Setting, plan_fields
from mecp_env.world.layout import shipped_layouts

QUICK = "active-quick-v1"
MOST_MASKED = 0.1  # of the decisions of a policy, before it is told
STEPS, TASK_STEPS = 3000, 1500  # of an episode
READING = [name for part in fields(Reading) for name in (part.name, f"no_{part.name}")]


@dataclass(frozen=True)
class Evaluate(WithModules, ReadsPlans):
    """Compare policies in the same buildings, with the same start poses and noise: tables with 95 % intervals, curves
    and, with --record, a film. A policy is bfs, nearest, next_best_view, gain, pause, returning, stachniss,
    random_goal, random_walk, maskable_ppo, the folder of a training run, or a custom class as module:Class. Finished
    episodes are kept in OUT/episodes: the same command continues after a kill. Jobs with --shard 1/4 to 4/4 divide the
    buildings; then the command without --shard combines their episodes.

    Examples:
        mecp-env evaluate bfs nearest gain --episodes 20 --jobs 2
        mecp-env evaluate nearest runs/my-training --split validation --no-truth
        mecp-env evaluate nearest my_module:MyPolicy --difficulty hard --record --out runs/hard
        mecp-env evaluate nearest returning --task ActiveHalls-v0 --known --episodes 20
        mecp-env evaluate my_module:MyPolicy --suite active-v1 --jobs 8
        mecp-env evaluate nearest gain --plans my-plans --episodes 30 --env.laser.max-range-m 8
        mecp-env evaluate gain stachniss --plans my-plans --task ActiveHalls-v0 --env.odometry.scale 2
        mecp-env evaluate bfs nearest --layout office --env.crowd.people 5 --episodes 20
        mecp-env evaluate bfs nearest --out runs/big --shard 1/4
    """

    fixes: ClassVar[Mapping[str, Sequence[str]]] = {
        "suite": (
            *("task", "plans", "layout", "env", "difficulty", "split", "episodes", "max_steps", "estimator"),
            "record",
        ),
        "plans": ("layout", "difficulty", "split"),
        "layout": ("difficulty", "split"),
        "task": ("difficulty",),
        "cluster": ("jobs",),
    }
    needs: ClassVar[Mapping[str, Sequence[str]]] = dict.fromkeys(READING, ("plans", "layout"))

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY ...")]
    split: SplitName = "test"  # of the buildings: train, validation or test
    difficulty: DifficultyName = "medium"  # easy, medium, hard or huge
    task: TaskName = ""  # a task of active SLAM in place of a difficulty: ActiveHalls-v0, ActiveCorridors-v0, ...
    # a frozen benchmark: active-v1, active-quick-v1, coverage-v1; fixes task, split, episodes and limits
    suite: str = ""
    plans: Path | None = None  # a folder of real floor plans, or one; with --task, the robot is that of the task
    layout: str = ""  # one building: a shipped name (paper, office, ...), or the file of a plan
    # buildings, one episode in each; episode i starts by the seed i, with --plans in plan i mod the number of plans
    episodes: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    jobs: Annotated[int, Field(ge=1, le=256)] = 1  # processes at the same time
    cluster: str = ""  # run the episodes on the Ray cluster at HOST:PORT (extra `cluster`), one on each of its CPUs
    shard: str = "1/1"  # run every n-th building only, from the i-th, given as i/n; the results are written without it
    estimator: Estimator = "slam"  # known: known correspondences; truth: ground-truth pose
    truth: bool = True  # run each policy once more with the ground-truth pose
    known: bool = False  # and once more with known correspondences
    record: bool = False  # a film of all policies side by side, in the first building
    reference: str = "nearest"  # the policy to which the others are compared
    trust: bool = False  # load model files (.zip of Stable-Baselines3, .pt), which may run arbitrary code
    max_steps: Steps | None = None  # of an episode (control steps of 0.4 s); by default 3000, in a task 1500
    json: Path | None = None  # also write the result there, and the page beside it
    out: OutFolder = Path("runs/policies")  # folder for results.json, page.md, episodes.csv, curves.png, the film
    env: EnvironmentFields = field(default_factory=EnvironmentFields)  # any field of the environment

    def run(self, line: Line) -> int:
        """Evaluate and write everything. 0; 1 when an episode failed, 130 after Ctrl-C with what was finished."""
        if self.suite:
            return self._run_suite(line)
        evaluation, folder = self._evaluated(self._setting(line), self.episodes, "episodes")
        if evaluation.shard.count > 1:
            echo(f"{len(evaluation.results)} episodes of shard {self.shard} are in {folder}")
        elif evaluation.results:
            self._write(evaluation, f"mecp-env evaluate {shlex.join(line)}")
        return INTERRUPTED if evaluation.interrupted else base.FAILED if evaluation.failures else 0

    def _setting(self, line: Line) -> Setting:
        """The setting of the options. Raises `MecpError` for plans that are not there."""
        limit = self.max_steps or (TASK_STEPS if self.task else STEPS)
        changes = named_fields(self.env, line, "--env.")
        setting = Setting(self.difficulty, self.split, self.estimator, limit, self.task, env=changes)
        if self.plans is None and not self.layout:
            return setting
        return replace(setting, difficulty="", split="", **self._place())

    def _place(self) -> dict[str, Any]:
        """The fields of a setting for the plans, or the layout. Raises `MecpError` where there is none."""
        known = shipped_layouts()
        if self.layout in known:
            return {"layout": self.layout, "plans": 1, "content": self.layout}
        if self.plans is None and not exists(self.layout):
            raise ConfigError(
                f"layout: {self.layout!r:.80}, expected a file, or one of {', '.join(known)}"
                f"{guess(self.layout, known)}; --difficulty selects generated buildings"
            )
        return plan_fields(self.plans or Path(self.layout), self.reading.options())

    def _run_suite(self, line: Line) -> int:
        """Evaluate the policies in every setting of the suite, and write one file."""
        for name in self.policies:
            suites.check_name(name, "policies")
        done = self.suite_rows()
        if isinstance(done, int):
            return done
        if Shard.parse(self.shard).count > 1:
            echo(f"the episodes of shard {self.shard} are in {self.out}; the command without --shard writes the result")
            return 0
        result = suites.submission(self.suite, done, f"mecp-env evaluate {shlex.join(line)}")
        write_submission(result, self.json or self.out / f"{self.suite}.json")
        return 0

    def suite_rows(self) -> list[tuple[Setting, list[Row]]] | int:
        """The rows of every setting of the suite; an exit code where an episode failed, or after Ctrl-C."""
        suite, done = suites.find_suite(self.suite), []
        for setting in suite.settings:
            evaluation, _ = self._evaluated(setting, suite.episodes, setting.task or setting.difficulty)
            if evaluation.interrupted:
                return INTERRUPTED
            if evaluation.failures:
                print_error(f"{len(evaluation.failures)} episodes failed: no result; the same command repeats them")
                return base.FAILED
            done.append((setting, evaluation.rows()))
            report_masked(evaluation)
        return done

    def _evaluated(self, setting: Setting, episodes: int, name: str) -> tuple[Evaluation, Path]:
        """All episodes in a setting, or those of a shard, and the folder below `out` where they are kept."""
        parts = (self.policies, setting, episodes, self.truth, self.known, self.reference, self.trust)
        evaluation = Evaluation(*parts, Shard.parse(self.shard))
        self._check(evaluation)
        kept = evaluation.kept(self.out / name)
        collect(evaluation, kept, self.jobs, self.cluster)
        return evaluation, kept.folder

    def _check(self, evaluation: Evaluation) -> None:
        """Raise `MecpError` for wrong policies or a wrong setting, before anything is written."""
        if not self.policies:
            raise ConfigError(f"policies: expected at least one of {', '.join(policy_names())}, or a run folder")
        check_word("reference", self.reference, dict.fromkeys((*self.policies, *EXPLORERS)))
        policies = [make_policy(name, self.trust) for name in self.policies]
        if self.suite:
            suites.refuse_changes(self.policies, policies)
        if self.reference not in self.policies:
            print_error(f"{self.reference} is not among the policies, so nothing is compared to it")
        for name in evaluation.unrepeatable(policies):
            print_error(
                f"{name} acted differently when the beginning of an episode was repeated, so its score may be one of "
                "chance: let reset(seed) set back all that act remembers, and draw random numbers from that seed"
            )
        evaluation.check_buildings(policies)
        if self.json is not None:
            base.check_json(self.json, "json")

    def _write(self, evaluation: Evaluation, command: str) -> None:
        """Write figures, page, episodes, curves and the film; print a short table."""
        rows = evaluation.rows()
        report_masked(evaluation)
        if not rows:
            print_error("no building was finished by every policy: nothing to compare")
            return
        result = evaluation.figures(rows, command)
        text = report.page(result)
        write_result(result, text, self.out / "results.json", self.out / "page.md")
        evaluation.write_episodes(self.out / "episodes.csv")
        if self.json is not None:
            write_result(result, text, self.json, self.json.with_suffix(".md"))
        self._draw(result, evaluation)
        echo(*report.overview(result), "", f"all tables: {self.out / 'page.md'}; written to {self.out}")

    def _draw(self, result: Figures, evaluation: Evaluation) -> None:
        """Draw the curves, and the film."""
        where = f"{result['buildings']} buildings, {self.task or self.difficulty}, {self.split} split"
        if evaluation.setting.layout:
            where = f"{result['buildings']} episodes, {Path(evaluation.setting.place).name}"
        report.draw_curves(result["rows"], f"{where}; bands: 95 % intervals of the mean", self.out / "curves.png")
        if self.record:
            names = list(dict.fromkeys(self.policies))
            report.write_film(names, evaluation.setting, self.out / "side_by_side.gif", self.trust)


def write_submission(result: dict[str, Any], path: Path) -> None:
    """Write the result of a suite, and print its table with the reference rows of the package."""
    write_atomic(path, (json.dumps(result, indent=1) + "\n").encode())
    table = suites.leaderboard({path.name: result}, references=suites.reference_rows(result["suite"], result["hash"]))
    echo(*table.split("\n"), f"written to {path}")


def collect(evaluation: Evaluation, kept: KeptResults, jobs: int, cluster: str) -> None:
    """Run all episodes, with a progress bar; after Ctrl-C the finished ones are in `evaluation`."""
    with closing(evaluation.run(kept, jobs, cluster)) as results:
        try:
            finished = base.tracked(results, len(evaluation.tasks()), "episodes")
            for failure in (result for result in finished if isinstance(result, FailedUnit)):
                print_error(f"failed: {failure}")
        except KeyboardInterrupt:
            evaluation.interrupted = True
            print_error("interrupted; the same command continues")


def report_masked(evaluation: Evaluation) -> None:
    """Print which policies often chose rows that were not offered: their score is that of another policy."""
    for name in dict.fromkeys(evaluation.policies):
        figures = [result.figures for result in evaluation.results if result.task.policy == name]
        chosen, masked = (sum(each[part] for each in figures) for part in ("decisions", "masked"))
        if masked > MOST_MASKED * chosen:
            print_error(
                f"{name} chose an empty row in {masked / chosen:.0%} of its decisions; each became a drive to the "
                "nearest goal, so its score is partly that of `nearest`; use masks"
            )


@dataclass(frozen=True)
class Leaderboard(base.Command):
    """One table of results of `mecp-env submit` or `mecp-env evaluate --suite` and the package's reference rows, the
    best policy first. A file of another suite, of another version of it, or one that was changed, is refused.

    Examples:
        mecp-env leaderboard
        mecp-env leaderboard runs/mine-active-quick-v1.json
        mecp-env leaderboard runs/mine/active-v1.json results/others.json --metric lost
    """

    files: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE ...")] = ()
    metric: str = "correct_over_steps"  # or correct_over_metres, correct_coverage, auc, coverage, lost, complete
    suite: str = ""  # by default that of the files, without files active-quick-v1
    references: bool = True  # with the reference rows of the package

    def run(self, line: Line) -> int:
        """Print the table."""
        check_word("metric", self.metric, suites.METRICS)
        found = {str(path): suites.read_submission(path) for path in self.files}
        suite = self._suite([content["suite"] for content in found.values()])
        rows = suites.reference_rows(suite, suites.SUITES[suite].frozen) if self.references else []
        if not found and not rows:
            raise ConfigError(f"files: expected at least one result; the package has no reference rows of {suite}")
        echo(f"{suite}, {self.metric}", "", *suites.leaderboard(found, self.metric, rows).split("\n"))
        return 0

    def _suite(self, named: Sequence[str]) -> str:
        """The suite of the files and of the option. Raises `ConfigError` for several, and for an unknown one."""
        name, *others = sorted({*named, *filter(None, [self.suite])}) or [QUICK]
        if others:
            raise ConfigError(f"files: of several suites ({', '.join([name, *others])}); one table shows one")
        return check_word("suite", name, suites.SUITES)


@dataclass(frozen=True)
class Submit(WithModules):
    """Score one policy in a frozen benchmark, write its result file, and show it beside the reference rows. A policy is
    a shipped name, the folder of a training run, a custom class as module:Class, a model file of Stable-Baselines3
    (.zip), or TorchScript (.pt) or ONNX (.onnx) with a JSON file beside it (docs/submissions.md). Finished episodes are
    kept beside the file: the same command continues after a kill.

    Examples:
        mecp-env submit my_module:MyPolicy --quick --jobs 2
        mecp-env submit model.zip --trust --quick --name my-ppo --hours 2
        mecp-env submit runs/my-training --suite active-v1 --jobs 8 --out results/mine.json
    """

    fixes: ClassVar[Mapping[str, Sequence[str]]] = {"quick": ("suite",)}

    policy: Annotated[str, tyro.conf.Positional]
    suite: str = "active-v1"  # a frozen benchmark: active-v1, active-quick-v1 or coverage-v1
    quick: bool = False  # the suite active-quick-v1: 20 episodes, a few minutes
    trust: bool = False  # load model files (.zip of Stable-Baselines3, .pt), which may run arbitrary code
    name: str = ""  # of the row in tables; by default the name of the policy, of its file or its folder
    # of training; by default those of a run folder
    hours: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] | None = None  # trainings that the policy was chosen from
    jobs: Annotated[int, Field(ge=1, le=256)] = 1  # processes at the same time
    out: Path | None = None  # file of the result; by default runs/NAME-SUITE.json

    def run(self, line: Line) -> int:
        """Run all episodes and write the file. 0; 1 when an episode failed, 130 after Ctrl-C."""
        suite, name = QUICK if self.quick else self.suite, self._name()
        path = base.check_json(self.out or Path("runs") / f"{re.sub('[/:]', '-', f'{name}-{suite}')}.json", "out")
        options = {"truth": False, "reference": self.policy, "trust": self.trust, "jobs": self.jobs}
        done = Evaluate((self.policy,), suite=suite, out=path.with_suffix(""), **options).suite_rows()  # type: ignore[arg-type]
        if isinstance(done, int):
            return done
        named = [(setting, [replace(row, policy=name) for row in rows]) for setting, rows in done]
        training = suites.Training(training_hours(self.policy) if self.hours is None else self.hours, self.seeds)
        write_submission(suites.submission(suite, named, f"mecp-env submit {shlex.join(line)}", training), path)
        return 0

    def _name(self) -> str:
        """The name of the row. Raises `ConfigError` for one that forges a row, or is that of another policy."""
        path = Path(self.policy)
        default = (path.stem if path.is_file() else path.name) if path.exists() else self.policy
        name = suites.check_name(self.name or default)
        if name in (*OURS, *LEARNED) and name != self.policy:
            raise ConfigError(f"name: {name!r} is the name of a policy of this package; choose another with --name")
        return name
