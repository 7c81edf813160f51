"""The folder of a run: everything that is needed to repeat and to continue it."""

from __future__ import annotations

import io
import json
import os
import platform
import shlex
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file

import mecp_env
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.provenance import commit
from mecp_env.learning.config import CONFIG, TrainConfig, WeightError, read_config
from mecp_env.learning.exported import check_archive
from mecp_env.learning.files import MOST_POLICY_BYTES, check_finite, write_json

fcntl: Any
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
