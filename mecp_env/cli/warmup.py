"""`mecp-env warmup`: compile ahead, on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from mecp_env.cli.base import Command
from mecp_env.cli.exit_codes import echo


@dataclass(frozen=True)
class WarmUp(Command):
    """Compile the functions that an episode calls, on all cores, into the user's cache."""

    examples: ClassVar[tuple[str, ...]] = ("mecp-env warmup", "mecp-env warmup --jobs 1")

    jobs: Annotated[int, Field(ge=1)] | None = None  # processes at the same time; default: one per core

    def run(self, line: Sequence[str]) -> int:
        """Show a progress bar; a function that cannot be compiled ahead is compiled when it is called."""
        from rich.progress import Progress

        from mecp_env.core import jit_cache, warm_up
        from mecp_env.core.cores import cores

        missing = warm_up.missing_entries()
        with Progress() as bar:
            task = bar.add_task("compiling", total=len(missing))
            jobs = self.jobs or cores()
            warm_up.compile_all(missing, jobs, lambda done, total: bar.update(task, completed=done))
        left = len(warm_up.missing_entries())
        later = f"; {left} are compiled when they are called" if left else ""
        echo(f"{len(missing) - left} functions compiled, in {jit_cache.cache_directory()}{later}")
        return 0
