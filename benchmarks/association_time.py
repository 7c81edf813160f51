"""Time of association for scans of 20 corners, of which four are spurious: polygons against branch and bound.

Maps, scans, poses and errors are those of `loop`, in scans with 16 to 20 mapped corners. Of these 16 are kept, vertices
of polygons first. Four spurious ones are added, each on a random beam in front of what it hit, with the covariance of
another corner and its descriptor, turned by a random multiple of 90 degrees. Polygons are those of the 20 corners.

Every associator decides on the same scans, one after the other for each scan; the fastest of three calls counts. `mecp`
and `jcbb` test the same joint innovation at the same probability (association.gate_probability). `ms` are means over
scans. `ratio` is the time of `mecp`, as it is, by that of the row; `ratio_with_polygons` adds the time to find the
polygons, which is another stage; `ratio_same_corners` is that of `mecp` without descriptors where the row has none.
`jcbb` gives up after a million nodes: `budget_spent` is the share of these scans. `right`, `wrong` and `polygon` are as
in `loop`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks import rough_pose
from benchmarks.clutter import independent
from benchmarks.common import Figures, Gate, Options, best_of, ratio, runs_of
from benchmarks.drives import Drive
from benchmarks.loop import course
from benchmarks.records import IN_MEMORY, Records, on_records
from benchmarks.rough_pose import FIRST_SCAN, Finished, Look, named
from benchmarks.tables import columns_of, ratios, sections, table
from benchmarks.variants import DEFAULT, rows_of, with_change
from mecp_env.core.carriers import Array, Ints
from mecp_env.slam.association import MatchBuilder, make_associator
from mecp_env.slam.association.gating import chi2_gate, pairing_table
from mecp_env.slam.association.rivals import pair_jointly
from mecp_env.slam.config import AssociationConfig, SlamConfig
from mecp_env.slam.mecp import find_structure
from mecp_env.slam.messages import CornerKind, Corners, Doorways, MapView, MergedScan, Polygon
from mecp_env.slam.protocols import Filter

CORNERS, SPURIOUS = 20, 4
SIGMAS = ((0.05, 0.5), (0.3, 3.0), (1.0, 10.0), (2.0, 20.0))  # m, deg
PLAIN = "mecp without descriptor"
METHODS = rows_of(DEFAULT, "jcbb with descriptor", "ccda with descriptor", PLAIN, "jcbb", "ccda")
AGAINST = {name: PLAIN if name in (PLAIN, "jcbb", "ccda") else DEFAULT for name in METHODS}
BUDGET = 1_000_000  # nodes; ten times the default, so that most searches end
SETS = {"paper": 10, "furnished": 6, "hard": 6}  # drives
SCANS, QUICK_SCANS, QUICK_DRIVES, CALLS = 10, 3, 1, 3
IN_FRONT = (0.2, 0.9)  # share of a beam's range at which a spurious corner may be
COUNTED = ("scans", "ms", "right", "pairs", "wrong", "polygon", "budget_spent")
Sums = dict[str, dict[str, Figures]]  # sigma -> associator -> sums over scans

GATES = (
    Gate("paper/1 m 10 deg/jcbb/ratio", "bound", 0.2),
    Gate("paper/1 m 10 deg/jcbb/ratio_same_corners", "bound", 0.2),
    Gate(f"paper/1 m 10 deg/{DEFAULT}/right", "share", 0.1),
)


def run(options: Options) -> Figures:
    """Results of every set, sigma and associator."""
    scans = QUICK_SCANS if options.quick else SCANS
    drives = [(layout, scans, seed) for layout, seed in runs_of(options, SETS, QUICK_DRIVES)]
    results = on_records(compare, Sums, drives, options)
    return {layout: summarise(of_layout) for (layout, _), of_layout in results.items()}


def compare(task: tuple[str, int, int], records: Records = IN_MEMORY) -> Sums:
    """Sums over the scans of the drive of one layout and seed, for each sigma and associator."""
    layout, count, seed = task
    drive = records.drive(course(layout, seed))
    finished, rng = rough_pose.finish(drive), np.random.default_rng(seed)
    looks, polygons_ms = cluttered_looks(drive, finished, count, rng)
    sums: Sums = {}
    for sigma_m, sigma_deg in SIGMAS:
        sigmas = np.array([sigma_m, sigma_m, math.radians(sigma_deg)])
        rows = [race(finished, seen, np.array([rng.normal(size=3) * sigmas, sigmas]), drive.slam) for seen in looks]
        sums[named((sigma_m, sigma_deg))] = {
            name: {key: sum(row[name][key] for row in rows) for key in COUNTED} | {"polygons_ms": polygons_ms}
            for name in METHODS
        }
    return sums


def cluttered_looks(drive: Drive, finished: Finished, count: int, rng: np.random.Generator) -> tuple[list[Look], float]:
    """Up to `count` scans with clutter, and the milliseconds that finding their polygons takes in total."""
    mapped, looks, ms = finished.identity[finished.pipeline.filter.ids], list[Look](), 0.0
    for step in rng.permutation(np.arange(FIRST_SCAN, len(drive.scans))).tolist():
        seen = rough_pose.look(drive, finished, step)
        real = np.flatnonzero(np.isin(seen.true, mapped) & (seen.true >= 0))
        if CORNERS - SPURIOUS <= len(real) <= CORNERS and len(looks) < count:
            corners, beams, wall = rough_pose.front_end(drive.scans[step], drive.slam)
            corners, source = with_spurious(corners, beams, vertices_first(real, seen.polygons, rng), rng)
            find = partial(find_structure, corners, beams, drive.slam.polygon, wall)
            true = np.where(source < 0, -1, seen.true[source])
            looks.append(Look(corners, find(), true, seen.T_map_robot))
            ms += fastest_ms(find)
    return looks, ms


def vertices_first(real: Ints, polygons: tuple[Polygon, ...], rng: np.random.Generator) -> Ints:
    """As many of the corners `real` as are kept: vertices of polygons, then others at random."""
    vertices = np.concatenate([np.empty(0, np.int64), *(polygon.corners for polygon in polygons)])
    order = np.lexsort((rng.random(len(real)), ~np.isin(real, vertices)))
    return real[order[: CORNERS - SPURIOUS]]


def with_spurious(corners: Corners, beams: MergedScan, kept: Ints, rng: np.random.Generator) -> tuple[Corners, Ints]:
    """The corners `kept` and spurious ones in order of bearing, and of which corner (n,) each is; -1: spurious."""
    hit = rng.choice(np.flatnonzero(beams.hit), SPURIOUS, replace=False)
    range_m = beams.ranges[hit] * rng.uniform(*IN_FRONT, SPURIOUS)
    z = np.concatenate([corners.z[kept], np.column_stack([range_m, beams.bearings[hit]])])
    order = np.argsort(z[:, 1])
    source, spurious = np.concatenate([kept, rng.choice(kept, SPURIOUS)])[order], order >= len(kept)
    turned = np.where(spurious, rng.integers(0, 4, len(order)) * (math.pi / 2.0), 0.0)[:, None]
    normals = (corners.normals[source] + turned + math.pi) % (2.0 * math.pi) - math.pi
    kind = np.where(spurious, int(CornerKind.CROSSING), corners.kind[source])
    beyond = np.where(spurious, -1, corners.beyond[source])
    marks = kind, corners.convex[source], normals, beyond, spurious | corners.sites[source]
    doorways = Doorways(np.empty((0, 2), np.int64), np.empty(0), np.empty(0, np.bool_))
    cov = independent(corners.measurements(source)[1], spurious)
    return Corners(z[order], cov, *marks, doorways), np.where(spurious, -1, source)


def race(finished: Finished, seen: Look, error: Array, slam: SlamConfig) -> dict[str, Figures]:
    """What every associator does with one scan, its pose off by `error`: a row of x, y, heading, and their sigmas."""
    off, sigmas = error
    view, belief = rough_pose.rough_view(finished.pipeline, seen.T_map_robot + off, sigmas, len(seen.corners))
    rows = {}
    for name, row in METHODS.items():
        config = with_change(slam, row.change).association.model_copy(update={"search_budget": BUDGET})
        decide = partial(make_associator(config).associate, seen.corners, seen.polygons, view, belief)
        judged = rough_pose.judged(finished, seen, decide())
        rows[name] = {
            "scans": 1,
            **judged,
            "ms": fastest_ms(decide),
            "budget_spent": config.method == "jcbb" and nodes(seen.corners, view, belief, config) >= BUDGET,
        }
    return rows


def nodes(corners: Corners, view: MapView, belief: Filter, config: AssociationConfig) -> int:
    """How many nodes JCBB tries."""
    table = pairing_table(corners, view, belief, config, chi2_gate(2, config.gate_probability))
    return pair_jointly(MatchBuilder(len(corners)), corners, table.costs, view.belief.ids, belief, config)


def fastest_ms(call: Callable[[], object]) -> float:
    """Milliseconds of the fastest of some calls."""
    return 1e3 * best_of(call, CALLS)


def summarise(drives: list[Sums]) -> Figures:
    """Results of all drives of a set, with 95 % intervals over drives."""
    return {sigma: {name: figures_of(drives, sigma, name) for name in METHODS} for sigma in map(named, SIGMAS)}


def figures_of(drives: list[Sums], sigma: str, name: str) -> Figures:
    """Results of one associator at one sigma."""
    own, ours, alike = (columns_of([drive[sigma][row] for drive in drives]) for row in (name, DEFAULT, AGAINST[name]))
    return {
        **ratios(own, ms="ms/scans", right="right/scans", polygon="polygon/scans", budget_spent="budget_spent/scans"),
        **ratios(own, wrong="wrong/pairs"),
        "ratio": ratio(ours["ms"], own["ms"]),
        "ratio_with_polygons": ratio(ours["ms"] + own["polygons_ms"], own["ms"]),
        "ratio_same_corners": ratio(alike["ms"], own["ms"]),
        "scans": int(own["scans"].sum()),
    }


def report(figures: Figures) -> str:
    """Per set a table with a row for each sigma and associator."""
    columns = ["ms", "ratio", "ratio_with_polygons", "ratio_same_corners", "right", "wrong", "polygon", "budget_spent"]
    parts = {}
    for layout, cells in figures.items():
        scans = next(iter(cells.values()))[DEFAULT]["scans"]
        rows = [[sigma, name, *(row[c] for c in columns)] for sigma, of in cells.items() for name, row in of.items()]
        parts[f"{layout} ({scans} scans per row)"] = table(["pose", "associator", *columns], rows)
    return sections(parts)
