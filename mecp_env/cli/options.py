"""Options that several commands share: fields of a configuration, `--with`, `--save-map`, `--rerun`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args, get_origin, get_type_hints

import tyro
from pydantic import BaseModel, model_validator

from mecp_env.cli.base import Command, Line, check_writable, echo, print_error
from mecp_env.config import EnvConfig, Number, RewardConfig, merge
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.files import exists
from mecp_env.core.settings import Settings, guess
from mecp_env.world.schema import Layout

if TYPE_CHECKING:
    from mecp_env.render.rerun_log import RerunLog

Estimator = Literal["slam", "known", "truth"]


def hints(kind: type[Command], line: Line) -> list[str]:
    """What was probably meant by words that an option does not take."""
    known = dict(choices(kind))
    pairs = [(name, word) for name, word in pairwise(line) if word not in known.get(name, (word,))]
    return [f"{name} {word}{found}" for name, word in pairs if (found := guess(word, known[name]))]


def choices(kind: Any, prefix: str = "--") -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every option below a class that takes one of a few words, with these words."""
    for name, annotation in get_type_hints(kind, include_extras=True).items():
        plain, *marks = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
        option = f"{prefix}{name.replace('_', '-')}"
        if is_dataclass(plain) or (isinstance(plain, type) and issubclass(plain, BaseModel)):
            yield from choices(plain, prefix if tyro.conf.OmitArgPrefixes in marks else f"{option}.")
        elif words := _words(plain):
            yield option, words


def _words(annotation: Any) -> tuple[str, ...]:
    parts = get_args(annotation)
    return parts if get_origin(annotation) is Literal else tuple(word for part in parts for word in _words(part))


class Fields(EnvConfig):
    """Any field of the configuration."""

    layout: Annotated[str, tyro.conf.Suppress] = "paper"
    actions: Annotated[Literal["velocity", "discrete", "goal"], tyro.conf.Suppress] = "velocity"

    @model_validator(mode="after")
    def _has_tables(self) -> Self:
        given = self.observation.format
        if given != "dict":
            raise ValueError(f"observation.format: {given!r}, expected 'dict': the policies read its tables")
        return self


Fields.__name__ = "--config"  # errors then name the option


class EnvironmentFields(Fields):
    """Any field of the environment, where estimator and steps are options of their own."""

    estimator: Annotated[Literal["slam", "known", "truth"], tyro.conf.Suppress] = "slam"
    start: Literal["layout", "random"] | tuple[Number, Number, Number] = "random"
    max_steps: Annotated[int, tyro.conf.Suppress] = 3000


EnvironmentFields.__name__ = "--env"


def with_reward_preset(line: Line) -> Line:
    """The line with the preset that weights of the reward without one stand for, as in `RewardConfig`."""
    added = list[str]()
    for prefix in ("--env.reward.", "--config.reward."):
        preset = RewardConfig.completed(dict.fromkeys(line.named(prefix))).get("preset")
        added += [f"{prefix}preset", preset] if preset else []
    return Line([*line, *added])


def configuration(layout: str | Layout, fields: EnvConfig, line: Line) -> EnvConfig:
    """The configuration in which only those fields are set that the command line names, to a default or not."""
    return EnvConfig.build(named_fields(fields, line, "--config."), layout=layout)


def named_fields(fields: Settings, line: Line, prefix: str = "--") -> dict[str, Any]:
    """Those of the fields that the command line names, as a tree; options that are no field are left out."""
    given, chosen = fields.model_dump(mode="json"), dict[str, Any]()
    for path in line.named(prefix):
        if _name(given, path) in given:
            chosen = merge(chosen, _at(given, path))
    return chosen


def _at(fields: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Of all fields the one at `path` (`laser.max_range_m`; a switch also as `slam.polygon.no_check_walls`)."""
    name, rest = _name(fields, path), path.partition(".")[2]
    return {name: _at(fields[name], rest) if rest else fields[name]}


def _name(fields: Mapping[str, Any], path: str) -> str:
    first = path.partition(".")[0]
    return first if first in fields else first.removeprefix("no_")


def check_map(path: Path | None, layout: str, estimator: str) -> None:
    """Raise `ConfigError` where the map of a run cannot be written or would be of no use; None: no map is wanted.

    A map of this version is replaced, any other file is not.
    """
    if path is None:
        return
    from mecp_env.cli.buildings import spare_sources

    spare_sources([check_writable(path, "--save-map")], [layout])
    if estimator == "known":
        raise ConfigError(f"--save-map: {path}: a map of the estimator 'known' localises with ground truth only")
    from mecp_env.slam.map_file import MapError, SlamMap  # compiled functions are loaded only where a map is read

    try:
        if exists(path):
            SlamMap.load(path)
    except MapError as error:
        raise ConfigError(f"--save-map: {error}; name another file") from None


def save_map(owner: Any, path: Path | None) -> bool:
    """Write the map of a `MecpEnv` or `SlamPipeline`, if it is wanted, and print where it is.

    False where it cannot be written: the reason is printed, and the run keeps everything else.
    """
    if path is None:
        return True
    try:
        owner.save_map(path)
    except (MecpError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        print_error(f"--save-map: {path} was not written: {reason}")
        return False
    echo(f"map: {path}")
    return True


@dataclass(frozen=True, kw_only=True)
class WithModules(Command):
    """A command that knows what modules of the user register: associators, filters, rewards, policies, ..."""

    # a module of yours that registers custom parts by name, such as my_parts for my_parts.py; may be given again
    modules: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="with", metavar="MODULE")] = ()

    @classmethod
    def completed(cls, line: Line) -> Line:
        """The line with the preset of the reward that weights without one stand for."""
        return with_reward_preset(line)


def rerun_log(path: Path | None, period_s: float = 0.4) -> RerunLog | None:
    """The recording at `path`; None where none is wanted. Raises `ConfigError` where it cannot be written."""
    if path is None:
        return None
    from mecp_env.render.rerun_log import RerunLog, rerun_library

    if path.suffix != ".rrd":
        raise ConfigError(f"--rerun: {path}: expected a file name that ends in .rrd")
    try:
        rerun_library()
        return RerunLog(check_writable(path, "--rerun"), period_s)
    except (ConfigError, OSError) as error:
        raise ConfigError(f"{'' if '--rerun' in str(error) else '--rerun: '}{error}") from None


def end_rerun(log: RerunLog | None, path: Path | None) -> None:
    """End the file, and print where it is."""
    if log is not None:
        log.close()
        echo(f"recording: {path} (rerun {path})")
