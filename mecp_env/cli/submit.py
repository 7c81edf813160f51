"""`mecp-env submit`: one policy in a frozen benchmark, and the file of its result.

`mecp-env leaderboard`: the table of results of a frozen benchmark.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from pydantic import Field

from mecp_env.cli.base import Command, check_writable
from mecp_env.cli.exit_codes import echo
from mecp_env.cli.options import WithModules
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess

QUICK = "active-quick-v1"


@dataclass(frozen=True)
class Leaderboard(Command):
    """One table of results of `mecp-env submit` or `mecp-env evaluate --suite` and the package's reference rows, the
    best policy first. A file of another suite, of another version of it, or one that was changed, is refused."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env leaderboard",
        "mecp-env leaderboard runs/mine-active-quick-v1.json",
        "mecp-env leaderboard runs/mine/active-v1.json results/others.json --metric lost",
    )

    files: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE ...")] = ()
    metric: str = "correct_over_steps"  # or correct_over_metres, correct_coverage, auc, coverage, lost, complete
    suite: str = ""  # by default that of the files, without files active-quick-v1
    references: bool = True  # with the reference rows of the package

    def run(self, line: Sequence[str]) -> int:
        """Print the table."""
        from mecp_env.policies.leaderboard import reference_rows
        from mecp_env.policies.suites import METRICS, SUITES, leaderboard, read_submission

        if self.metric not in METRICS:
            raise ConfigError(f"metric: {self.metric!r:.80}, expected one of {', '.join(METRICS)}")
        found = {str(path): read_submission(path) for path in self.files}
        suite = self._suite([content["suite"] for content in found.values()])
        rows = reference_rows(suite, SUITES[suite].frozen) if self.references else []
        if not found and not rows:
            raise ConfigError(f"files: expected at least one result; the package has no reference rows of {suite}")
        echo(f"{suite}, {self.metric}", "", *leaderboard(found, self.metric, rows).split("\n"))
        return 0

    def _suite(self, named: Sequence[str]) -> str:
        """The suite of the files and of the option. Raises `ConfigError` for several, and for an unknown one."""
        from mecp_env.policies.suites import SUITES

        suites = sorted({*named, *([self.suite] if self.suite else [])}) or [QUICK]
        if len(suites) > 1:
            raise ConfigError(f"files: of several suites ({', '.join(suites)}); one table shows one")
        if suites[0] not in SUITES:
            raise ConfigError(
                f"suite: {suites[0]!r:.80}, expected one of {', '.join(SUITES)}{guess(suites[0], SUITES)}"
            )
        return suites[0]


@dataclass(frozen=True)
class Submit(WithModules):
    """Score one policy in a frozen benchmark, write its result file, and show it beside the reference rows. A policy is
    a shipped name, the folder of a training run, a custom class as module:Class, a model file of Stable-Baselines3
    (.zip), or TorchScript (.pt) or ONNX (.onnx) with a JSON file beside it (docs/submissions.md). Finished episodes are
    kept beside the file: the same command continues after a kill."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env submit my_module:MyPolicy --quick --jobs 2",
        "mecp-env submit model.zip --trust --quick --name my-ppo --hours 2",
        "mecp-env submit runs/my-training --suite active-v1 --jobs 8 --out results/mine.json",
    )

    policy: Annotated[str, tyro.conf.Positional]
    suite: str = "active-v1"  # a frozen benchmark: active-v1, active-quick-v1 or coverage-v1
    quick: bool = False  # the suite active-quick-v1: 20 episodes, a few minutes
    trust: bool = False  # load model files (.zip of Stable-Baselines3, .pt), which may run arbitrary code
    name: str = ""  # of the row in tables; by default the name of the policy, of its file or its folder
    hours: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = (
        None  # of training; by default those of a run folder
    )
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] | None = None  # trainings that the policy was chosen from
    jobs: Annotated[int, Field(ge=1, le=256)] = 1  # processes at the same time
    out: Path | None = None  # file of the result; by default runs/NAME-SUITE.json

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Run all episodes and write the file. 0; 1 when an episode failed, 130 after Ctrl-C."""
        from mecp_env.cli.evaluate import Evaluate, write_submission
        from mecp_env.policies.registry import training_hours
        from mecp_env.policies.suites import Training, submission

        suite, name = self._suite(line), self._name()
        path = self._path(f"{name}-{suite}")
        options = {"truth": False, "reference": self.policy, "trust": self.trust, "jobs": self.jobs}
        done = Evaluate((self.policy,), suite=suite, out=path.with_suffix(""), **options).suite_rows()  # type: ignore[arg-type]
        if isinstance(done, int):
            return done
        named = [(setting, [replace(row, policy=name) for row in rows]) for setting, rows in done]
        training = Training(training_hours(self.policy) if self.hours is None else self.hours, self.seeds)
        write_submission(submission(suite, named, f"mecp-env submit {shlex.join(line)}", training), path)
        return 0

    def _suite(self, line: Sequence[str]) -> str:
        """The name of the suite. Raises `ConfigError` for two of them."""
        if self.quick and "--suite" in {word.partition("=")[0] for word in line}:
            raise ConfigError(f"--suite {self.suite}: --quick selects {QUICK}; leave out one of the two")
        return QUICK if self.quick else self.suite

    def _path(self, name: str) -> Path:
        """Where the result is written, by default by its name. Raises `ConfigError`."""
        path = check_writable(self.out or Path("runs") / f"{re.sub('[/:]', '-', name)}.json")
        if path.suffix != ".json":
            raise ConfigError(f"out: {path}: expected the name of a file that ends in .json")
        return path

    def _name(self) -> str:
        """The name of the row. Raises `ConfigError` for one that forges a row, or is that of another policy."""
        from mecp_env.policies.leaderboard import check_name
        from mecp_env.policies.registry import LEARNED, OURS

        path = Path(self.policy)
        default = (path.stem if path.is_file() else path.name) if path.exists() else self.policy
        name = check_name(self.name or default)
        if name in (*OURS, *LEARNED) and name != self.policy:
            raise ConfigError(f"name: {name!r} is the name of a policy of this package; choose another with --name")
        return name
