"""The folder of a run: everything that is needed to repeat it, and its results."""

from __future__ import annotations

import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn

import mecp_env
from mecp_env.core.errors import ConfigError
from mecp_env.core.paths import write_atomic
from mecp_env.core.provenance import commit
from mecp_env.learning import files
from mecp_env.learning.checkpoints import Checkpoints, TrainingState
from mecp_env.learning.config import TrainConfig, read_config
from mecp_env.learning.files import write_json

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
