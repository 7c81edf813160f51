"""What a run says while it goes on: a progress bar, tables in CSV, and TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mecp_env.core.errors import ConfigError
from mecp_env.learning.checkpoints import Progress as Counts
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.environments import FIGURES
from mecp_env.learning.run_folder import Table

CLOCK = ("decisions", "periods", "episodes", "seconds")
TRAINING = (
    *CLOCK,
    *("periods_per_s", "waiting_share"),
    *FIGURES,
    *("policy_loss", "value_loss", "entropy_loss", "kl", "clip_fraction", "explained_variance", "learning_rate"),
)
EVALUATION = (*CLOCK, "n", "auc_error", *FIGURES)
BAR_WIDTH = 12


class Report:
    """Bar, tables and curves of a run; a context manager, which starts the threads of bar and curves."""

    def __init__(self, folder: Path, config: TrainConfig, console: Console | None = None) -> None:
        self.config = config
        self.training = Table(folder / "progress.csv", TRAINING)
        self.evaluations = Table(folder / "evaluation.csv", EVALUATION)
        self.folder = folder
        self.curves: Any = None
        columns = (BarColumn(BAR_WIDTH), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"))
        self.bar = Progress(*columns, TimeRemainingColumn(), TextColumn("{task.description}"), console=console)
        self.task = self.bar.add_task("begins", total=config.steps)

    def __enter__(self) -> Self:
        self.curves = curves(self.folder) if self.config.log.tensorboard else None
        self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.stop()
        if self.curves is not None:
            self.curves.close()

    def begin(self, decisions: int) -> None:
        """The run begins, or goes on, after so many decisions."""
        self.training.cut(decisions)
        self.evaluations.cut(decisions)
        self.bar.reset(self.task, completed=decisions, total=self.config.steps)

    def advance(self, decisions: int) -> None:
        """So many decisions are made."""
        self.bar.update(self.task, completed=decisions)

    def status(self, text: str) -> None:
        """What goes on, beside the bar."""
        self.bar.update(self.task, description=text)

    def say(self, text: str) -> None:
        """A line above the bar."""
        self.bar.console.print(text, markup=False, highlight=False)

    def row(self, counts: Counts, values: Mapping[str, float]) -> None:
        """The figures of an update."""
        self.training.add(clock(counts) | values)
        self._draw("training", counts.decisions, values)
        speed = f"{values['periods_per_s']:,.0f} steps/s, waiting {values['waiting_share']:.0%}"
        self.bar.update(self.task, description=f"{area(values)}{speed}")

    def evaluation(self, counts: Counts, values: Mapping[str, float], best: bool) -> None:
        """The figures of an evaluation, in place of those of the same decisions from before a crash."""
        self.evaluations.cut(counts.decisions - 1)
        self.evaluations.add(clock(counts) | values)
        self._draw("validation", counts.decisions, values)
        error = f" +- {values['auc_error']:.4f}" if values["n"] > 1 else ""  # one building says nothing of others
        found = f"area under the curve {values['auc']:.4f}{error}"
        pose = f"pose error {100.0 * values['pose_error_final_m']:.1f} cm, coverage {values['coverage']:.1%}"
        self.say(f"{counts.decisions:,} decisions: {found}, {pose}{' (best)' if best else ''}")

    def _draw(self, group: str, decisions: int, values: Mapping[str, float]) -> None:
        if self.curves is not None:
            for name, value in values.items():
                self.curves.add_scalar(f"{group}/{name}", value, decisions)


def curves(folder: Path) -> Any:
    """A writer for TensorBoard. Raises `ConfigError` where that is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise ConfigError("log.tensorboard: TensorBoard is not installed; --log.no-tensorboard does without") from None
    return SummaryWriter(str(folder / "tensorboard"))


def clock(counts: Counts) -> dict[str, float]:
    """How far the run has come."""
    return {name: float(getattr(counts, name)) for name in CLOCK}


def area(values: Mapping[str, float]) -> str:
    """The area under the curve, if an episode ended."""
    return f"area {values['auc']:.3f}, " if "auc" in values else ""
