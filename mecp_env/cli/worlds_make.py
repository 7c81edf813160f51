"""`mecp-env worlds generate | stats`: buildings from a specification, and what buildings are like, in figures.

`mecp-env worlds generate`: buildings from a specification and seeds.

`mecp-env worlds stats`: what buildings are like, in figures.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import tyro
from pydantic import Field
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from mecp_env.cli.base import Command, Seed, check_folder, check_writable
from mecp_env.cli.buildings import Buildings, Reading, ReadingOptions, counted, expand, load
from mecp_env.cli.exit_codes import echo
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import sanitised
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS, Difficulty, GeneratorSpec, Piece, Shape, split_seed
from mecp_env.world.schema import Layout

OPTION = "--difficulty"
RANGES = tuple(f"--{name.replace('_', '-')}" for name, value in GeneratorSpec() if isinstance(value, tuple))


@dataclass(frozen=True)
class Generate(Command):
    """Generate buildings: layout files whose rooms, doors and loops are known. Every field of the specification is an
    option; what is not given is what the difficulty has (`--difficulty hard --help` shows it)."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds generate --difficulty hard --seed 7",
        "mecp-env worlds generate --rooms 12 --loops 3 --count 20 --out runs/twelve --sheet runs/twelve.png",
        "mecp-env worlds generate --difficulty easy --split test --count 10",
    )

    difficulty: Difficulty = "medium"  # the preset below the other options
    seed: Seed = 0  # the first seed; with a split, the first building of the split
    count: Annotated[int, Field(ge=1, le=10_000)] = 1  # so many seeds, one after the other
    split: Literal["train", "validation", "test"] | None = None  # seeds kept apart, so that results compare
    out: Path = Path("runs/worlds")  # folder for DIFFICULTY-SEED.json, or for one building a .json file
    sheet: Path | None = None  # also draw all of them here, .png or .svg
    spec: tyro.conf.OmitArgPrefixes[GeneratorSpec] = field(default_factory=GeneratorSpec)

    choices: ClassVar[Mapping[str, Sequence[str]]] = {
        OPTION: tuple(DIFFICULTIES),
        "--split": tuple(SPLITS),
        "--shapes": get_args(Shape),
        "--pieces": get_args(Piece),
    }

    @classmethod
    def completed(cls, line: Sequence[str]) -> list[str]:
        """The line with a single number for a range as the range from it to itself."""
        whole: list[str] = []
        for before, word, after in zip(["", *line], line, [*line[1:], ""], strict=False):
            single = before in RANGES and _is_number(word) and not _is_number(after)
            whole += [word, word] if single else [word]
        return whole

    @classmethod
    def defaults(cls, line: Sequence[str]) -> Self | None:
        """Those of the difficulty that the line names."""
        words = [word for option in line for word in option.split("=", 1)]
        chosen = words[words.index(OPTION) + 1] if OPTION in words[:-1] else "medium"
        return cls(spec=GeneratorSpec.preset(chosen)) if chosen in DIFFICULTIES else None

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Write the files, one line on each."""
        self._check()
        drawn = []
        for path, layout in self._buildings():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(layout.to_json(), encoding="utf-8")
            echo(f"{path}: {counted(layout)}")
            drawn += [(path.stem, layout)] if self.sheet else []
        if self.sheet:
            from mecp_env.cli.worlds_files import draw

            echo(str(draw(drawn, self.sheet)))
        return 0

    def _check(self) -> None:
        """Raise `ConfigError` for what would fail only after some of the work."""
        try:
            self._seed(self.seed + self.count - 1)
        except ConfigError as error:  # the split has not so many buildings
            raise ConfigError(f"seed: {self.seed}, with count {self.count} up to {error}") from None
        if self.out.suffix == ".json" and self.count > 1:
            raise ConfigError(f"out: {self.out} is one file for {self.count} buildings; give a folder")
        (check_writable if self.out.suffix == ".json" else check_folder)(self.out)
        if self.sheet:
            from mecp_env.render.plan_figures import check_count, check_format

            check_writable(check_format(self.sheet), "--sheet")
            check_count(self.count)

    def _seed(self, number: int) -> int:
        return split_seed(self.split, number) if self.split else number

    def _buildings(self) -> Iterator[tuple[Path, Layout]]:
        """Path and layout of every building."""
        from mecp_env.world.generator import generate

        for seed in map(self._seed, range(self.seed, self.seed + self.count)):
            path = self.out if self.out.suffix == ".json" else self.out / f"{self.difficulty}-{seed}.json"
            yield path, generate(self.spec, seed)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


COLUMNS = {  # figure -> heading, format; the median of an even number of counts may end in a half
    "rooms": ("rooms", "{:g}"),
    "doors": ("doors", "{:g}"),
    "loops": ("loops", "{:g}"),
    "floor_m2": ("floor\nm²", "{:.0f}"),
    "faces": ("faces", "{:g}"),
    "corners": ("corners", "{:g}"),
    "obstacles": ("obst.", "{:g}"),
    "longest_corridor_m": ("corridor\nm", "{:.1f}"),
}
MANY = 20  # buildings from which on a bar shows how far it is
NAME_WIDTH = 20  # with the figures it fits into 80 columns

Figures = Mapping[str, float]


@dataclass(frozen=True)
class Stats(Command):
    """Figures of buildings: rooms, doors, loops, floor, faces and corners that a laser can see, obstacles, and the
    longest corridor (a room three times as long as wide). Of a series of seeds: the median, and from least to most."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds stats",
        "mecp-env worlds stats paper office hard:7",
        "mecp-env worlds stats easy:0-99 medium:0-99 --json",
    )

    worlds: Buildings = ()  # as for draw; none: all that are shipped
    json: bool = False  # as JSON, with every figure
    reading: ReadingOptions = field(default_factory=Reading)

    def run(self, line: Sequence[str]) -> int:
        """Measure, and print a table or JSON."""
        from mecp_env.world.layout import shipped_layouts

        words = {word: expand(word, self.reading) for word in self.worlds or shipped_layouts()}
        measured = measure(words, self.reading)
        if self.json:
            print(json.dumps({word: together(figures) for word, figures in measured.items()}, indent=2))
        else:
            _print_table(measured)
        return 0


