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

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from benchmarks.columns import by_row, columns_of, means, ratios
from benchmarks.common import Figures, Gate, Options, load_modules, runs_of
from benchmarks.drives import Drive
from benchmarks.kiss import KissPointsAssociator, installed
from benchmarks.plots import Panel, line_panels
from benchmarks.records import IN_MEMORY, Course, Records, on_records
from benchmarks.tables import sections, table
from benchmarks.variants import DEFAULT, KISS, Variant, own_rows, rows_of
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import compose, inverse
from mecp_env.core.sensors import Scan
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend import front_end as features_of
from mecp_env.slam.mecp import find_structure
from mecp_env.slam.messages import UNKNOWN_ROOM, Corners, MapView, Match, MergedScan, Polygon
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.protocols import Associator, Filter

SIGMAS = ((0.05, 0.5), (0.3, 3.0), (0.6, 6.0), (1.0, 10.0), (2.0, 20.0))  # m, deg
VARIANTS = rows_of(
    *(DEFAULT, "mecp without polygons", "mecp without descriptor", "mecp without both", "mecp without cliques"),
    *("mecp in one pass", "jcbb", "jcbb with descriptor", "jcbb with descriptor in two passes"),
    *("jcbb with all of mecp", "ccda with descriptor", "clipper with descriptor", *(KISS if installed() else ())),
    *("nearest", "mecp_paper"),
)
SEEDS = {"paper": 20, "hard": 20, "twins": 20}  # drives
SETS, MOST = tuple(SEEDS), 500
HARD, FIRST_BUILDING, MAX_STEPS = "hard", 500, 10_000  # the buildings before are those of `worlds`
SCANS, FIRST_SCAN = 20, 10  # per drive; the first one
QUICK_DRIVES, QUICK_SCANS = 2, 4
RIGHT_PAIRS = 3
WITHOUT_KISS = "KISS-Matcher (extra `lab`) is not installed where this is measured: its rows are missing."
TITLES = {
    "right": "Share of scans with at least three right pairs and none wrong:",
    "wrong": "Share of pairs that are wrong:",
    "wrong_pairs": "Wrong pairs in all scans:",
    "polygon": "Share of scans with a polygon recognised:",
    "ms": "Milliseconds of association per scan:",
}


def named(sigma: tuple[float, float]) -> str:
    """A sigma of the pose as a key."""
    return f"{sigma[0]:g} m {sigma[1]:g} deg"


GATED = (("paper", DEFAULT), ("paper", "mecp without descriptor"), (HARD, DEFAULT))
GATES = (
    *(Gate(f"{layout}/{name}/{named(sigma)}/right", "share", 0.05) for layout, name in GATED for sigma in SIGMAS[3:]),
    Gate(f"{HARD}/{DEFAULT}/{named(SIGMAS[4])}/wrong", "error", 1.5),
)


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The map of a drive: what an associator may look at, and which true corner each landmark is."""

    pipeline: SlamPipeline
    identity: Ints  # (F,) true corner of each feature, -1 for none
    T_map_world: Array  # (3,)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The features of one scan, and what they are."""

    corners: Corners
    polygons: tuple[Polygon, ...]
    true: Ints  # (n,) true corner of each corner, -1 for none
    T_map_robot: Array  # (3,) true pose
    beams: MergedScan | None = None


def run(options: Options) -> Figures:
    """Results of every set, variant and sigma of the pose."""
    load_modules(options.modules)
    scans = QUICK_SCANS if options.quick else SCANS
    drives = [(layout, scans, seed) for layout, seed in runs_of(options, SEEDS, MOST, QUICK_DRIVES)]
    results = on_records(compare, dict[str, dict[str, Figures]], drives, options)
    return {layout: summarise(of_layout) for (layout, _), of_layout in results.items()}


def compare(
    task: tuple[str, int, int],
    records: Records = IN_MEMORY,
    variants: Sequence[str] | None = None,
    sigmas: Sequence[tuple[float, float]] = SIGMAS,
) -> dict[str, dict[str, Figures]]:
    """Counts of some variants, by default all, and sigmas on scans of the drive of one layout and seed."""
    layout, count, seed = task
    return on_drive(records.drive(course(layout, seed)), count, seed, variants or tuple(all_variants()), sigmas)


def all_variants() -> dict[str, Variant]:
    """The variants, with the associators that modules have registered."""
    return VARIANTS | {name: row for name, row in own_rows().items() if "association" in row.change}


def on_drive(
    drive: Drive, count: int, seed: int, variants: Sequence[str], sigmas: Sequence[tuple[float, float]]
) -> dict[str, dict[str, Figures]]:
    """Counts of some variants and sigmas on `count` scans of a drive, drawn by the seed."""
    finished, rng = finish(drive), np.random.default_rng(seed)
    steps = rng.choice(np.arange(FIRST_SCAN, len(drive.scans)), count, replace=False)
    looks = [look(drive, finished, int(step)) for step in steps]
    errors = rng.normal(size=(len(SIGMAS), count, 3))
    return {
        name: {
            named(sigma): count_scans(finished, variant.associator(drive.slam), looks, sigma, errors[k])
            for k, sigma in enumerate(SIGMAS)
            if sigma in sigmas
        }
        for name, variant in all_variants().items()
        if name in variants
    }


