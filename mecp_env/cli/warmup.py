"""`mecp-env warmup`: compile ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from mecp_env.cli.base import Command
from mecp_env.cli.exit_codes import FAILED, echo, print_error


@dataclass(frozen=True)
class WarmUp(Command):
    """Compile what the commands call into the user's cache, by short drives in processes of their own."""

    examples: ClassVar[tuple[str, ...]] = ("mecp-env warmup", "mecp-env warmup --jobs 1")

    jobs: Annotated[int, Field(ge=1)] | None = None  # processes at the same time, at most two; default: one per core

    def run(self, line: Sequence[str]) -> int:
        """Count the functions in the meantime; what no drive calls is compiled when it is called."""
        from rich.progress import Progress, SpinnerColumn, TextColumn

        from mecp_env.core import jit, warm_up
        from mecp_env.core.cores import cores

        place, together = jit.cache_directory(), (self.jobs or cores()) > 1
        if not jit.usable(place):
            print_error(f"{place} cannot be written; NUMBA_CACHE_DIR names another folder")
            return FAILED
        with Progress(SpinnerColumn(), TextColumn("{task.completed} functions")) as bar:
            task = bar.add_task("compiling", total=None)
            rows = (warm_up.FIRST, warm_up.LATER) if together else zip(warm_up.FIRST + warm_up.LATER)
            failed = [warm_up.compile_ahead(drives, lambda count: bar.update(task, completed=count)) for drives in rows]
        if any(failed):
            names = [name for row in failed for name in row]
            print_error(f"drives that failed: {', '.join(names)}; python -m {warm_up.DRIVES} {names[0]} says why")
            return FAILED
        echo(f"functions compiled, in {place}")
        return 0
