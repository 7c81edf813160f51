"""Training with Stable-Baselines3: from a configuration to a run folder."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
import shlex
import signal
import sys
import time
import zipfile
from collections.abc import Sequence
from contextlib import closing, suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import CSVOutputFormat, Logger, TensorBoardOutputFormat
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file
from stable_baselines3.common.vec_env import VecEnv

import mecp_env
from mecp_env.core import processes
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.provenance import commit
from mecp_env.learning.config import CONFIG, TrainConfig, WeightError, read_config
from mecp_env.learning.encoder import make_model
from mecp_env.learning.environments import FIGURES, Rewards, make_env, make_many, make_validation
from mecp_env.learning.exported import MOST_UNPACKED, check_archive, check_finite
from mecp_env.learning.learned import save_policy, write_json
from mecp_env.learning.sb3_batch import OptionCallback
from mecp_env.render.progress import Bar

ENDS = signal.SIGINT, signal.SIGTERM  # Ctrl-C, and what a scheduler of a cluster sends
PACKAGES = ("gymnasium", "numpy", "numba", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "safetensors")
ABOUT = "run.json"
CLOCK = ("decisions", "periods", "episodes", "seconds")
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction", "explained_variance")
PROGRESS = (*CLOCK, "periods_per_s", "waiting_share", *FIGURES, *LOSSES, "learning_rate")
EVALUATION = (*CLOCK, "n", "auc_error", *FIGURES)


def train(config: TrainConfig, folder: Path, resume: bool = False) -> bool:
    """Train in a folder, or continue the run there: True at its end, False after Ctrl-C or SIGTERM, which save all.

    Raises `ConfigError` before anything is written, `WorkerDied`, and `NotFiniteError`.
    """
    for index in range(len(config.buildings.difficulty)):
        make_env(config, index).close()  # which says what is wrong with it
    if not resume and (folder / CONFIG).exists():
        raise ConfigError(f"out: {folder} has a run already; --resume {folder} continues it")
    torch.set_num_threads(1)  # several meet at the end of every operation: slower where a core is shared
    with closing(make_many(config, config.seed)) as venv:
        model = make_model(config, venv, config.seed)
        processes.keep()  # of an update; the workers are not meant
        with Run(config, folder, venv) as run:
            run.resume(model) if resume else begin(config, folder, "begun")
            return run.learn(model)


def begin(config: TrainConfig, folder: Path, event: str) -> None:
    """Write the configuration, and add an entry to `run.json`: the time, the command, and the versions."""
    write_json(folder / CONFIG, config.to_dict())
    known: list[Any] = []
    with suppress(OSError, ValueError):  # none yet, or damaged
        known = list(json.loads((folder / ABOUT).read_text(encoding="utf-8")))
    about = {
        "event": event,
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "commit": commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "versions": {"mecp_env": mecp_env.__version__} | {name: version(name) for name in PACKAGES},
    }
    write_json(folder / ABOUT, [*known, about])


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


def checkpoints(folder: Path) -> list[Path]:
    """The checkpoints of a run, the oldest first: `DECISIONS.zip`."""
    return sorted(path for path in folder.glob("checkpoints/*.zip") if path.stem.isdecimal())


def load_checkpoint(path: Path, model: OnPolicyAlgorithm) -> TrainingState:
    """Put a checkpoint, tensors and plain data and no code, into a model. Raises `WeightError`."""
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive, MOST_UNPACKED)
        parts = load_from_zip_file(path, device="cpu", load_data=False)[1]
        state = TrainingState(**parts.pop("state"))
        model.set_parameters(parts, exact_match=True, device="cpu")
    except Exception as error:  # damaged bytes may raise anything
        raise WeightError(
            f"{path}: damaged, or not a checkpoint ({' '.join(str(error).split()):.200}); remove it, and the run "
            "continues from the one before"
        ) from None
    model.num_timesteps = state.decisions
    return state


class Table(CSVOutputFormat):
    """The table of Stable-Baselines3 with fixed columns; it keeps the rows of up to some decisions, and continues.

    The column of a value is its key without the group: `train/value_loss` is `value_loss`.
    """

    def __init__(self, path: Path, columns: Sequence[str], decisions: int) -> None:
        rows: list[dict[str, str]] = []
        if path.exists():
            with path.open(newline="", errors="replace", encoding="utf-8") as file:
                rows = [row for row in csv.DictReader(file) if (row.get("decisions") or "").isdecimal()]
        super().__init__(str(path))
        self.keys = list(columns)
        kept = [[row.get(name) or "" for name in columns] for row in rows if int(row["decisions"]) <= decisions]
        self.file.writelines(",".join(line) + "\n" for line in (columns, *kept))
        self.file.flush()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row; a column without a value stays empty."""
        values = {key.rpartition("/")[2]: value for key, value in key_values.items()}
        super().write({name: values[name] for name in self.keys if name in values}, {}, step)


