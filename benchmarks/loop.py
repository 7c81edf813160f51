"""One scan against a finished map, at a roughly known pose: what polygons, descriptors and passes are worth.

The default estimator maps a drive that was recorded with the true pose as the driver. For each scan that is drawn, the
filter gets the true pose with a random error of a given sigma in x, y and heading, this prior, and no correlation with
the map; the room is unknown. Every variant decides on the same scans, errors and map; only association differs. The
scans are among those that the map was made of. In `mecp`, polygons and cliques propose poses where the prediction is
wide; the rows without one of them have the other. `mecp in one pass` pairs everything at the prediction, however wide
that is. `jcbb`, `ccda`, `clipper` (benchmarks/clipper.py) and `kiss-matcher` (benchmarks/kiss.py) work in one pass and
without polygons (docs/associators.md). `kiss-matcher with descriptor` prunes and solves the pairs that are the nodes of
`ccda`; `kiss-matcher on points` registers the walls of scan and map by features of its own. `jcbb with descriptor in
two passes` is `mecp` without polygons, and `jcbb with all of mecp` is `mecp`, with branch and bound in place of the
greedy pairing.

A scan is right when at least three corners are paired with their landmarks and none is paired wrongly. In `possible` of
the scans at least three corners have a landmark: no variant can be right more often. `hard` are generated buildings of
the test split, from number 500 on; the benchmark `worlds` uses those before. Times are medians of a drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Figures, Options, is_installed, runs_of
from benchmarks.drives import Drive
from benchmarks.kiss import PACKAGE
from benchmarks.plots import Panel, line_panels
from benchmarks.records import IN_MEMORY, Course, Records, on_records, place
from benchmarks.rough_pose import COLUMNS, Sigma, count_scans, drawn_looks, finish, named
from benchmarks.tables import by_row, sections, summaries, table
from benchmarks.variants import DEFAULT, KISS, Variant, own_rows, rows_of

SIGMAS = ((0.05, 0.5), (0.3, 3.0), (0.6, 6.0), (1.0, 10.0), (2.0, 20.0))  # m, deg
VARIANTS = rows_of(
    *(DEFAULT, "mecp without polygons", "mecp without descriptor", "mecp without both", "mecp without cliques"),
    *("mecp in one pass", "jcbb", "jcbb with descriptor", "jcbb with descriptor in two passes"),
    *("jcbb with all of mecp", "ccda with descriptor", "clipper with descriptor"),
    *(KISS if is_installed(PACKAGE) else ()),
    *("nearest", "mecp_paper"),
)
SETS = {"paper": 20, "hard": 20, "twins": 20}  # drives
FIRST_BUILDING, MAX_STEPS = 500, 10_000  # the buildings before are those of `worlds`
SCANS, QUICK_SCANS = 20, 4  # per drive
Cells = dict[str, dict[str, Figures]]  # variant -> sigma -> counts
WITHOUT_KISS = "KISS-Matcher (extra `lab`) is not installed where this is measured: its rows are missing."
TITLES = {
    "right": "Share of scans with at least three right pairs and none wrong:",
    "wrong": "Share of pairs that are wrong:",
    "wrong_pairs": "Wrong pairs in all scans:",
    "polygon": "Share of scans with a polygon recognised:",
    "ms": "Milliseconds of association per scan:",
}


def run(options: Options) -> Figures:
    """Results of every set, variant and sigma of the pose."""
    task = partial(compare, scans=QUICK_SCANS if options.quick else SCANS)
    found = on_records(task, Cells, runs_of(options, SETS), options)
    return {layout: summarise(drives) for layout, drives in found.items()}


def compare(drive_of: tuple[str, int], records: Records = IN_MEMORY, scans: int = SCANS) -> Cells:
    """Counts of every variant and sigma on scans of the drive of one layout and seed."""
    return on_drive(records.drive(course(*drive_of)), scans, drive_of[1], all_variants(), SIGMAS)


def all_variants() -> dict[str, Variant]:
    """The variants, with the associators that modules have registered."""
    return VARIANTS | {name: row for name, row in own_rows().items() if "association" in row.change}


def on_drive(drive: Drive, count: int, seed: int, variants: Mapping[str, Variant], sigmas: Sequence[Sigma]) -> Cells:
    """Counts of some variants and sigmas on `count` scans of a drive, drawn by the seed."""
    finished, rng = finish(drive), np.random.default_rng(seed)
    looks = drawn_looks(drive, finished, count, rng)
    errors = dict(zip(SIGMAS, rng.normal(size=(len(SIGMAS), count, 3)), strict=True))
    return {
        name: {
            named(sigma): count_scans(finished, variant.associator(drive.slam), looks, sigma, errors[sigma])
            for sigma in sigmas
        }
        for name, variant in variants.items()
    }


def course(layout: str, seed: int) -> Course:
    """What is driven."""
    return Course(place(layout, FIRST_BUILDING + seed), seed, {"estimator": "truth", "max_steps": MAX_STEPS})


def summarise(drives: list[Cells]) -> Figures:
    """Results of all drives of a set, with 95 % intervals over drives."""
    rows = by_row(drives)  # the package of a row may not be installed everywhere
    return {name: summaries(by_row(own), COLUMNS) for name, own in rows.items()}


def report(figures: Figures) -> str:
    """Per set a table of right scans, one of wrong pairs, one of recognised polygons and one of times."""
    parts = {}
    for layout, variants in figures.items():
        first = next(iter(variants[DEFAULT].values()))
        tables = [f"`possible`: {first['possible']['value']:.4g} of the scans."]
        for name, title in TITLES.items():
            rows = [[variant, *(cells[sigma][name] for sigma in cells)] for variant, cells in variants.items()]
            tables.append(f"{title}\n\n{table(['sigma of the pose', *variants[DEFAULT]], rows)}")
        parts[f"{layout} ({first['right']['n']} drives, {first['scans']} scans per cell)"] = "\n\n".join(tables)
    measured = any(name in variants for variants in figures.values() for name in KISS)
    return sections(parts) if measured else f"{WITHOUT_KISS}\n\n{sections(parts)}"


def figure(figures: Figures) -> Figure:
    """Share of right scans by the sigma of the pose."""
    ticks = [named(sigma).replace(" m ", " m\n") for sigma in SIGMAS]
    panels = {
        layout: Panel(ticks, {name: [cell["right"] for cell in cells.values()] for name, cells in variants.items()})
        for layout, variants in figures.items()
    }
    return line_panels(panels, "share of right scans")
