"""Fields of a configuration as options: only those that the command line names are set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import tyro

from mecp_env.config import EnvConfig, merge
from mecp_env.core.settings import Settings
from mecp_env.world.schema import Layout


class Fields(EnvConfig):
    """Any field of the configuration."""

    layout: Annotated[str, tyro.conf.Suppress] = "paper"
    actions: Annotated[Literal["velocity", "discrete", "goal"], tyro.conf.Suppress] = "velocity"


Fields.__name__ = "--config"  # errors then name the option


def configuration(layout: str | Layout, fields: EnvConfig, line: Sequence[str]) -> EnvConfig:
    """The configuration in which only those fields are set that the command line names, to a default or not."""
    return EnvConfig.build(named_fields(fields, line, "--config."), layout=layout)


def named_fields(fields: Settings, line: Sequence[str], prefix: str = "--") -> dict[str, Any]:
    """Those of the fields that the command line names, as a tree; options that are no field are left out."""
    given, chosen = fields.model_dump(mode="json"), dict[str, Any]()
    for option in line:
        path = option.removeprefix(prefix).partition("=")[0].replace("-", "_")
        if option.startswith(prefix) and _name(given, path) in given:
            chosen = merge(chosen, _at(given, path))
    return chosen


def _at(fields: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Of all fields the one at `path` (`laser.max_range_m`; a switch also as `slam.polygon.no_check_walls`)."""
    name, rest = _name(fields, path), path.partition(".")[2]
    return {name: _at(fields[name], rest) if rest else fields[name]}


def _name(fields: Mapping[str, Any], path: str) -> str:
    first = path.partition(".")[0]
    return first if first in fields else first.removeprefix("no_")
