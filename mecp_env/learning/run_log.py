"""What a run reports: tables and TensorBoard by Stable-Baselines3, a progress bar, and curves as a PNG."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.learning.environments import FIGURES
from mecp_env.render.figures import drawn

CLOCK = ("decisions", "periods", "episodes", "seconds")
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction", "explained_variance")
TABLES = {
    "progress.csv": (*CLOCK, "periods_per_s", "waiting_share", *FIGURES, *LOSSES, "learning_rate"),
    "evaluation.csv": (*CLOCK, "n", "auc_error", *FIGURES),
}
BAR_WIDTH = 12


class Table(CSVOutputFormat):
    """The table of Stable-Baselines3 with fixed columns; it keeps the rows of up to some decisions, and continues.

    The column of a value is its key without the group: `train/value_loss` is `value_loss`.
    """

    def __init__(self, path: Path, columns: Sequence[str], decisions: int) -> None:
        kept = [row for row in read_rows(path) if int(row["decisions"]) <= decisions]
        super().__init__(str(path))
        self.keys = list(columns)
        lines = [columns, *([row.get(name) or "" for name in columns] for row in kept)]
        self.file.writelines(",".join(line) + "\n" for line in lines)
        self.file.flush()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row; a column without a value stays empty."""
        values = {key.rpartition("/")[2]: value for key, value in key_values.items()}
        super().write({name: values[name] for name in self.keys if name in values}, {}, step)


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a table; those that do not start with their decisions are left out."""
    if not path.exists():
        return []
    with path.open(newline="", errors="replace", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if (row.get("decisions") or "").isdecimal()]


class RunLog:
    """The loggers of training and evaluation, and the progress bar; a context manager."""

    def __init__(self, folder: Path, steps: int, tensorboard: bool) -> None:
        self.folder, self.tensorboard = folder, tensorboard
        columns = (BarColumn(BAR_WIDTH), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"))
        self.bar = Progress(*columns, TimeRemainingColumn(), TextColumn("{task.description}"))
        self.task = self.bar.add_task("starting", total=steps)
        self.steps, self.tenths = steps, 0
        self.loggers: list[Logger] = []

    def __enter__(self) -> Self:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()
        for logger in self.loggers:
            logger.close()

    def start(self, decisions: int) -> None:
        """The run starts, or continues, after that many decisions. Raises `ConfigError` without TensorBoard."""
        curves = [tensorboard_format(self.folder)] if self.tensorboard else []
        tables = [Table(self.folder / name, columns, decisions) for name, columns in TABLES.items()]
        self.loggers = [Logger(str(self.folder), [table, *curves]) for table in tables]
        self.training, self.evaluation = self.loggers
        self.advance(decisions)

    def advance(self, decisions: int, description: str | None = None) -> None:
        """Update the progress bar; without a terminal, print a line at every tenth of the way."""
        self.bar.update(self.task, completed=decisions, description=description)
        tenths = 10 * decisions // self.steps
        if tenths > self.tenths and not self.bar.console.is_terminal:
            self.echo(f"{decisions:,} of {self.steps:,} decisions, {description or 'continued'}")
        self.tenths = tenths

    def echo(self, text: str) -> None:
        """Print a line above the bar."""
        self.bar.console.print(text, markup=False, highlight=False)

    def add_evaluation(self, clock: Mapping[str, Any], figures: Mapping[str, float], best: bool) -> None:
        """Log an evaluation."""
        for name, value in {**clock, **figures}.items():
            self.evaluation.record(f"validation/{name}", value)
        self.evaluation.dump(clock["decisions"])
        error = f" +- {figures['auc_error']:.4f}" if figures["n"] > 1 else ""  # one building has no deviation
        found = f"area under the curve {figures['auc']:.4f}{error}"
        pose = f"pose error {100.0 * figures['pose_error_final_m']:.1f} cm, coverage {figures['coverage']:.1%}"
        pose += f", correct coverage over steps {figures['correct_over_steps']:.4f}"
        self.echo(f"{clock['decisions']:,} decisions: {found}, {pose}{' (best)' if best else ''}")


def tensorboard_format(folder: Path) -> TensorBoardOutputFormat:
    """A writer for TensorBoard. Raises `ConfigError` where that is not installed."""
    try:
        return TensorBoardOutputFormat(str(folder / "tensorboard"))
    except (ImportError, AssertionError):
        raise ConfigError("log.tensorboard: TensorBoard is not installed; use --log.no-tensorboard") from None


CURVES = "curves.png"
PANELS = (  # column, label with its unit, factor
    ("reward", "return, no unit", 1.0),
    ("correct_coverage", "correct coverage at the end, %", 100.0),
    ("lost", "lost episodes, %", 100.0),
)
SMOOTHED = 7  # updates in a running mean; the episodes of a single one are few
TRAINED, VALIDATED = "#0072b2", "#d55e00"  # of Okabe and Ito
DPI = 200


def draw_training(folder: Path) -> Path | None:
    """Draw the curves of the run in a folder from its tables. Their file, or None before the first update.

    Points are the means of the episodes that finished in an update (actions are sampled), the line their running mean;
    squares are the evaluations on the validation split (the most probable action).
    """
    updates, evaluations = (read_rows(folder / name) for name in TABLES)
    if not updates:
        return None
    panels = [panel for panel in PANELS if len(measured(updates, panel[0])[1])] or PANELS[:1]
    figure = Figure(figsize=(3.5 * len(panels), 3.4), layout="constrained")
    for axes, (name, title, factor) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        decisions, values = measured(updates, name)
        axes.plot(decisions, factor * values, ".", color=TRAINED, alpha=0.3, label="episodes of an update")
        axes.plot(decisions, factor * running_mean(values), color=TRAINED, label=f"mean of {SMOOTHED} updates")
        decisions, values = measured(evaluations, name)
        axes.plot(decisions, factor * values, "s", color=VALIDATED, markersize=6, label="validation")
        dress(axes, title)
    named = drawn(figure.axes[0])
    if named["handles"]:
        figure.legend(**named, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(folder / CURVES, dpi=DPI, metadata={"Software": None})
    return folder / CURVES


def measured(rows: Sequence[Mapping[str, str]], name: str) -> tuple[Array, Array]:
    """(n,) decisions and (n,) values of a column, of the rows that have a number there."""
    pairs = [(float(row["decisions"]), float(row.get(name) or math.nan)) for row in rows]
    table = np.array(pairs, float).reshape(-1, 2)
    table = table[np.isfinite(table[:, 1])]
    return table[:, 0], table[:, 1]


def running_mean(values: Array) -> Array:
    """(n,) the mean of up to `SMOOTHED` values around each; fewer at the ends."""
    half = SMOOTHED // 2
    return np.array([values[max(0, i - half) : i + half + 1].mean() for i in range(len(values))])


def dress(axes: Axes, title: str) -> None:
    """Labels and grid."""
    axes.set_ylabel(title, fontsize=10)
    axes.set_xlabel("decisions, thousand", fontsize=10)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}")
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