def measure(words: Mapping[str, Sequence[str]], reading: Reading) -> dict[str, list[Figures]]:
    """The figures of all buildings of each word."""
    from mecp_env.world.statistics import building_figures

    single = [(word, one) for word, ones in words.items() for one in ones]
    quiet = len(single) < MANY
    found: dict[str, list[Figures]] = {word: [] for word in words}
    for word, one in track(single, "measuring", console=Console(stderr=True), transient=True, disable=quiet):
        found[word].append(asdict(building_figures(load(one, reading))))
    return found


def together(figures: Sequence[Figures]) -> dict[str, Any]:
    """The figures of one building as they are; of several their number, and least, median, mean and most of each."""
    if len(figures) == 1:
        return {"buildings": 1, **_rounded(figures[0])}
    columns = {name: [one[name] for one in figures] for name in figures[0]}
    return {"buildings": len(figures), **{name: _rounded(_spread(values)) for name, values in columns.items()}}


def _spread(values: Sequence[float]) -> Figures:
    return {"min": min(values), "median": median(values), "mean": fmean(values), "max": max(values)}


def _rounded(figures: Figures) -> dict[str, float]:
    return {name: round(value, 3) for name, value in figures.items()}


def _print_table(measured: Mapping[str, Sequence[Figures]]) -> None:
    table = Table(box=SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    table.add_column("building", overflow="fold", max_width=NAME_WIDTH)
    for heading, _ in COLUMNS.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for word, figures in measured.items():
        entries = (_entry([one[name] for one in figures], form) for name, (_, form) in COLUMNS.items())
        table.add_row(Text(sanitised(word)), *entries)
    Console().print(table)


def _entry(values: Sequence[float], form: str) -> str:
    """One value, or the median with the least and the most below it."""
    if min(values) == max(values):
        return form.format(values[0])
    return f"{form.format(median(values))}\n{form.format(min(values))}-{form.format(max(values))}"
