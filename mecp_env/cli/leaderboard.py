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


@dataclass(frozen=True)
class Leaderboard(Command):
    """One table of several results of `mecp-env evaluate --suite`, the best policy first. A file of another suite, of
    another version of it, or one that was changed, is refused."""

    examples: ClassVar[tuple[str, ...]] = ("mecp-env leaderboard runs/mine/active-v1.json results/others.json",)

    files: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE ...")]
    metric: str = "correct_over_steps"  # or correct_over_metres, correct_coverage, auc, coverage, lost, complete

    def run(self, line: Sequence[str]) -> int:
        """Print the table."""
        from mecp_env.policies.suites import METRICS, leaderboard, read_submission

        if not self.files:
            raise ConfigError("files: expected at least one result of `mecp-env evaluate --suite`")
        if self.metric not in METRICS:
            raise ConfigError(f"metric: {self.metric!r:.80}, expected one of {', '.join(METRICS)}")
        found = {str(path): read_submission(path) for path in self.files}
        suites = sorted({content["suite"] for content in found.values()})
        if len(suites) > 1:
            raise ConfigError(f"files: of several suites ({', '.join(suites)}); one table shows one")
        echo(f"{suites[0]}, {self.metric}", "", *leaderboard(found, self.metric).split("\n"))
        return 0
