"""The folder of a run: all that is needed to repeat it, and what came of it."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from torch import nn

import mecp_env
from mecp_env.core.errors import ConfigError
from mecp_env.learning import files
from mecp_env.learning.checkpoints import Checkpoints
from mecp_env.learning.config import TrainConfig, read_config

PACKAGES = ("gymnasium", "numpy", "numba", "pymunk", "torch", "stable-baselines3", "sb3-contrib", "safetensors")
CONFIG, ABOUT, POLICY, LOCK = "config.json", "run.json", "policy.json", ".lock"


class RunFolder:
    """Paths and files of a run."""

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        self.checkpoints = Checkpoints(folder / "checkpoints", config.log.keep)
        self.held: Any = None

    def hold(self) -> None:
        """Let no other process train here until `close`. Raises `ConfigError` when one does."""
        try:
            self.held = files.lock(self.folder / LOCK)
        except BlockingIOError:
            raise ConfigError(f"out: {self.folder} is being trained by another process") from None

    def take_up(self) -> None:
        """Hold the folder of a run that goes on.

        Raises `ConfigError`, with nothing written, when another process trains there, or for fewer steps than it has
        made; a run that ended as it was configured may have made a few more, those of its last update.
        """
        self.hold()
        made, steps = self.checkpoints.decisions(), self.config.steps
        if steps < made and steps != TrainConfig.build(read_config(self.folder / CONFIG)).steps:
            raise ConfigError(f"steps: {steps}, but the run in {self.folder} has made {made} decisions already")

    def close(self) -> None:
        """Let others train here."""
        if self.held is not None:
            self.held.close()

    def begin(self) -> None:
        """Make the folder and hold it. Raises `ConfigError` where a run is already, or nothing can be written."""
        if (self.folder / CONFIG).exists():
            raise ConfigError(f"out: {self.folder} holds a run; --resume {self.folder} goes on with it")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.hold()
            self.keep_config()
        except OSError as error:
            raise ConfigError(f"out: {self.folder}: {error.strerror}; choose another place with --out") from None
        self.note("begun")

    def keep_config(self) -> None:
        """Write the configuration."""
        write_json(self.folder / CONFIG, self.config.to_dict())

    def note(self, what: str) -> None:
        """Add a line to `run.json`: when, by which command, with which versions something was done."""
        path = self.folder / ABOUT
        known = json.loads(path.read_text()) if path.exists() else []
        write_json(path, [*known, {"event": what, **surroundings()}])

    def keep_policy(self, policy: nn.Module, facts: Mapping[str, Any]) -> None:
        """Make these the weights that are loaded from this folder; `facts` say where they come from.

        Raises `NotFiniteError`; the weights from before then stay.
        """
        files.check_finite(policy)
        save_policy(self.folder, policy, self.config.algorithm, facts)


def save_policy(folder: Path, policy: nn.Module, algorithm: str, facts: Mapping[str, Any]) -> None:
    """Write weights, then `policy.json`, which names them with their checksum, then remove older ones."""
    data = files.tensor_bytes(files.weights_of(policy))
    sha256 = files.checksum(data)
    name = f"policy-{sha256[: files.NAME_LENGTH]}.safetensors"
    files.write_whole(folder / name, data)
    about = {"algorithm": algorithm, "file": name, "sha256": sha256, "bytes": len(data), **facts}
    write_json(folder / POLICY, about)
    for old in folder.glob("policy-*.safetensors"):
        if old.name != name:
            old.unlink()


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, whole."""
    files.write_whole(path, (json.dumps(value, indent=2) + "\n").encode())


def surroundings() -> dict[str, Any]:
    """When, how and with what this process runs."""
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(["python", "-m", "mecp_env.learning.train", *sys.argv[1:]]),
        "commit": commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "versions": {"mecp_env": mecp_env.__version__} | {name: installed(name) for name in PACKAGES},
    }


def installed(package: str) -> str:
    """The version of a package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def commit() -> str:
    """The commit of the clone that this runs from, with a `+` when something was changed since; "" elsewhere."""
    here = Path(__file__).parent
    try:
        name = git(here, "rev-parse", "HEAD")
        return name + ("+" if git(here, "status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return ""


def git(folder: Path, *words: str) -> str:
    """What git says."""
    done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()


class Table:
    """A CSV file that grows by a row at a time; a row goes to the disk at once."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path, self.columns = path, list(columns)

    def cut(self, decisions: int) -> None:
        """Forget the rows beyond so many decisions: they will be made again."""
        rows = [row for row in self.rows() if float(row["decisions"]) <= decisions]
        text = io.StringIO()
        writer = csv.DictWriter(text, self.columns, extrasaction="ignore", restval="")
        writer.writeheader()
        writer.writerows(rows)
        files.write_whole(self.path, text.getvalue().encode())

    def add(self, values: Mapping[str, float]) -> None:
        """Append a row; a column without a value stays empty."""
        row = {name: f"{values[name]:.6g}" for name in self.columns if name in values}
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, self.columns, restval="").writerow(row)

    def rows(self) -> list[dict[str, str]]:
        """All rows that are whole."""
        if not self.path.exists():
            return []
        with self.path.open(newline="", errors="replace") as file:  # after a power failure a tail may be cut or zeros
            whole = [line for line in file if line.endswith("\n") and "\0" not in line]
        return [row for row in csv.DictReader(whole) if row.get("decisions")]
