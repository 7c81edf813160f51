"""`mecp-env doctor`: is everything there that the environment needs, and does it work?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.console import Console
from rich.text import Text

from mecp_env.cli import doctor_machine, doctor_trial
from mecp_env.cli.base import Command
from mecp_env.cli.exit_codes import FAILED
from mecp_env.cli.findings import Finding
from mecp_env.core.errors import ConfigError

COLOURS = {"PASS": "green", "WARN": "yellow", "FAIL": "bold red"}
CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    doctor_machine.python,
    doctor_machine.dependencies,
    doctor_machine.extras,
    doctor_machine.processor,
    doctor_machine.compiled_functions,
    doctor_machine.display,
)
SECONDS = (0.1, 600.0)


@dataclass(frozen=True)
class Doctor(Command):
    """Check Python, dependencies, processor, function cache and display, then drive for two seconds. Each line starts
    with PASS, WARN or FAIL, and the line below it names a fix. Exit code 1 if a check failed, else 0."""

    examples: ClassVar[tuple[str, ...]] = ("mecp-env doctor", "mecp-env doctor --seconds 10")

    seconds: float = 2.0  # how long the self-test drives

    def run(self, line: Sequence[str]) -> int:
        """Print the finding of each check as soon as it is known."""
        if not SECONDS[0] <= self.seconds <= SECONDS[1]:
            raise ConfigError(f"seconds: {self.seconds:g}, from {SECONDS[0]:g} to {SECONDS[1]:g}")
        counts = dict.fromkeys(COLOURS, 0)
        for finding in examine((*CHECKS, lambda: doctor_trial.self_test(self.seconds))):
            echo(finding)
            counts[finding.verdict] += 1
        print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
        return FAILED if counts["FAIL"] else 0


def examine(checks: Sequence[Callable[[], Iterator[Finding]]]) -> Iterator[Finding]:
    """What all checks find; one that breaks off is a failure, not the end."""
    for check in checks:
        try:
            yield from check()
        except Exception as error:  # whatever is wrong with the machine is to be said
            name = getattr(check, "__name__", "self-test").strip("<>").replace("lambda", "self-test")
            yield Finding("FAIL", name, f"{type(error).__name__}: {error}", "install mecp_env again, or report this")


def echo(finding: Finding) -> None:
    """Print a finding, and below it what to do."""
    console = Console()
    verdict = Text(f"{finding.verdict}  ", COLOURS[finding.verdict])
    console.print(Text.assemble(verdict, f"{finding.name:<16}  {finding.said}"), soft_wrap=True)
    if finding.fix:
        console.print(Text(f"      {'':<16}  -> {finding.fix}"), soft_wrap=True)
