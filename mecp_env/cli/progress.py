"""What the demo says while it runs, and at its end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from mecp_env.cli.explore import FILES, Run
from mecp_env.cli.stopwatch import Stopwatch
from mecp_env.core.files import sanitised

EVERY = 10  # steps between two updates
LINE_STEPS = 200  # between two lines, where there is no terminal for a bar
BAR_WIDTH = 6  # what is left of 80 columns


def status(metrics: Mapping[str, float], steps_per_s: float) -> str:
    """How far an exploration has come, in at most 65 characters: with bar and time it fits into 80 columns."""
    return (
        "rooms {rooms_found:.0f}/{rooms:.0f} doors {doors_found:.0f}/{doors:.0f} seen {coverage:.1%}".format(**metrics)
        + f" error {100.0 * metrics['pose_error_m']:.1f} cm {steps_per_s:,.0f} steps/s"
    )


class ExplorationBar(Progress):
    """A bar of the share of the building that has been seen, with rooms, doors, pose error and speed."""

    def __init__(self, run: Run, watch: Stopwatch, console: Console | None = None) -> None:
        super().__init__(BarColumn(BAR_WIDTH), TimeElapsedColumn(), TextColumn("{task.description}"), console=console)
        layout = run.env.config.layout  # a shipped name, or a whole layout
        name = layout if isinstance(layout, str) else str(layout["name"])
        self.console.print(f"exploring {sanitised(name)}", style="bold", markup=False)
        self.watch, self.task = watch, self.add_task("preparing", total=1.0)

    def show(self, run: Run) -> None:
        """Bring the bar up to date, every few steps; without a terminal, print a line now and then."""
        if run.steps % EVERY == 0:
            metrics = run.env.view().metrics
            said = status(metrics, self.watch.steps_per_s)
            self.update(self.task, completed=metrics["coverage"], description=said)
            if run.steps % LINE_STEPS == 0 and not self.console.is_terminal:
                self.console.print(f"step {run.steps}: {said}", markup=False, highlight=False)


ROWS = (
    ("rooms found", "{rooms_found:.0f} of {rooms:.0f}, {rooms_false:.0f} false"),
    ("doors found", "{doors_found:.0f} of {doors:.0f}, {doors_false:.0f} false"),
    ("free area seen", "{coverage:.1%}"),
    ("grid IoU with the truth", "{grid_iou:.3f}"),
    ("pose error", "RMSE {pose_rmse_m:.3f} m, final {pose_error_final_m:.3f} m"),
    ("pose NEES", "{nees_mean:.2f} (3 expected)"),
    ("association", "precision {association_precision:.4f}, recall {association_recall:.4f}"),
    ("landmarks", "{landmarks:.0f}, of no corner {landmarks_false:.0f}, duplicates {duplicates:.0f}"),
    ("map error", "RMSE {map_rmse_m:.3f} m"),
    ("way", "{metres:.0f} m in {periods:.0f} steps, contacts {contacts:.0f}"),
    ("speed", "{steps_per_s:,.0f} steps/s"),
)


def print_result(metrics: dict[str, Any], folder: Path) -> None:
    """Print the figures of a run and where its files are."""
    ended = "over, no goal left" if metrics["ended"] == "complete" else metrics["ended"]  # by the belief, not the truth
    table = Table(title=f"exploration {ended}", show_header=False, title_justify="left")
    for name, form in ROWS:
        table.add_row(name, form.format(**metrics))
    console = Console()
    console.print(table)
    there = [name for name in FILES if (folder / name).exists()]
    console.print(f"{', '.join(there)} in {sanitised(str(folder))}/", markup=False)
