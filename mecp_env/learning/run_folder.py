"""The folder of a run: everything that is needed to repeat it, and its results.

What a run reports: Stable-Baselines3 loggers with CSV tables that survive a kill, TensorBoard, a progress bar.
"""

from __future__ import annotations

import csv
import io
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn

import mecp_env
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.provenance import commit
from mecp_env.learning import files
from mecp_env.learning.config import TrainConfig, read_config
from mecp_env.learning.environments import FIGURES
from mecp_env.learning.files import Checkpoints, TrainingState, write_json

PACKAGES = ("gymnasium", "numpy", "numba", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "safetensors")
CONFIG, ABOUT, POLICY, LOCK = "config.json", "run.json", "policy.json", ".lock"
NAME_LENGTH = 12  # of the checksum in the name of a file of weights


class RunFolder:
    """Paths and files of a run."""

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        self.checkpoints = Checkpoints(folder / "checkpoints", config.log.keep)
        self.held: Any = None

    def hold(self) -> None:
        """Exclude other processes from this folder until `close`. Raises `ConfigError` when one trains here."""
        try:
            self.held = files.lock(self.folder / LOCK)
        except BlockingIOError:
            raise ConfigError(f"out: {self.folder} is being trained by another process") from None

    def close(self) -> None:
        """Release the folder."""
        if self.held is not None:
            self.held.close()

    def start(self) -> None:
        """Create the folder and hold it. Raises `ConfigError` if it has a run already, or cannot be written to."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.hold()
            if (self.folder / CONFIG).exists():  # after the lock: another process may have started meanwhile
                raise ConfigError(f"out: {self.folder} has a run already; --resume {self.folder} continues it")
            write_json(self.folder / CONFIG, self.config.to_dict())
        except OSError as error:
            raise ConfigError(f"out: {self.folder}: {error.strerror}; choose another place with --out") from None
        self.add_event("begun")

    def resume(self) -> None:
        """Hold the folder of a run that continues, and write its configuration.

        Raises `ConfigError`, with nothing written, when another process trains there, or for fewer steps than the run
        has made; a finished run may have made a few more, those of its last update.
        """
        self.hold()
        made, steps = self.checkpoints.decisions(), self.config.steps
        if steps < made and steps != TrainConfig.build(read_config(self.folder / CONFIG)).steps:
            raise ConfigError(f"steps: {steps}, but the run in {self.folder} has made {made} decisions already")
        write_json(self.folder / CONFIG, self.config.to_dict())
        self.add_event("resumed")

    def add_event(self, event: str) -> None:
        """Add an entry to `run.json`: the time, the command, and the versions."""
        path = self.folder / ABOUT
        known: list[Any] = []
        with suppress(OSError, ValueError):  # none yet, or damaged
            known = list(json.loads(path.read_text(encoding="utf-8")))
        write_json(path, [*known, {"event": event, **provenance()}])

    def keep_policy(self, model: OnPolicyAlgorithm, state: TrainingState, **facts: Any) -> None:
        """Make the policy of a model the one that is loaded from this folder; `facts` describe its origin.

        Raises `NotFiniteError`; the previous weights then stay.
        """
        files.check_finite(model.policy)
        facts |= {"decisions": state.decisions, "seconds": round(state.seconds)}
        save_policy(self.folder, model.policy, self.config.algorithm, facts)


def save_policy(folder: Path, policy: nn.Module, algorithm: str, facts: Mapping[str, Any]) -> None:
    """Write weights, then `policy.json`, which names them with their checksum, then remove older ones."""
    data = files.tensor_bytes(files.weights_of(policy))
    sha256 = files.checksum(data)
    name = f"policy-{sha256[:NAME_LENGTH]}.safetensors"
    write_atomic(folder / name, data)
    write_json(folder / POLICY, {"algorithm": algorithm, "file": name, "sha256": sha256, "bytes": len(data), **facts})
    for old in folder.glob("policy-*.safetensors"):
        if old.name != name:
            old.unlink()


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


CLOCK = ("decisions", "periods", "episodes", "seconds")
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction", "explained_variance")
TRAINING = (*CLOCK, "periods_per_s", "waiting_share", *FIGURES, *LOSSES, "learning_rate")
EVALUATION = (*CLOCK, "n", "auc_error", *FIGURES)
BAR_WIDTH = 12


class CsvTable(KVWriter):
    """A CSV file that grows by one row per dump; unlike that of Stable-Baselines3 it continues after a kill.

    The column of a value is its key without the group: `train/value_loss` is `value_loss`.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path, self.columns = path, list(columns)

    def cut(self, decisions: int) -> None:
        """Remove the rows beyond that many decisions: they will be made again."""
        rows = [row for row in self.rows() if row["decisions"].isdecimal() and int(row["decisions"]) <= decisions]
        text = io.StringIO()
        writer = csv.DictWriter(text, self.columns, extrasaction="ignore", restval="")
        writer.writeheader()
        writer.writerows(rows)
        write_atomic(self.path, text.getvalue().encode())

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row; a column without a value stays empty."""
        values = {key.rpartition("/")[2]: value for key, value in key_values.items()}
        row = {name: f"{values[name]:.6g}" for name in self.columns if name in values} | {"decisions": str(step)}
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self.columns, restval="").writerow(row)

    def close(self) -> None:
        """Nothing stays open between two rows."""

    def rows(self) -> list[dict[str, str]]:
        """All complete rows."""
        if not self.path.exists():
            return []
        with self.path.open(
            newline="", errors="replace", encoding="utf-8"
        ) as file:  # a power failure may leave a cut or zeroed tail
            complete = [line for line in file if line.endswith("\n") and "\0" not in line]
        return [row for row in csv.DictReader(complete) if row.get("decisions")]


class RunLog:
    """The loggers of training and evaluation, and the progress bar; a context manager."""

    def __init__(self, folder: Path, steps: int, tensorboard: bool, console: Console | None = None) -> None:
        self.folder, self.tensorboard = folder, tensorboard
        self.tables = CsvTable(folder / "progress.csv", TRAINING), CsvTable(folder / "evaluation.csv", EVALUATION)
        columns = (BarColumn(BAR_WIDTH), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"))
        self.bar = Progress(*columns, TimeRemainingColumn(), TextColumn("{task.description}"), console=console)
        self.task = self.bar.add_task("starting", total=steps)
        self.steps, self.tenths = steps, 0

    def __enter__(self) -> Self:
        curves = [tensorboard_format(self.folder)] if self.tensorboard else []
        self.training, self.evaluation = (Logger(str(self.folder), [table, *curves]) for table in self.tables)
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()
        self.training.close()
        self.evaluation.close()

    def start(self, decisions: int) -> None:
        """The run starts, or continues, after that many decisions."""
        for table in self.tables:
            table.cut(decisions)
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

    def add_evaluation(self, clock: Mapping[str, float], figures: Mapping[str, float], best: bool) -> None:
        """Log an evaluation, replacing one of the same decisions from before a crash."""
        decisions = int(clock["decisions"])
        self.tables[1].cut(decisions - 1)
        for name, value in {**clock, **figures}.items():
            self.evaluation.record(f"validation/{name}", value)
        self.evaluation.dump(decisions)
        error = f" +- {figures['auc_error']:.4f}" if figures["n"] > 1 else ""  # one building has no deviation
        found = f"area under the curve {figures['auc']:.4f}{error}"
        pose = f"pose error {100.0 * figures['pose_error_final_m']:.1f} cm, coverage {figures['coverage']:.1%}"
        pose += f", correct coverage over steps {figures['correct_over_steps']:.4f}"
        self.echo(f"{decisions:,} decisions: {found}, {pose}{' (best)' if best else ''}")


def tensorboard_format(folder: Path) -> TensorBoardOutputFormat:
    """A writer for TensorBoard. Raises `ConfigError` where that is not installed."""
    try:
        return TensorBoardOutputFormat(str(folder / "tensorboard"))
    except (ImportError, AssertionError):
        raise ConfigError("log.tensorboard: TensorBoard is not installed; use --log.no-tensorboard") from None
