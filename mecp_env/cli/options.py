"""Options that several commands share: fields of a configuration, `--with`, `--save-map`, `--rerun`, and buildings.

How a command line names buildings: shipped names, hard:7, hard:0-9, files, folders.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args, get_origin, get_type_hints

import tyro
from pydantic import BaseModel, model_validator

from mecp_env.cli.base import FAILED, Command, Line, check_writable, echo, one_of, print_error
from mecp_env.config import EnvConfig, Number, RewardConfig, merge
from mecp_env.core.errors import ConfigError, LayoutError, MecpError
from mecp_env.core.files import exists, is_folder
from mecp_env.core.settings import Settings, guess
from mecp_env.episode.tasks import TASKS
from mecp_env.world.config import DIFFICULTIES, SPLITS, GeneratorSpec

if TYPE_CHECKING:
    from mecp_env.render.rerun_log import RerunLog
    from mecp_env.world.schema import Layout

Estimator = Literal["slam", "known", "truth"]
MOST_SEEDS = 10_000
SERIES = re.compile(rf"({'|'.join(DIFFICULTIES)}):(\d{{1,18}})(?:-(\d{{1,18}}))?")
NONE_GIVEN = "name at least one building; `mecp-env worlds list` lists them"

DifficultyName = Annotated[str, one_of("difficulty", DIFFICULTIES)]  # or empty
SplitName = Annotated[str, one_of("split", SPLITS)]
TaskName = Annotated[str, one_of("task", TASKS)]
Kind = Literal["layout", "houseexpo", "map_server", "image", "labelled"]
Buildings = Annotated[
    tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="BUILDING ...", help_behavior_hint="")
]


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


@dataclass(frozen=True, kw_only=True)
class WithModules(Command):
    """A command that knows what modules of the user register: associators, filters, rewards, policies, ..."""

    # a module of yours that registers custom parts by name, such as my_parts for my_parts.py; may be given again
    modules: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="with", metavar="MODULE")] = ()

    @classmethod
    def completed(cls, line: Line) -> Line:
        """The line with the preset of the reward that weights without one stand for."""
        return with_reward_preset(line)


@dataclass(frozen=True, kw_only=True)
class KeepsMap(WithModules):
    """A command whose run may be recorded, and whose map may be kept."""

    rerun: Path | None = None  # file for a recording of the rerun viewer (.rrd)
    save_map: Path | None = None  # file for the map, which the estimator can localise in (a .zip)

    def check_map(self, layout: str, estimator: str) -> None:
        """Raise `ConfigError` where the map of a run cannot be written or would be of no use.

        A map of this version is replaced, any other file is not.
        """
        if self.save_map is None:
            return
        spare_sources([check_writable(self.save_map, "--save-map")], [layout])
        if estimator == "known":
            raise ConfigError(
                f"--save-map: {self.save_map}: a map of the estimator 'known' localises with ground truth only"
            )
        from mecp_env.slam.map_file import MapError, SlamMap  # compiled functions are loaded only where a map is read

        try:
            if exists(self.save_map):
                SlamMap.load(self.save_map)
        except MapError as error:
            raise ConfigError(f"--save-map: {error}; name another file") from None

    def keep_map(self, owner: Any) -> int:
        """Write the map of a `MecpEnv` or `SlamPipeline`, if it is wanted; 1 where it cannot be written, else 0.

        The reason is printed then, and the run keeps everything else.
        """
        if self.save_map is None:
            return 0
        try:
            owner.save_map(self.save_map)
        except (MecpError, OSError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            print_error(f"--save-map: {self.save_map} was not written: {reason}")
            return FAILED
        echo(f"map: {self.save_map}")
        return 0

    def recording(self, period_s: float = 0.4) -> RerunLog | None:
        """The recording for the rerun viewer, if it is wanted. Raises `ConfigError` where it cannot be written."""
        if self.rerun is None:
            return None
        from mecp_env.render.rerun_log import RerunLog

        if self.rerun.suffix != ".rrd":
            raise ConfigError(f"--rerun: {self.rerun}: expected a file name that ends in .rrd")
        return RerunLog(check_writable(self.rerun, "--rerun"), period_s)

    def end_recording(self, log: RerunLog | None) -> None:
        """End the file, and print where it is."""
        if log is not None:
            log.close()
            echo(f"recording: {self.rerun} (rerun {self.rerun})")


@dataclass(frozen=True)
class Reading:
    """How plans are read, where the files do not say it themselves (docs/plans.md)."""

    resolution_m: float | None = None  # metres per pixel, of an image without a map_server yaml
    kind: Kind | None = None  # what a file is; only an image of rooms in colours must be said to be labelled
    free_above: int | None = None  # grey levels above this are floor, 0 to 254; default: found from the image
    door_width_m: tuple[float, float] | None = None  # narrowest and widest doorway; default: 0.3 1.9
    door_depth_m: float | None = None  # of the deepest doorway; a longer passage is a corridor; default: 1
    smallest_room_m2: float | None = None  # a smaller part of the floor belongs to its neighbour; default: 1
    straighten: bool = True  # turn walls to the directions of the building

    def options(self) -> dict[str, Any]:
        """The options of `load_plan` that are given."""
        return {name: value for name, value in asdict(self).items() if value is not None and value is not True}

    def expand(self, word: str) -> list[str]:
        """The single buildings that a word stands for: `medium:0-2` is three, a folder the plans in it and below.

        Raises `ConfigError` for a preset without a seed, a range that runs backwards or is too long, an empty folder,
        and `LayoutError` for a folder with a link out of it.
        """
        if word in DIFFICULTIES:
            raise ConfigError(f"{word}: which buildings? Give seeds, as {word}:0 or {word}:0-9")
        series = SERIES.fullmatch(word)
        if series:
            return _series(word, series[1], int(series[2]), int(series[3] or series[2]))
        if not word or not is_folder(word):
            return [word]
        from mecp_env.floorplans import plan_files

        with printed_notes():
            return [str(path) for path in plan_files(Path(word), self.kind, images=self.resolution_m is not None)]

    def one(self, word: str, option: str = "layout") -> str:
        """The only building that a word stands for. Raises as `expand`, and `ConfigError` for a word of several."""
        first, *others = self.expand(word)
        if others:
            raise ConfigError(f"{option}: {word} is {1 + len(others)} buildings; name one building, as {first}")
        return first

    def resolve(self, word: str) -> str | Layout:
        """What the environment is given as layout: a shipped name as it is, so that a recipe stays short.

        Raises `LayoutError` or `ConfigError` for a word that is no building, or several.
        """
        from mecp_env.world.layout import shipped_layouts  # loaded only here, so that help and errors come at once

        word = self.one(word)
        return word if word in shipped_layouts() else self.load(word)

    def load(self, word: str) -> Layout:
        """The checked layout of a single building. Raises `LayoutError`, and `ConfigError` for wrong options."""
        from mecp_env.world.layout import load_layout, shipped_layouts

        series = SERIES.fullmatch(word)
        if series:
            from mecp_env.world.generator import generate

            return generate(GeneratorSpec.preset(series[1]), int(series[2]))
        if word in shipped_layouts():
            return load_layout(word)
        if not word or not exists(word):
            raise _no_such(word)
        from mecp_env.floorplans import load_plan

        with printed_notes():
            return load_plan(word, **self.options())


def _series(word: str, preset: str, first: int, last: int) -> list[str]:
    if last < first:
        raise ConfigError(f"{word}: the first seed comes first, as {preset}:{last}-{first}")
    if last - first >= MOST_SEEDS:
        raise ConfigError(f"{word}: {last - first + 1} buildings, from 1 to {MOST_SEEDS} in a series")
    return [f"{preset}:{seed}" for seed in range(first, last + 1)]


@contextmanager
def printed_notes() -> Iterator[None]:
    """Within it what is warned of is kept; it is printed at the end, a line each."""
    with warnings.catch_warnings(record=True, action="always") as found:
        yield
    for warning in found:
        print_error(f"note: {warning.message}")


@dataclass(frozen=True, kw_only=True)
class ReadsPlans(Command):
    """A command that reads buildings, which may be plans."""

    reading: Annotated[Reading, tyro.conf.OmitArgPrefixes] = field(default_factory=Reading)


def spare_sources(written: Iterable[Path], words: Iterable[str]) -> None:
    """Raise `ConfigError` if a file that will be written is one that these buildings, logs or maps are read from."""
    sources = [source for word in words for source in _sources(Path(word))]
    for path in written:
        if any(exists(path) and path.samefile(source) for source in sources):
            raise ConfigError(f"{path} is what is read and would be overwritten; name another file")


def _sources(path: Path) -> list[Path]:
    """The files that a plan is read from: its own, and the image that a map_server yaml names."""
    from mecp_env.floorplans.map_server import image_of

    image = image_of(path) if path.suffix.lower() in (".yaml", ".yml") else None
    return [source for source in (path, image) if source is not None and exists(source)]


def stem(word: str) -> str:
    """A name for what is kept of a building: `hard-7` for `hard:7`, of a file its name without ending."""
    return Path(word).stem if exists(word) else word.replace(":", "-")


def counted(layout: Layout) -> str:
    """How many rooms, doors and obstacles there are, in words."""
    parts = ((len(layout.rooms), "room"), (len(layout.doors), "door"), (len(layout.obstacles), "obstacle"))
    return ", ".join(f"{n} {word}{'' if n == 1 else 's'}" for n, word in parts)


def _no_such(word: str) -> MecpError:
    from mecp_env.world.layout import shipped_layouts

    preset, _, seeds = word.partition(":")
    if preset in DIFFICULTIES:
        return ConfigError(
            f"{word}: seeds are whole numbers, as {preset}:7, or a range of them, as {preset}:0-9; 18 digits at most"
        )
    shipped, presets = ", ".join(shipped_layouts()), ", ".join(f"{name}:SEED" for name in DIFFICULTIES)
    nearest = guess(word, [*shipped_layouts(), *(f"{name}:{seeds or 0}" for name in DIFFICULTIES)])
    return LayoutError(f"{word or repr(word)}: no such file or building; there are {shipped}, {presets}{nearest}")
