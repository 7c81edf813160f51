"""How far a run has come: a bar with what was found beside it, or lines where there is no terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mecp_env.core.files import sanitised

COUNT = BarColumn(12), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()


class Bar(Progress):
    """A context manager that shows a bar; without a terminal it prints a line at every tenth of the way."""

    def __init__(self, total: float, *columns: Any, stays: bool = True, stderr: bool = False) -> None:
        """`stays`: the bar is left, or printed, at the end."""
        console, columns = Console(stderr=stderr), (*(columns or COUNT), TextColumn("{task.description}"))
        super().__init__(*columns, console=console, transient=not stays, disable=not (stays or console.is_terminal))
        self.task, self.total, self.tenths = self.add_task("starting", total=total), total, 0

    def show(self, done: float, found: str = "", line: str = "") -> None:
        """Show how much is done, and what has been found; `line` is what is printed without a terminal."""
        self.update(self.task, completed=done, description=found)
        tenths = int(10 * done / self.total)
        if line and tenths > self.tenths and not self.console.is_terminal:
            self.echo(line)
        self.tenths = tenths

    def echo(self, text: str) -> None:
        """Print a line above the bar."""
        self.console.print(sanitised(text), markup=False, highlight=False)
