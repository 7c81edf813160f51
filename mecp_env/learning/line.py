"""The command line of a training run: a configuration file below, the options that the line names above."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from mecp_env.config import merge
from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import ALGORITHMS, TrainConfig, check_algorithm, read_config

PLACES = {"config", "out", "resume"}  # options that say where, and are no part of a configuration
EXAMPLES = """Examples:
  python -m mecp_env.learning.train maskable_ppo
  python -m mecp_env.learning.train maskable_ppo --steps 50000 --seed 1 --env.estimator truth --out runs/truth-1
  python -m mecp_env.learning.train ppo --buildings.difficulty easy --environments 4
  python -m mecp_env.learning.train maskable_ppo --config runs/truth-1/config.json --seed 2
  python -m mecp_env.learning.train --resume runs/truth-1"""


@dataclass(frozen=True)
class Options:
    """Train an agent; every field of the environment and every hyper-parameter is an option."""

    config: Path | None = None  # a configuration file (JSON), such as the config.json of a run; options stand above it
    out: Path | None = None  # the folder of the run; default: runs/ALGORITHM-SEED
    resume: Path | None = None  # go on with the run in this folder
    fields: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class Order:
    """What a command line asks for."""

    config: TrainConfig
    folder: Path
    resume: bool


def parse(words: Sequence[str]) -> Order:
    """The order of a command line (without the program's name).

    Raises `ConfigError`; ends the process after `--help`, and with 2 for an option that there is not.
    """
    algorithm, line = split(words)
    options: Options = tyro.cli(
        Options,
        prog=f"python -m mecp_env.learning.train {algorithm or '{' + ','.join(ALGORITHMS) + '}'}",
        description=f"{Options.__doc__}\n\n{EXAMPLES}",
        args=line,
        default=Options(fields=TrainConfig.build({"algorithm": algorithm} if algorithm else {})),
        config=(tyro.conf.AvoidSubcommands,),
    )
    return resumed(options, algorithm, line) if options.resume else begun(options, algorithm, line)


def split(words: Sequence[str]) -> tuple[str | None, list[str]]:
    """The algorithm, if the line begins with a word, and the options."""
    if words and not words[0].startswith("-"):
        return check_algorithm(words[0]), list(words[1:])
    return None, list(words)


def begun(options: Options, algorithm: str | None, line: Sequence[str]) -> Order:
    """A new run."""
    below = read_config(options.config) if options.config else {}
    if algorithm is None and "algorithm" not in below:
        raise ConfigError(f"algorithm: missing; one of {', '.join(ALGORITHMS)}")
    below |= {"algorithm": algorithm} if algorithm else {}
    config = TrainConfig.build(merge(below, chosen(options.fields, line)))
    return Order(config, options.out or Path("runs") / f"{config.algorithm}-{config.seed}", resume=False)


def resumed(options: Options, algorithm: str | None, line: Sequence[str]) -> Order:
    """A run that goes on as it was configured; it may be made longer."""
    assert options.resume is not None
    fields = read_config(options.resume / "config.json")
    above = chosen(options.fields, line)
    others = sorted(set(above) - {"steps"}) + [name for name in ("config", "out") if getattr(options, name)]
    if others or algorithm not in (None, fields.get("algorithm")):
        raise ConfigError(f"resume: the run in {options.resume} has its configuration; only --steps may be given")
    return Order(TrainConfig.build(merge(fields, above)), options.resume, resume=True)


def chosen(fields: TrainConfig, line: Sequence[str]) -> dict[str, Any]:
    """Only those of the fields that the line names."""
    given = fields.model_dump(mode="json")
    named_ones: dict[str, Any] = {}
    for option in line:
        path = option.removeprefix("--").partition("=")[0]
        if option.startswith("--") and path.replace("-", "_") not in PLACES:
            named_ones = merge(named_ones, named(given, path))
    return named_ones


def named(fields: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Of all fields the one at `path` (`env.laser.max-range-m`; a switch also as `ppo.no-anneal`)."""
    first, _, rest = path.partition(".")
    name = first.replace("-", "_")
    name = name if name in fields else name.removeprefix("no_")
    return {name: named(fields[name], rest) if rest else fields[name]}


def words_of_this_process() -> list[str]:
    """The command line of this process, without the program's name."""
    return sys.argv[1:]
