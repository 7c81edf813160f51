"""`mecp-env leaderboard`: the table of results of a frozen benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from mecp_env.cli.base import Command
from mecp_env.cli.exit_codes import echo
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
        from mecp_env.policies.references import reference_rows
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
