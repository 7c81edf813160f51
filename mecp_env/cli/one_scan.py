"""`mecp-env one-scan`: the stages of one scan as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from mecp_env.cli.base import Command, check_folder
from mecp_env.cli.exit_codes import echo
from mecp_env.config import EnvConfig


@dataclass(frozen=True)
class OneScan(Command):
    """Follow one scan through the stages: one picture each, as in docs/one-scan.md."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env one-scan",
        "mecp-env one-scan --layout hard:7",
        "mecp-env one-scan --layout office --step 10 --out runs/office-scan",
    )

    layout: str = "paper"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a plan
    seed: int = 0  # the same seed gives the same run
    step: int = 40  # the first scan from here on in which a polygon of the map is recognised
    out: Path = Path("runs/one-scan")  # folder for the pictures

    def run(self, line: Sequence[str]) -> int:
        """Write the pictures of one scan's stages, and say where they are."""
        from mecp_env.cli.buildings import resolve
        from mecp_env.cli.scan_stages import draw  # pictures and physics are loaded only here

        folder, config = check_folder(self.out), EnvConfig.build({}, layout=resolve(self.layout))
        for path in draw(config, self.seed, self.step, folder):
            echo(str(path))
        return 0
