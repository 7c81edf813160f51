"""The source of an episode's building: always the same one, or a new one at every reset."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.core.files import is_folder
from mecp_env.core.processes import Failure
from mecp_env.core.settings import Names, guess, load_parts, shown
from mecp_env.floorplans import PlanOptions, load_plan, plan_files
from mecp_env.world.config import DIFFICULTIES, SPLITS, GeneratorSpec, split_seed
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout
from mecp_env.world.schema import Layout

GENERATE, PLAN = "generate", "plan"  # the keys of a layout given as a specification, and as plans
KEPT_PLANS = 100  # that are read and not read again
KEYWORDS = {  # beside the fields of the environment's configuration
    GENERATE: ("difficulty", "split", *GeneratorSpec.model_fields),
    PLAN: ("plan", "kind", *PlanOptions.model_fields),
}


@dataclass(frozen=True, slots=True)
class Source:
    """Buildings, numbered from 0."""

    layout: Callable[[int], Layout]  # the building of a number
    count: int = 1  # how many there are; 1: always the same

    @property
    def all(self) -> int:
        """One more than the largest number that names a building."""
        return self.count


@dataclass(frozen=True, slots=True)
class GeneratedLayouts(Source):
    """The generated buildings of a split: those of the chosen difficulties, and of any other one on request.

    Building n of the k-th chosen difficulty has the number k * size + n, size being that of the split; after the chosen
    ones come all difficulties in their order, so that a number names one building.
    """

    spec: Callable[[Any], GeneratorSpec] = GeneratorSpec.preset  # of a difficulty
    difficulties: tuple[str, ...] = ()  # the chosen ones, then all
    size: int = 0

    @property
    def all(self) -> int:
        return len(self.difficulties) * self.size

    def of_difficulty(self, difficulty: Any) -> range:
        """The numbers of its buildings. Raises `ConfigError` for an unknown one."""
        self.spec(difficulty)
        first = self.difficulties.index(difficulty) * self.size
        return range(first, first + self.size)


@dataclass(frozen=True, slots=True)
class PlanFiles(Source):
    """Real floor plans; the last ones are kept as they were read."""

    paths: tuple[Path, ...] = ()


def register_buildings(name: str, make: Callable[..., Any]) -> None:
    """Let `layout={name: {...}}` stand for the buildings of `make(**fields)`, which has `count` and `layout(building)`.

    `count` is their number, at least 1; `layout` returns the building of a number from 0 on as anything that
    `load_layout` takes, and always the same. Such a configuration works in every environment of this process, and in
    workers that are forked from it or import what registers the name. A name that was registered before is replaced.
    Raises `ConfigError` for a key of ours or of a layout, and for what is no name.
    """
    if not callable(make):
        raise ConfigError(f"make: {shown(make)}, a class or function expected")
    NAMES.add(name)
    SOURCES[name] = partial(_custom, name, make)


def _custom(name: str, make: Callable[..., Any], **fields: Any) -> Source:
    """The buildings of a registered source, each checked as a layout file is."""
    try:
        made = make(**fields)
    except Exception as error:  # code of the user may raise anything
        reason = error if isinstance(error, TypeError) else Failure.of(error).reason
        raise ConfigError(f"layout: {name}: {reason}") from error
    count = getattr(made, "count", None)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1 or not hasattr(made, "layout"):
        raise ConfigError(f"layout: {name}: expected a method `layout` and a `count` of 1 or more, got {shown(count)}")

    def layout(building: int) -> Layout:
        try:
            return load_layout(made.layout(building))
        except LayoutError as error:
            raise LayoutError(f"{name}: building {building}: {error}") from None
        except Exception as error:
            raise LayoutError(f"{name}: building {building}: {Failure.of(error).reason}") from error

    return Source(layout, count)


def make_source(given: str | Mapping[str, Any] | Layout) -> Source:
    """The source that the field `layout` of a configuration stands for.

    A shipped name, a path or a layout is one building; `{"generate": {...}}` the generated ones, with the fields of
    `GeneratorSpec`, `difficulty` and `split`; `{"plan": {"path": ...}}` a real floor plan or a folder of them, with the
    options of `load_plan`; a name of `register_buildings` those. Raises `ConfigError` or `LayoutError`.
    """
    fields: Any = given if isinstance(given, Mapping) else {}
    key = source_in(fields)
    if key is None:
        check_registered(fields)
        layout = load_layout(dict(fields) if isinstance(given, Mapping) else given)
        return Source(lambda _: layout)
    if set(fields) != {key} or not isinstance(fields[key], Mapping):
        raise ConfigError(f"layout: {{{key!r}: {{...}}}} stands alone, given {sorted(map(str, fields))}")
    return SOURCES[key](**fields[key])


def source_in(fields: Mapping[Any, Any]) -> str | None:
    """The name of the source in `{name: {...}}`, which an installed package may announce; None without one."""
    if len(fields) == 1 and not fields.keys() & {*SOURCES, *Layout.model_fields}:
        load_parts()
    return next((key for key in SOURCES if key in fields), None)


def check_registered(fields: Mapping[Any, Any]) -> None:
    """Raise `ConfigError` for `{name: {...}}` of a source that is not registered; a layout has other fields."""
    name = next(iter(fields), None)
    if len(fields) == 1 and isinstance(fields[name], Mapping) and name not in Layout.model_fields:
        known = ", ".join(NAMES.others) or "none yet"
        raise ConfigError(
            f"layout: {shown(name)}: not registered by register_buildings (registered: {known})"
            f"{guess(str(name), NAMES.others)}; import the module that registers it"
        )


def _generated(difficulty: Any = "medium", split: str = "train", **fields: Any) -> GeneratedLayouts:
    split_seed(split, 0)
    chosen = (difficulty,) if isinstance(difficulty, str) else difficulty
    if not isinstance(chosen, list | tuple) or not chosen:
        known = ", ".join(DIFFICULTIES)
        raise ConfigError(f"difficulty: {shown(difficulty)}, expected one of {known}, or a list of them")

    def spec(difficulty: Any) -> GeneratorSpec:
        return GeneratorSpec.preset(difficulty, **fields)

    for name in chosen:
        spec(name)
    difficulties, size = (*chosen, *DIFFICULTIES), len(SPLITS[split])

    def layout(building: int) -> Layout:
        kind, number = divmod(building, size)
        return generate(spec(difficulties[kind]), split_seed(split, number))

    return GeneratedLayouts(layout, len(chosen) * size, spec, difficulties, size)


def _plans(path: Any = None, **reading: Any) -> PlanFiles:
    """The plan at `path`, or all in that folder and those in it, in the order of their paths."""
    place = Path(_path(path))
    images = reading.get("resolution_m") is not None
    paths = plan_files(place, reading.get("kind"), images) if is_folder(place) else (place,)
    read = lru_cache(KEPT_PLANS)(lambda building: load_plan(paths[building], **reading))
    return PlanFiles(read, len(paths), paths)


def _path(given: Any) -> str:
    """The path that was given for plans. Raises `ConfigError` for what is none."""
    path = given.__fspath__() if isinstance(given, os.PathLike) else given
    if not isinstance(path, str) or not path:
        raise ConfigError(f"plan: the path of a floor plan, or of a folder of them, is needed (given: {shown(given)})")
    return path


NAMES = Names(GENERATE, PLAN, *Layout.model_fields)  # a dict with those of a layout is one
SOURCES: dict[str, Callable[..., Source]] = {GENERATE: _generated, PLAN: _plans}


def keywords_of(key: str, keywords: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keywords of `Rooms-v0` (GENERATE) or `FloorPlan-v0` (PLAN): those of its buildings, and those of the environment.

    Raises `ConfigError`.
    """
    given = {name: value for name, value in keywords.items() if name in KEYWORDS[key]}
    if "plan" in given:
        given["path"] = _path(given.pop("plan"))
    return given, {name: value for name, value in keywords.items() if name not in KEYWORDS[key]}


generator_keywords = partial(keywords_of, GENERATE)


def draw_building(numbers: range, rng: np.random.Generator) -> int:
    """One of the numbers; nothing is drawn where there is only one."""
    return numbers[int(rng.integers(len(numbers)))] if len(numbers) > 1 else numbers[0]


def choose_buildings(number: Any, difficulty: Any, source: Source) -> range:
    """The numbers of the buildings that the options of a reset allow, None standing for no option.

    Raises `ConfigError` for a building or difficulty that does not exist, and a difficulty of what is not generated.
    """
    numbers = range(source.count)
    if difficulty is not None:
        if not isinstance(source, GeneratedLayouts):
            raise ConfigError(f"difficulty: {shown(difficulty)}, only generated buildings have one")
        numbers = source.of_difficulty(difficulty)
    if number is None:
        return numbers
    chosen = numbers[check_number(number, len(numbers))]
    return range(chosen, chosen + 1)


def check_number(number: Any, count: int) -> int:
    """`number` if it is a whole number from 0 to `count` - 1. Raises `ConfigError`."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise ConfigError(f"building: expected a whole number, given {number!r:.80}")
    if not 0 <= number < count:
        raise ConfigError(f"building: {number}, there are {count}, numbered from 0")
    return int(number)
