"""The commands of `mecp-env worlds`: buildings as files, pictures and figures."""

from __future__ import annotations

import json
import re
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, Literal, Self

import tyro
from pydantic import Field
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mecp_env.cli.base import LISTS, WRONG_INPUT, Command, Line, Seed, check_folder, check_writable, echo, tracked
from mecp_env.cli.options import NONE_GIVEN, Buildings, Reading, ReadsPlans, counted, spare_sources, stem
from mecp_env.core.errors import ConfigError, LayoutError, MecpError
from mecp_env.core.files import is_folder, naming, sanitised, write_atomic
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.floorplans.folder import left_out
from mecp_env.world.config import DIFFICULTIES, SPLITS, Difficulty, GeneratorSpec, split_seed
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.schema import Layout

In = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="IN")]
Out = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]


@dataclass(frozen=True)
class List(Command):
    """The buildings that come with the package, the difficulties of generated ones, and the splits of their seeds.

    Examples:
        mecp-env worlds list
    """

    def run(self, line: Line) -> int:
        """Print a table of each, and the splits."""
        console = Console()
        console.print(_shipped(), _presets())
        splits = ", ".join(f"{seeds[0]} to {seeds[-1]} for {name}" for name, seeds in SPLITS.items())
        console.print(f"Seeds, so that results compare: {splits}.")
        return 0


@dataclass(frozen=True)
class Validate(ReadsPlans):
    """Say of each file whether it is a sound building, or what is wrong and where. Exit code 2 if any is wrong.

    Examples:
        mecp-env worlds validate my-house.json
        mecp-env worlds validate runs/worlds
    """

    files: Buildings  # files, folders, or any building as for draw

    def run(self, line: Line) -> int:
        """Check every file, a line each."""
        if not self.files:
            raise ConfigError(NONE_GIVEN)
        found = [sound(word, self.reading) for word in self.files]
        return 0 if all(found) else WRONG_INPUT


def sound(word: str, reading: Reading) -> bool:
    """Whether a building is sound, or all of a series or folder; prints a line for each, with the reason if not."""
    try:
        singles = reading.expand(word)
        if word and is_folder(word):
            echo(*(f"other  {path}: {reason}" for path, reason in left_out(Path(word), reading.kind).items()))
        if singles != [word]:
            return not [single for single in singles if not sound(single, reading)]
        echo(f"ok     {word}: {counted(reading.load(word))}")
    except MecpError as error:
        echo(f"wrong  {error}")
        return False
    return True


@dataclass(frozen=True)
class Convert(ReadsPlans):
    """Write a building or a plan in another format: a layout (.json), a ROS map_server pair (.yaml), or .svg.

    Examples:
        mecp-env worlds convert plan.yaml house.json
        mecp-env worlds convert scan.png house.json --resolution-m 0.05
        mecp-env worlds convert hard:3 runs/hard-3.yaml --map-resolution-m 0.1
    """

    source: In  # a building as for draw: a layout, HouseExpo JSON, a map_server .yaml, an image...
    target: Out  # .json, .yaml or .svg
    map_resolution_m: float = 0.05  # metres per pixel of a .yaml map that is written

    def run(self, line: Line) -> int:
        """Read, write, and print what was written."""
        write = WRITERS.get(self.target.suffix.lower())
        if write is None:
            raise ConfigError(f"target: {self.target}: written are {', '.join(WRITERS)}; `worlds draw` makes pictures")
        source = self.reading.one(self.source, "source")
        pair = [self.target.with_suffix(ending) for ending in (".yaml", ".pgm")]
        spare_sources(pair if write is _write_map else [self.target], [source])
        layout = self.reading.load(source)
        check_writable(self.target, "target")
        with tempfile.TemporaryDirectory() as folder:  # what fails leaves nothing
            with naming(self.target):
                write(layout, Path(folder) / self.target.name, self.map_resolution_m)
            for path in Path(folder).iterdir():
                write_atomic(self.target.with_name(path.name), path.read_bytes())
        echo(f"{self.target}: {layout.name}, {counted(layout)}")
        if Path(source).is_file():
            echo(layout.description)
        return 0


def _write_map(layout: Layout, path: Path, resolution_m: float) -> None:
    try:
        save_map_server(layout, path.with_suffix(""), resolution_m)
    except LayoutError as error:
        raise LayoutError(re.sub(r"^resolution_m\b", "map_resolution_m", str(error))) from None