class Run(BaseCallback):
    """A run in its folder: counts and logs; between two updates it evaluates, keeps the best policy and checkpoints.

    Stable-Baselines3's own callbacks save and evaluate within a rollout, by the reward alone, and not atomically. A
    context manager, for the progress bar, the tables and the environments of evaluations.
    """

    model: OnPolicyAlgorithm

    def __init__(self, config: TrainConfig, folder: Path, venv: Rewards) -> None:
        super().__init__()
        self.config, self.folder, self.venv = config, folder, venv
        self.state, self.stop = TrainingState(), False  # after `stop` the training ends
        self.bar, self.found = Bar(config.steps), "starting"
        self.loggers: list[Logger] = []  # of updates, of evaluations
        self.validation: VecEnv | None = None  # made when it is first needed
        self.saved_s = time.perf_counter()

    def __enter__(self) -> Self:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()
        for resource in [*self.loggers, *([self.validation] if self.validation else [])]:
            resource.close()

    def resume(self, model: OnPolicyAlgorithm) -> None:
        """Continue from the newest checkpoint; all draws follow from the seed and the decisions made.

        Raises `WeightError` for a damaged one and `ConfigError` for fewer steps than the run has made, with nothing
        written; a finished run may have made a few more, those of its last update.
        """
        if found := checkpoints(self.folder):
            self.state = load_checkpoint(found[-1], model)
        state = self.state
        made, steps = state.decisions, self.config.steps
        if steps < made and steps != TrainConfig.build(read_config(self.folder / CONFIG)).steps:
            raise ConfigError(f"steps: {steps}, but the run in {self.folder} has made {made} decisions already")
        returns = self.venv.ret_rms
        returns.mean, returns.var, returns.count = *map(np.array, state.returns[:2]), state.returns[2]
        if made:
            words = np.random.SeedSequence([self.config.seed, made]).generate_state(1)
            model.set_random_seed(int(words[0]) // 2)
        begin(self.config, self.folder, "resumed")
        self.bar.echo(f"resumed after {made:,} decisions" if made else "resumed from the beginning: no checkpoint yet")

    def learn(self, model: OnPolicyAlgorithm) -> bool:
        """Train to the end, or until Ctrl-C or SIGTERM; then everything is saved."""
        curves = [TensorBoardOutputFormat(str(self.folder / "tensorboard"))] if self.config.log.tensorboard else []
        tables = ("progress.csv", PROGRESS), ("evaluation.csv", EVALUATION)
        for name, columns in tables:
            table = Table(self.folder / name, columns, self.state.decisions)
            self.loggers.append(Logger(str(self.folder), [table, *curves]))
        model.set_logger(self.loggers[0])
        self.advance()
        left = max(0, self.config.steps - self.state.decisions)
        before = {number: signal.signal(number, self.end) for number in ENDS}
        try:
            model.learn(left, callback=[OptionCallback(), self], reset_num_timesteps=False)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        return not self.stop

    def end(self, number: int, _: Any) -> None:
        """End the training in order after the present step; the same signal again ends it at once."""
        self.stop, name = True, "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self.bar.echo(f"stopping: everything is saved after this step; {name} again ends at once")
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

    def advance(self, found: str = "") -> None:
        """Update the progress bar; `found` stays beside it until the next one."""
        self.found, done = found or self.found, self.state.decisions
        self.bar.show(done, self.found, f"{done:,} of {self.config.steps:,} decisions, {self.found}")

    def _on_training_start(self) -> None:
        """Also at the end of every rollout."""
        self.start_s, self.start_periods = time.perf_counter(), self.state.periods
        self.venv.waited_s = 0.0

    def _on_rollout_start(self) -> None:
        begun, state, options = time.perf_counter(), self.state, self.config.log
        check_finite(self.model.policy)
        if not self.stop and (state.evaluated < 0 or state.decisions >= state.evaluated + options.evaluate_every):
            self.evaluate()
        if begun - self.saved_s >= options.checkpoint_s:
            self.save()
        self.start_s += time.perf_counter() - begun  # which is no part of the training time

    def _on_step(self) -> bool:
        state = self.state
        for info in self.locals["infos"]:
            state.periods += info["periods"]
            state.episodes += "figures" in info
            for name, value in info.get("figures", {}).items():
                self.logger.record_mean(f"rollout/{name}", value)
        state.decisions = self.num_timesteps
        self.advance()
        return not self.stop

    def _on_rollout_end(self) -> None:
        seconds = time.perf_counter() - self.start_s
        self.state.seconds += seconds
        rate, waiting = (self.state.periods - self.start_periods) / seconds, self.venv.waited_s / seconds
        self._on_training_start()
        for name, value in (self.clock() | {"periods_per_s": rate, "waiting_share": waiting}).items():
            self.logger.record(f"time/{name}", value)
        area = self.logger.name_to_value.get("rollout/auc")
        self.advance(f"{'' if area is None else f'area {area:.3f}, '}{rate:,.0f} steps/s, waiting {waiting:.0%}")

    def _on_training_end(self) -> None:
        check_finite(self.model.policy)
        if not self.stop and self.state.evaluated != self.state.decisions:
            self.evaluate()
        self.save()

    def clock(self) -> dict[str, Any]:
        """How far the run has come."""
        return self.state.model_dump(include=set(CLOCK))

    def save(self) -> None:
        """Write a checkpoint, then remove the oldest ones."""
        returns = self.venv.ret_rms
        self.state.returns = float(returns.mean), float(returns.var), float(returns.count)
        buffer = io.BytesIO()
        save_to_zip_file(buffer, params=self.model.get_parameters() | {"state": self.state.model_dump()})
        write_atomic(self.folder / "checkpoints" / f"{self.state.decisions:012d}.zip", buffer.getvalue())
        for old in checkpoints(self.folder)[: -self.config.log.keep]:
            old.unlink()
        if not self.config.log.evaluate_buildings:
            self.keep_policy()
        self.saved_s = time.perf_counter()

    def keep_policy(self, **facts: Any) -> None:
        """Make the policy the one that is loaded from the folder; `facts` describe its origin."""
        facts |= {"decisions": self.state.decisions, "seconds": round(self.state.seconds)}
        save_policy(self.folder, self.model.policy, self.config.algorithm, facts)

    def evaluate(self) -> None:
        """Evaluate on the validation split; the best policy so far is the one that is loaded from the folder."""
        state, score = self.state, self.config.score
        state.evaluated = state.decisions
        if not self.config.log.evaluate_buildings:
            return
        figures = self.figures(self.config.log.evaluate_buildings)
        for name, value in {**self.clock(), **figures}.items():
            self.loggers[1].record(f"validation/{name}", value)
        self.loggers[1].dump(state.decisions)
        best = figures[score] > state.best_score
        self.bar.echo(f"{state.decisions:,} decisions: {in_words(figures)}{' (best)' if best else ''}")
        if best:
            state.best_score = figures[score]
            self.keep_policy(validation=figures)

    def figures(self, buildings: int) -> dict[str, float]:
        """The mean of each metric over the buildings, one episode in each, their number `n`, and a standard error.

        The policy takes its most probable action; building and seed of each episode are always the same.
        """
        found: list[dict[str, float]] = []

        def collect(scope: dict[str, Any], _: dict[str, Any]) -> None:
            if scope["done"]:
                found.append(scope["info"]["figures"])

        self.validation = self.validation or make_validation(self.config)
        self.validation.seed(0)
        model: Any = self.model  # of any algorithm
        masked = isinstance(model, MaskablePPO)
        evaluate_policy(model, self.validation, buildings, callback=collect, warn=False, use_masking=masked)
        means = {name: float(np.mean([episode[name] for episode in found])) for name in FIGURES}
        error = float(np.std([episode["auc"] for episode in found])) / max(1, len(found) - 1) ** 0.5
        return means | {"auc_error": error, "n": len(found)}


def in_words(figures: dict[str, float]) -> str:
    """What an evaluation found."""
    error = f" +- {figures['auc_error']:.4f}" if figures["n"] > 1 else ""  # one building has no deviation
    pose = f"pose error {100.0 * figures['pose_error_final_m']:.1f} cm, coverage {figures['coverage']:.1%}"
    score = f"correct coverage over steps {figures['correct_over_steps']:.4f}"
    return f"area under the curve {figures['auc']:.4f}{error}, {pose}, {score}"