def place(layout: str, seed: int) -> str:
    """The building of a drive."""
    return f"{HARD}:{FIRST_BUILDING + seed}" if layout == HARD else layout


def course(layout: str, seed: int) -> Course:
    """What is driven."""
    return Course(place(layout, seed), seed, {"estimator": "truth", "max_steps": MAX_STEPS})


def finish(drive: Drive) -> Finished:
    """The map that the default estimator makes of a drive."""
    pipeline, log = SlamPipeline(drive.slam), AssociationLog(len(drive.truth.outline.corners))
    for output, T_world_robot in drive.outputs(pipeline):
        log.record(output, drive.truth.identify(output.corners, T_world_robot))
    return Finished(pipeline, log.features[:, 0], inverse(drive.T_world_robot[0]))


def look(drive: Drive, finished: Finished, step: int) -> Look:
    """The features of a scan of the drive."""
    corners, beams, wall = front_end(drive.scans[step], drive.slam)
    polygons = find_structure(corners, beams, drive.slam.polygon, wall)
    T_world_robot = drive.T_world_robot[step]
    T_map_robot = compose(finished.T_map_world, T_world_robot)
    return Look(corners, polygons, drive.truth.identify(corners, T_world_robot), T_map_robot, beams)


def front_end(scan: Scan, slam: SlamConfig) -> tuple[Corners, MergedScan, Bools]:
    """Corners of a scan, its beams, and which of these end on a wall."""
    found = features_of(scan, slam)
    return found.corners, found.beams, found.wall


def count_scans(
    finished: Finished, associator: Associator, looks: list[Look], sigma: tuple[float, float], errors: Array
) -> Figures:
    """Counts of one associator on the scans, with `errors` (n,3) of the pose in units of sigma."""
    sigmas = np.array([sigma[0], sigma[0], math.radians(sigma[1])])
    mapped = finished.identity[finished.pipeline.filter.ids]
    counts = {"scans": len(looks), "right": 0, "possible": 0, "pairs": 0, "wrong": 0, "polygon": 0}
    seconds = []
    for seen, error in zip(looks, errors, strict=True):
        view, belief = rough_view(finished.pipeline, seen.T_map_robot + error * sigmas, sigmas, len(seen.corners))
        if isinstance(associator, KissPointsAssociator) and seen.beams is not None:
            associator.look_at(seen.beams, finished.pipeline.grid.canvas.grid)
        begun = time.perf_counter()
        match = associator.associate(seen.corners, seen.polygons, view, belief)
        seconds.append(time.perf_counter() - begun)
        pairs, wrong = judged(finished, seen, match)
        counts["right"] += pairs - wrong >= RIGHT_PAIRS and not wrong
        counts["possible"] += int((np.isin(seen.true, mapped) & (seen.true >= 0)).sum()) >= RIGHT_PAIRS
        counts["pairs"] += pairs
        counts["wrong"] += wrong
        counts["polygon"] += match.polygon >= 0
    return {**counts, "ms": 1e3 * float(np.median(seconds))}


def rough_view(pipeline: SlamPipeline, T_map_robot: Array, sigmas: Array, corners: int) -> tuple[MapView, Filter]:
    """What an associator sees of a map at a pose (3,) with sigmas (3,), the room unknown; and the filter there."""
    belief = pipeline.filter.copy()
    belief.set_pose(T_map_robot, np.diag(sigmas**2))
    graph = replace(pipeline.rooms.graph(), current=UNKNOWN_ROOM, in_doorway=False)
    through = np.full(corners, -1)
    return pipeline.map.view(belief.belief(), graph, through, pipeline.step_count + 1), belief


def judged(finished: Finished, seen: Look, match: Match) -> tuple[int, int]:
    """How many pairs a match has, and how many of them are wrong."""
    paired = match.recognised()
    claimed, true = finished.identity[match.ids[paired]], seen.true[paired]
    return len(paired), len(paired) - int(((claimed == true) & (true >= 0)).sum())


def summarise(drives: list[dict[str, dict[str, Figures]]]) -> Figures:
    """Results of all drives of a set, with 95 % intervals over drives."""
    rows = by_row(drives)  # the package of a row may not be installed everywhere
    return {name: {sigma: figures_of(of) for sigma, of in by_row(own).items()} for name, own in rows.items()}


def figures_of(drives: list[Figures]) -> Figures:
    """Results of one variant at one sigma."""
    counts = columns_of(drives)
    return {
        **ratios(counts, right="right/scans", possible="possible/scans", wrong="wrong/pairs"),
        "wrong_pairs": int(counts["wrong"].sum()),
        **ratios(counts, polygon="polygon/scans"),
        **means(counts, "ms"),
        "scans": int(counts["scans"].sum()),
    }


def right_share(cells: list[Figures]) -> Array:
    """(n,) share of right scans of each drive."""
    columns = columns_of(cells)
    return columns["right"] / columns["scans"]


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
