"""Fields of a configuration as options: only those that the command line names are set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

import tyro
from pydantic import model_validator

from mecp_env.config import EnvConfig, Number, RewardConfig, merge
from mecp_env.core.settings import Settings
from mecp_env.world.schema import Layout


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


def named_options(line: Sequence[str]) -> set[str]:
    """The options that a line names, each without what follows a dot: `{"env", "max_steps"}`."""
    words = [word for word in line if word.startswith("--")]
    return {word[2:].partition("=")[0].partition(".")[0].replace("-", "_") for word in words}


def with_reward_preset(line: Sequence[str]) -> list[str]:
    """The line with the preset that weights of the reward without one stand for, as in `RewardConfig`."""
    added = list[str]()
    for prefix in ("--env.reward.", "--config.reward."):
        words = [word.removeprefix(prefix).partition("=")[0] for word in line if word.startswith(prefix)]
        named = dict.fromkeys(word.replace("-", "_") for word in words)
        preset = RewardConfig.completed(named).get("preset")
        added += [f"{prefix}preset", preset] if preset else []
    return [*line, *added]


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
