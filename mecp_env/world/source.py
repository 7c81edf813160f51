"""Where the building of an episode comes from: always the same one, or a new one at every reset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from mecp_env.errors import ConfigError
from mecp_env.world.generator import SPLITS, GeneratorSpec, generate, split_seed
from mecp_env.world.layout import load_layout
from mecp_env.world.schema import Layout

GENERATE = "generate"  # the key of a layout given as a specification
Split = Literal["train", "validation", "test"]


class Source(Protocol):
    """Buildings, numbered from 0."""

    @property
    def count(self) -> int:
        """How many there are; 1: always the same."""
        ...

    def layout(self, building: int) -> Layout:
        """The building of that number. Raises `ConfigError` for one that does not exist."""
        ...


@dataclass(frozen=True, slots=True)
class OneLayout:
    """The same building at every reset."""

    given: Layout
    count: int = 1

    def layout(self, building: int) -> Layout:
        return self.given


@dataclass(frozen=True, slots=True)
class GeneratedLayouts:
    """The generated buildings of a split."""

    spec: GeneratorSpec
    split: str

    @property
    def count(self) -> int:
        return len(SPLITS[self.split])

    def layout(self, building: int) -> Layout:
        return generate(self.spec, split_seed(self.split, building))


def make_source(given: str | Mapping[str, Any] | Layout) -> Source:
    """The source that the field `layout` of a configuration stands for.

    A shipped name, a path or a layout is one building; `{"generate": {...}}` the generated ones, with the fields of
    `GeneratorSpec`, `difficulty` and `split`. Raises `ConfigError` or `LayoutError`.
    """
    if isinstance(given, Mapping) and GENERATE in given:
        if set(given) != {GENERATE} or not isinstance(given[GENERATE], Mapping):
            raise ConfigError(f"layout: {{{GENERATE!r}: {{...}}}} stands alone, given {sorted(map(str, given))}")
        return _generated(**given[GENERATE])
    return OneLayout(load_layout(dict(given) if isinstance(given, Mapping) else given))


def _generated(difficulty: str = "medium", split: str = "train", **fields: Any) -> GeneratedLayouts:
    if split not in SPLITS:
        raise ConfigError(f"split: {split!r:.80} is none of {', '.join(SPLITS)}")
    return GeneratedLayouts(GeneratorSpec.preset(difficulty, **fields), split)


def generator_keywords(keywords: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keywords of `Rooms-v0`, those of the buildings and those of the environment."""
    mine = {"difficulty", "split", *GeneratorSpec.model_fields}
    spec = {name: value for name, value in keywords.items() if name in mine}
    return spec, {name: value for name, value in keywords.items() if name not in mine}


def draw_building(source: Source, rng: np.random.Generator) -> int:
    """The number of the next building; a source of one draws nothing."""
    return int(rng.integers(source.count)) if source.count > 1 else 0


def check_building(number: Any, source: Source) -> int | None:
    """`number` if there is a building of that number, or None. Raises `ConfigError`."""
    if number is None:
        return None
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise ConfigError(f"building: expected a whole number, given {number!r:.80}")
    if not 0 <= number < source.count:
        raise ConfigError(f"building: {number}, there are {source.count}, numbered from 0")
    return int(number)