WRITERS: dict[str, Callable[[Layout, Path, float], object]] = {
    ".json": lambda layout, path, _: path.write_text(layout.to_json(), encoding="utf-8"),
    ".yaml": _write_map,
    ".svg": lambda layout, path, _: save_svg(layout, path),
}


def _shipped() -> Table:
    """The shipped layouts, and what each is for."""
    table = Table("building", "rooms", "doors", "what it is", title="shipped", title_justify="left")
    for name in shipped_layouts():
        layout = load_layout(name)
        table.add_row(name, str(len(layout.rooms)), str(len(layout.doors)), layout.description)
    return table


def _presets() -> Table:
    """The difficulties, and in what they differ from a plain specification; a range as `0.8 to 1`."""
    table = Table("building", "what is generated", title="generated: any seed from 0", title_justify="left")
    for name in DIFFICULTIES:
        fields = GeneratorSpec.preset(name).model_dump(exclude_unset=True)
        shown = {k: " to ".join(f"{end:g}" for end in v) if isinstance(v, tuple) else v for k, v in fields.items()}
        table.add_row(f"{name}:SEED", ", ".join(f"{key} {value}" for key, value in shown.items()))
    return table


@dataclass(frozen=True)
class Draw(ReadsPlans):
    """Draw floor plans: one building as a picture, several as a sheet.

    Examples:
        mecp-env worlds draw office
        mecp-env worlds draw hard:0-8 --out runs/hard.png
        mecp-env worlds draw my-house.json paper --out runs/two.svg
        mecp-env worlds draw scan.png --resolution-m 0.05
    """

    worlds: Buildings  # shipped names, hard:7, hard:0-9 (difficulty and seeds), files, folders
    out: Path | None = None  # the picture, .png or .svg; default: runs/NAME.png
    dpi: Annotated[int, Field(ge=30, le=600)] = 200  # pixels per inch of a PNG, 30 to 600

    def run(self, line: Line) -> int:
        """Draw, and say where the picture is."""
        from mecp_env.render.plan_figures import check_count, check_format  # matplotlib is loaded only where it draws

        if self.out:
            check_writable(check_format(self.out))
        if not self.worlds:
            raise ConfigError(NONE_GIVEN)
        words = [word for given in self.worlds for word in self.reading.expand(given)]
        check_count(len(words))
        path = self.out or Path("runs") / f"{stem(words[0]) if len(words) == 1 else 'worlds'}.png"
        spare_sources([path], words)
        buildings = [(title(word), self.reading.load(word)) for word in words]
        echo(str(draw(buildings, path, self.dpi)))
        return 0


def title(word: str) -> str:
    """What a building is called in a picture: as it was asked for, of a file its name."""
    return Path(word).stem if Path(word).exists() else word


def draw(buildings: Sequence[tuple[str, Layout]], path: Path, dpi: int = 200) -> Path:
    """Draw buildings, each with its title, on a sheet and save it; `path` itself, whose folder is made."""
    from mecp_env.floorplans.plan_view import floor_plan
    from mecp_env.render.plan_figures import save_plans

    plans = [floor_plan(layout, title) for title, layout in buildings]
    check_writable(path).parent.mkdir(parents=True, exist_ok=True)
    save_plans(plans, path, dpi)
    return path


FIELDS = {f"--{name.replace('_', '-')}": value for name, value in GeneratorSpec()}
RANGES = [option for option, value in FIELDS.items() if isinstance(value, tuple) and option not in LISTS]


