"""`mecp-env train`: train a policy, or resume a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import tyro

from mecp_env.cli.base import FAILED, INTERRUPTED, Line, check_folder, echo, print_error, print_os_error
from mecp_env.cli.options import WithModules, named_fields
from mecp_env.config import merge
from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import ALGORITHMS, TrainConfig, check_algorithm, read_config

ENDS = {0: "done", FAILED: "failed, saved up to the last checkpoint", INTERRUPTED: "stopped"}


@dataclass(frozen=True)
class Train(WithModules):
    """Train a policy: maskable_ppo selects goals, ppo and recurrent_ppo drive by velocities. Every field of the
    environment and every hyperparameter is an option.

    Examples:
        mecp-env train maskable_ppo
        mecp-env train maskable_ppo --steps 50000 --seed 1 --env.estimator truth --out runs/truth-1
        mecp-env train maskable_ppo --task ActiveHalls-v0
        mecp-env train ppo --buildings.difficulty easy --environments 4
        mecp-env train maskable_ppo --config runs/truth-1/config.json --seed 2
        mecp-env train --resume runs/truth-1
    """

    algorithm: tyro.conf.Positional[str] = ""  # maskable_ppo, ppo or recurrent_ppo; with --config or --resume as there
    config: Path | None = None  # a JSON file such as the config.json of a run; options override it
    out: Path | None = None  # the run folder; default: runs/ALGORITHM-SEED
    resume: Path | None = None  # continue the run in this folder; only --steps may be changed
    fields: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    @classmethod
    def defaults(cls, line: Line) -> Self:
        """Those of the algorithm that the line starts with. Raises `ConfigError` for an unknown one."""
        named = bool(line) and not line[0].startswith("-")
        return cls(fields=TrainConfig.build({"algorithm": check_algorithm(line[0])} if named else {}))

    def run(self, line: Line) -> int:
        """Train to the end, or until Ctrl-C; 1 when a worker died, a weight is not finite, or the disk is full."""
        config, folder = self.resumed(line) if self.resume else self.new(line)
        code = self._train(config, folder)
        echo(f"{ENDS[code]}: {folder}")
        if code:
            echo(f"continue with: mecp-env train --resume {folder}")
        return code

    def _train(self, config: TrainConfig, folder: Path) -> int:
        """Train; the exit code. Raises `MecpError` before the training starts."""
        from mecp_env.policies.registry import INSTALL
        from mecp_env.vector import WorkerDied

        try:
            from mecp_env.learning.exported import NotFiniteError
            from mecp_env.learning.train import train
        except ModuleNotFoundError as error:
            raise ConfigError(f"train: needs {error.name}; {INSTALL}") from None
        try:
            return 0 if train(config, folder, resume=self.resume is not None) else INTERRUPTED
        except (WorkerDied, NotFiniteError) as error:
            print_error(error)
        except OSError as error:
            print_os_error(error)
        return FAILED

    def new(self, line: Line) -> tuple[TrainConfig, Path]:
        """Configuration and folder of a new run."""
        below = read_config(self.config) if self.config else {}
        if not self.algorithm and "algorithm" not in below:
            raise ConfigError(f"algorithm: missing; one of {', '.join(ALGORITHMS)}")
        below |= {"algorithm": self.algorithm} if self.algorithm else {}
        config = TrainConfig.build(merge(below, named_fields(self.fields, line)))
        return config, check_folder(self.out or Path("runs") / f"{config.algorithm}-{config.seed}")

    def resumed(self, line: Line) -> tuple[TrainConfig, Path]:
        """Configuration and folder of a run that continues; it may be made longer."""
        assert self.resume is not None
        fields = read_config(self.resume / "config.json")
        above = named_fields(self.fields, line)
        if set(above) - {"steps"} or self.config or self.out or self.algorithm not in ("", fields.get("algorithm")):
            raise ConfigError(f"resume: the run in {self.resume} has its configuration; only --steps may be given")
        return TrainConfig.build(merge(fields, above)), self.resume
