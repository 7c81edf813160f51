"""Fields of the environment's configuration as options: only those that the line names are set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import tyro

from mecp_env.config import EnvConfig, merge
from mecp_env.world.schema import Layout

PREFIX = "--config."


class Fields(EnvConfig):
    """Any field of the configuration."""

    layout: Annotated[str, tyro.conf.Suppress] = "paper"
    actions: Annotated[Literal["velocity", "discrete", "goal"], tyro.conf.Suppress] = "velocity"


def configuration(layout: str | Layout, fields: EnvConfig, line: Sequence[str]) -> EnvConfig:
    """The configuration in which only those fields are set that the command line names, to a default or not."""
    given = fields.model_dump(mode="json")
    chosen: dict[str, Any] = {}
    for option in line:
        if option.startswith(PREFIX):
            chosen = merge(chosen, named(given, option.removeprefix(PREFIX).partition("=")[0]))
    return EnvConfig.build(chosen, layout=layout)


def named(fields: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Of all fields the one at `path` (`laser.max-range-m`; a switch also as `slam.polygon.no-check-walls`)."""
    first, _, rest = path.partition(".")
    name = first.replace("-", "_")
    name = name if name in fields else name.removeprefix("no_")
    return {name: named(fields[name], rest) if rest else fields[name]}