@dataclass(frozen=True)
class Generate(Command):
    """Generate buildings: layout files whose rooms, doors and loops are known. Every field of the specification is an
    option; what is not given is what the difficulty has (`--difficulty hard --help` shows it).

    Examples:
        mecp-env worlds generate --difficulty hard --seed 7
        mecp-env worlds generate --rooms 12 --loops 3 --count 20 --out runs/twelve --sheet runs/twelve.png
        mecp-env worlds generate --difficulty easy --split test --count 10
    """

    difficulty: Difficulty = "medium"  # the preset below the other options
    seed: Seed = 0  # the first seed; with a split, the first building of the split
    count: Annotated[int, Field(ge=1, le=10_000)] = 1  # so many seeds, one after the other
    split: Literal["train", "validation", "test"] | None = None  # seeds kept apart, so that results compare
    out: Path = Path("runs/worlds")  # folder for DIFFICULTY-SEED.json, or for one building a .json file
    sheet: Path | None = None  # also draw all of them here, .png or .svg
    spec: tyro.conf.OmitArgPrefixes[GeneratorSpec] = field(default_factory=GeneratorSpec)

    @classmethod
    def completed(cls, line: Line) -> Line:
        """The line with a single number for a range as the range from it to itself."""
        whole = line.parts[:1]
        for part, (name, words) in zip(line.parts[1:], line.options, strict=True):
            whole.append([name, *words, *words] if name in RANGES and len(words) == 1 else part)
        return Line(word for part in whole for word in part)

    @classmethod
    def defaults(cls, line: Line) -> Self | None:
        """Those of the difficulty that the line names."""
        chosen = [*line.first_words("--difficulty"), "medium"][0]
        return cls(spec=GeneratorSpec.preset(chosen)) if chosen in DIFFICULTIES else None

    def run(self, line: Line) -> int:
        """Write the files, one line on each."""
        self._check()
        drawn = []
        for path, layout in self._buildings():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(layout.to_json(), encoding="utf-8")
            echo(f"{path}: {counted(layout)}")
            drawn += [(path.stem, layout)] if self.sheet else []
        if self.sheet:
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
        for seed in map(self._seed, range(self.seed, self.seed + self.count)):
            path = self.out if self.out.suffix == ".json" else self.out / f"{self.difficulty}-{seed}.json"
            yield path, generate(self.spec, seed)


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
NAME_WIDTH = 20  # with the figures it fits into 80 columns
SPREAD: dict[str, Callable[[Sequence[float]], float]] = {"min": min, "median": median, "mean": fmean, "max": max}

Figures = Mapping[str, Sequence[float]]  # of each building of a word


@dataclass(frozen=True)
class Stats(ReadsPlans):
    """Figures of buildings: rooms, doors, loops, floor, faces and corners that a laser can see, obstacles, and the
    longest corridor (a room three times as long as wide). Of a series of seeds: the median, and from least to most.

    Examples:
        mecp-env worlds stats
        mecp-env worlds stats paper office hard:7
        mecp-env worlds stats easy:0-99 medium:0-99 --json
    """

    worlds: Buildings = ()  # as for draw; none: all that are shipped
    json: bool = False  # as JSON, with every figure

    def run(self, line: Line) -> int:
        """Measure, and print a table or JSON."""
        words = {word: self.reading.expand(word) for word in self.worlds or shipped_layouts()}
        measured = measure(words, self.reading)
        if self.json:
            print(json.dumps({word: together(figures) for word, figures in measured.items()}, indent=2))
        else:
            Console().print(_table(measured))
        return 0


def measure(words: Mapping[str, Sequence[str]], reading: Reading) -> dict[str, Figures]:
    """The figures of all buildings of each word."""
    from mecp_env.world.doors import building_figures

    single = [(word, building) for word, buildings in words.items() for building in buildings]
    found: dict[str, dict[str, list[float]]] = {word: defaultdict(list) for word in words}
    for word, building in tracked(single, len(single), "buildings"):
        for name, value in asdict(building_figures(reading.load(building))).items():
            found[word][name].append(value)
    return {**found}


def together(figures: Figures) -> dict[str, Any]:
    """The figures of one building as they are; of several their number, and least, median, mean and most of each."""
    count = len(next(iter(figures.values())))
    if count == 1:
        return {"buildings": 1, **{name: round(values[0], 3) for name, values in figures.items()}}
    spreads = {name: {of: round(f(values), 3) for of, f in SPREAD.items()} for name, values in figures.items()}
    return {"buildings": count, **spreads}


def _table(measured: Mapping[str, Figures]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    table.add_column("building", overflow="fold", max_width=NAME_WIDTH)
    for heading, _ in COLUMNS.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for word, figures in measured.items():
        table.add_row(Text(sanitised(word)), *(_entry(figures[name], form) for name, (_, form) in COLUMNS.items()))
    return table


def _entry(values: Sequence[float], form: str) -> str:
    """One value, or the median with the least and the most below it."""
    if min(values) == max(values):
        return form.format(values[0])
    return f"{form.format(median(values))}\n{form.format(min(values))}-{form.format(max(values))}"
