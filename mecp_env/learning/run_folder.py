"""The folder of a run: everything that is needed to repeat and to continue it.

What a run reports: tables and TensorBoard by Stable-Baselines3, a progress bar, and curves as a PNG.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
import shlex
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict
from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file

import mecp_env
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.provenance import commit
from mecp_env.learning.config import CONFIG, TrainConfig, WeightError, read_config
from mecp_env.learning.environments import FIGURES
from mecp_env.learning.exported import check_archive, check_finite
from mecp_env.learning.learned import MOST_POLICY_BYTES, write_json
from mecp_env.render.figures import drawn, open_axes, save
from mecp_env.render.progress import Bar

fcntl: Any
CLOCK = ("decisions", "periods", "episodes", "seconds")
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction", "explained_variance")
TABLES = {
    "progress.csv": (*CLOCK, "periods_per_s", "waiting_share", *FIGURES, *LOSSES, "learning_rate"),
    "evaluation.csv": (*CLOCK, "n", "auc_error", *FIGURES),
}


try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PACKAGES = ("gymnasium", "numpy", "numba", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "safetensors")
ABOUT, LOCK = "run.json", ".lock"
MOST_BYTES = 4 * MOST_POLICY_BYTES  # of a checkpoint: the weights, the two moments of Adam, and the rest


class TrainingState(BaseModel):
    """What a run has counted; Stable-Baselines3 saves the rest."""

    model_config = ConfigDict(extra="forbid", strict=True)  # checked when a checkpoint is read

    decisions: int = 0
    periods: int = 0  # control steps
    episodes: int = 0
    seconds: float = 0.0  # of training, over all resumptions
    best_score: float = -1.0  # the largest on the validation split
    evaluated: int = -1  # decisions at the last evaluation
    returns: tuple[float, float, float] = (0.0, 1.0, 1e-4)  # mean, variance, count, by which rewards are normalised


class RunFolder:
    """Files of a run. A process that trains here holds the folder until `close`."""

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        self.held: Any = None

    def start(self) -> None:
        """Create the folder and hold it. Raises `ConfigError` if it has a run already, or cannot be written to."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.hold()
            if (self.folder / CONFIG).exists():  # after the lock: another process may have started meanwhile
                raise ConfigError(f"out: {self.folder} has a run already; --resume {self.folder} continues it")
            self.begin("begun")
        except OSError as error:
            raise ConfigError(f"out: {self.folder}: {error.strerror}; choose another place with --out") from None

    def hold(self) -> None:
        """Exclude other processes from this folder. Raises `ConfigError` when one trains here."""
        self.held = lock(self.folder / LOCK)

    def close(self) -> None:
        """Release the folder."""
        if self.held is not None:
            self.held.close()

    def begin(self, event: str) -> None:
        """Write the configuration, and add an entry to `run.json`: the time, the command, and the versions."""
        write_json(self.folder / CONFIG, self.config.to_dict())
        known: list[Any] = []
        with suppress(OSError, ValueError):  # none yet, or damaged
            known = list(json.loads((self.folder / ABOUT).read_text(encoding="utf-8")))
        write_json(self.folder / ABOUT, [*known, {"event": event, **provenance()}])

    def resume(self, model: OnPolicyAlgorithm, report: Callable[[str], None]) -> TrainingState:
        """Put the newest valid checkpoint into a model; damaged ones are skipped, and reported.

        Raises `WeightError` when none is valid, and `ConfigError`, with nothing written, for fewer steps than the run
        has made; a finished run may have made a few more, those of its last update.
        """
        state = self.load_newest(model, report)
        made, steps = state.decisions, self.config.steps
        if steps < made and steps != TrainConfig.build(read_config(self.folder / CONFIG)).steps:
            raise ConfigError(f"steps: {steps}, but the run in {self.folder} has made {made} decisions already")
        self.begin("resumed")
        report(f"resumed after {made:,} decisions" if made else "resumed from the beginning: no checkpoint yet")
        return state

    def load_newest(self, model: OnPolicyAlgorithm, report: Callable[[str], None]) -> TrainingState:
        """The newest valid checkpoint; that of the beginning without a file. Raises `WeightError`."""
        problem: WeightError | None = None
        for path in reversed(self.checkpoints()):
            try:
                return load_checkpoint(path, model)
            except WeightError as error:
                problem = error
                report(f"skipped {error}")
        if problem is not None:
            raise problem
        return TrainingState()

    def checkpoints(self) -> list[Path]:
        """The checkpoints, the oldest first: `DECISIONS.zip`."""
        return sorted(path for path in self.folder.glob("checkpoints/*.zip") if path.stem.isdecimal())

    def save(self, model: OnPolicyAlgorithm, state: TrainingState) -> None:
        """Write a checkpoint, then remove the oldest ones. Raises `NotFiniteError` before anything is written."""
        check_finite(model.policy)
        buffer = io.BytesIO()
        save_to_zip_file(buffer, params=model.get_parameters() | {"state": state.model_dump()})
        write_atomic(self.folder / "checkpoints" / f"{state.decisions:012d}.zip", buffer.getvalue())
        for old in self.checkpoints()[: -self.config.log.keep]:
            old.unlink()


def load_checkpoint(path: Path, model: OnPolicyAlgorithm) -> TrainingState:
    """Put a checkpoint, tensors and plain data and no code, into a model. Raises `WeightError`."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive, MOST_BYTES)
        parts = load_from_zip_file(path, device="cpu", load_data=False)[1]
        state = TrainingState(**parts.pop("state"))
        model.set_parameters(parts, exact_match=True, device="cpu")
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(f"{path}: damaged, or not a checkpoint: {' '.join(str(error).split()):.300}") from None
    model.num_timesteps = state.decisions
    return state


def lock(path: Path) -> Any:
    """Hold a file for this process, until the returned object is closed or the process has ended, killed or not.

    Raises `ConfigError` when another process holds it. Without such locks on a system it holds nothing. (`flock` locks
    would be inherited by forked workers, which outlive a killed process for a while.)
    """
    file = path.open("a", encoding="utf-8")
    try:
        if fcntl is not None:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.close()
        raise ConfigError(f"out: {path.parent} is being trained by another process") from None
    return file


def provenance() -> dict[str, Any]:
    """When, by which command, on which machine and with which versions this process runs."""
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "commit": commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "versions": {"mecp_env": mecp_env.__version__} | {name: version(name) for name in PACKAGES},
    }


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
        self.bar, self.steps, self.found = Bar(steps), steps, "starting"
        self.echo = self.bar.echo
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

    def advance(self, decisions: int, found: str = "") -> None:
        """Update the progress bar; `found` stays beside it until the next one."""
        self.found = found or self.found
        self.bar.show(decisions, self.found, f"{decisions:,} of {self.steps:,} decisions, {self.found}")

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
        axes.plot(decisions / 1000, factor * values, ".", color=TRAINED, alpha=0.3, label="episodes of an update")
        axes.plot(decisions / 1000, factor * running_mean(values), color=TRAINED, label=f"mean of {SMOOTHED} updates")
        decisions, values = measured(evaluations, name)
        axes.plot(decisions / 1000, factor * values, "s", color=VALIDATED, markersize=6, label="validation")
        axes.set(xlabel="decisions, thousand", ylabel=title)
        open_axes(axes)
    named = drawn(figure.axes[0])
    if named["handles"]:
        figure.legend(**named, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save(figure, folder / CURVES, DPI)
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
