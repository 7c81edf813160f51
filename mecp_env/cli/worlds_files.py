"""`mecp-env worlds list | validate | convert`: what there is, whether files are sound, from one format to another.

`mecp-env worlds draw`: floor plans as pictures.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from pydantic import Field
from rich.console import Console
from rich.table import Table

from mecp_env.cli.base import Command, check_writable
from mecp_env.cli.buildings import (
    NONE_GIVEN,
    Buildings,
    Reading,
    ReadingOptions,
    counted,
    expand,
    expand_all,
    load,
    spare_sources,
    stem,
)
from mecp_env.cli.exit_codes import WRONG_INPUT, echo
from mecp_env.core.errors import ConfigError, LayoutError, MecpError
from mecp_env.core.files import is_folder, naming, write_atomic
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS, GeneratorSpec
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.schema import Layout

In = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="IN")]
Out = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]


@dataclass(frozen=True)
class List(Command):
    """The buildings that come with the package, the difficulties of generated ones, and the splits of their seeds."""

    examples: ClassVar[tuple[str, ...]] = ("mecp-env worlds list",)

    def run(self, line: Sequence[str]) -> int:
        """Print a table of each, and the splits."""
        console = Console()
        console.print(_shipped(), _presets())
        splits = ", ".join(f"{seeds[0]} to {seeds[-1]} for {name}" for name, seeds in SPLITS.items())
        console.print(f"Seeds, so that results compare: {splits}.")
        return 0


@dataclass(frozen=True)
class Validate(Command):
    """Say of each file whether it is a sound building, or what is wrong and where. Exit code 2 if any is wrong."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds validate my-house.json",
        "mecp-env worlds validate runs/worlds",
    )

    files: Buildings  # files, folders, or any building as for draw
    reading: ReadingOptions = field(default_factory=Reading)

    def run(self, line: Sequence[str]) -> int:
        """Check every file, a line each."""
        if not self.files:
            raise ConfigError(NONE_GIVEN)
        found = [sound(word, self.reading) for word in self.files]
        return 0 if all(found) else WRONG_INPUT


def sound(word: str, reading: Reading) -> bool:
    """Whether a building is sound, or all of a series or folder; prints a line for each, with the reason if not."""
    try:
        singles = expand(word, reading)
        if word and is_folder(word):
            _tell_left_out(Path(word), reading)
        if singles != [word]:
            return not [single for single in singles if not sound(single, reading)]
        echo(f"ok     {word}: {counted(load(word, reading))}")
    except MecpError as error:
        echo(f"wrong  {error}")
        return False
    return True


def _tell_left_out(folder: Path, reading: Reading) -> None:
    """Print which JSON and yaml files of a folder are no plans, and why."""
    from mecp_env.floorplans.folder import left_out

    for path, reason in left_out(folder, reading.kind).items():
        echo(f"other  {path}: {reason}")


@dataclass(frozen=True)
class Convert(Command):
    """Write a building or a plan in another format: a layout (.json), a ROS map_server pair (.yaml), or .svg."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds convert plan.yaml house.json",
        "mecp-env worlds convert scan.png house.json --resolution-m 0.05",
        "mecp-env worlds convert hard:3 runs/hard-3.yaml --map-resolution-m 0.1",
    )

    source: In  # a building as for draw: a layout, HouseExpo JSON, a map_server .yaml, an image...
    target: Out  # .json, .yaml or .svg
    map_resolution_m: float = 0.05  # metres per pixel of a .yaml map that is written
    reading: ReadingOptions = field(default_factory=Reading)

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Read, write, and print what was written."""
        write = WRITERS.get(self.target.suffix.lower())
        if write is None:
            raise ConfigError(f"target: {self.target}: written are {', '.join(WRITERS)}; `worlds draw` makes pictures")
        source, *others = expand(self.source, self.reading)
        if others:
            raise ConfigError(f"source: {source} and {len(others)} more, one building is converted")
        pair = [self.target.with_suffix(ending) for ending in (".yaml", ".pgm")]
        spare_sources(pair if write is _write_map else [self.target], [source])
        layout = load(source, self.reading)
        check_writable(self.target, "target")
        with tempfile.TemporaryDirectory() as folder:  # what fails leaves nothing
            with naming(self.target):
                write(layout, Path(folder) / self.target.name, self.map_resolution_m)
            for path in Path(folder).iterdir():
                write_atomic(self.target.with_name(path.name), path.read_bytes())
        echo(
            f"{self.target}: {layout.name}, {counted(layout)}",
            *([layout.description] if Path(source).is_file() else []),
        )
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
class Draw(Command):
    """Draw floor plans: one building as a picture, several as a sheet."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds draw office",
        "mecp-env worlds draw hard:0-8 --out runs/hard.png",
        "mecp-env worlds draw my-house.json paper --out runs/two.svg",
        "mecp-env worlds draw scan.png --resolution-m 0.05",
    )

    worlds: Buildings  # shipped names, hard:7, hard:0-9 (difficulty and seeds), files, folders
    out: Path | None = None  # the picture, .png or .svg; default: runs/NAME.png
    dpi: Annotated[int, Field(ge=30, le=600)] = 200  # pixels per inch of a PNG, 30 to 600
    reading: ReadingOptions = field(default_factory=Reading)

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Draw, and say where the picture is."""
        from mecp_env.render.plan_figures import check_count, check_format  # matplotlib is loaded only here

        if self.out:
            check_writable(check_format(self.out))
        words = expand_all(self.worlds, self.reading)
        check_count(len(words))
        path = self.out or Path("runs") / f"{stem(words[0]) if len(words) == 1 else 'worlds'}.png"
        spare_sources([path], words)
        buildings = [(title(word), load(word, self.reading)) for word in words]
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
