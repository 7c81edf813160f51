"""`mecp-env worlds stats`: what buildings are like, in figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import fmean, median
from typing import Any, ClassVar

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from mecp_env.cli.base import Command
from mecp_env.cli.buildings import Buildings, Reading, ReadingOptions, expand, load
from mecp_env.core.text import sanitised

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
