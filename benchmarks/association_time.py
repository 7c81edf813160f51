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
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.clutter import placed
from benchmarks.common import Figures, Options, best_of, ratio, runs_of
from benchmarks.drives import Drive
from benchmarks.loop import course
from benchmarks.records import IN_MEMORY, Records, on_records
from benchmarks.rough_pose import FIRST_SCAN, Finished, Look, Sigma, decided, finish, judged, look, named, polygons_of
from benchmarks.rough_pose import rough_view as view_at
from benchmarks.tables import columns_of, summary
from benchmarks.variants import DEFAULT, Variant, rows_of, with_change
from mecp_env.core.carriers import Array, Ints
from mecp_env.lab.rivals import pair_jointly
from mecp_env.slam.association import MatchBuilder, make_associator
from mecp_env.slam.association.gating import chi2_gate, pairing_table
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend import front_end
from mecp_env.slam.messages import CornerKind, Corners, MergedScan, Polygon

CORNERS, SPURIOUS = 20, 4
SIGMAS = ((0.05, 0.5), (0.3, 3.0), (1.0, 10.0), (2.0, 20.0))  # m, deg
PLAIN = "mecp without descriptor"
METHODS = rows_of(DEFAULT, "jcbb with descriptor", "ccda with descriptor", PLAIN, "jcbb", "ccda")
AGAINST = {name: PLAIN if name in (PLAIN, "jcbb", "ccda") else DEFAULT for name in METHODS}
BUDGET = 1_000_000  # nodes; ten times the default, so that most searches end
SETS = {"paper": 10, "furnished": 6, "hard": 6}  # drives
SCANS, QUICK_SCANS, QUICK_DRIVES, CALLS = 10, 3, 1, 3
IN_FRONT = (0.2, 0.9)  # share of a beam's range at which a spurious corner may be
RATIOS = ("ratio", "ratio_with_polygons", "ratio_same_corners")
Sums = dict[str, dict[str, Figures]]  # sigma -> associator -> sums over scans


def run(options: Options) -> Figures:
    """Results of every set, sigma and associator."""
    task = partial(compare, count=QUICK_SCANS if options.quick else SCANS)
    found = on_records(task, Sums, runs_of(options, SETS, QUICK_DRIVES), options)
    return {layout: summarise(drives) for layout, drives in found.items()}


def compare(drive_of: tuple[str, int], records: Records = IN_MEMORY, count: int = SCANS) -> Sums:
    """Sums over the scans of the drive of one layout and seed, for each sigma and associator."""
    drive = records.drive(course(*drive_of))
    finished, rng = finish(drive), np.random.default_rng(drive_of[1])
    looks, polygons_ms = cluttered_looks(drive, finished, count, rng)
    sums: Sums = {}
    for sigma in SIGMAS:
        errors = rng.normal(size=(len(looks), 3))
        sums[named(sigma)] = {
            name: race(finished, row, drive.slam, looks, sigma, errors) | {"polygons_ms": polygons_ms}
            for name, row in METHODS.items()
        }
    return sums


def cluttered_looks(drive: Drive, finished: Finished, count: int, rng: np.random.Generator) -> tuple[list[Look], float]:
    """Up to `count` scans with clutter, and the milliseconds that finding their polygons takes in total."""
    mapped, looks, ms = finished.mapped, list[Look](), 0.0
    for step in rng.permutation(np.arange(FIRST_SCAN, len(drive.scans))).tolist():
        seen = look(drive, finished, step)
        real = np.flatnonzero(np.isin(seen.true, mapped) & (seen.true >= 0))
        if CORNERS - SPURIOUS <= len(real) <= CORNERS and len(looks) < count:
            plain = front_end(drive.scans[step], drive.slam)
            kept = vertices_first(real, seen.polygons, rng)
            corners, source = with_spurious(plain.corners, plain.beams, kept, rng)
            find = partial(polygons_of, plain.with_corners(corners), drive.slam)
            looks.append(Look(corners, find(), np.where(source < 0, -1, seen.true[source]), seen.T_map_robot))
            ms += 1e3 * best_of(find, CALLS)
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
    donors, quarters = rng.choice(kept, SPURIOUS), rng.integers(0, 4, len(z))[np.argsort(np.argsort(z[:, 1]))]
    made, order = placed(corners, z, kept, donors, quarters[len(kept) :] * (math.pi / 2.0))
    false = order >= len(kept)
    made = replace(made, kind=np.where(false, int(CornerKind.CROSSING), made.kind), sites=made.sites | false)
    return made, np.concatenate([kept, np.full(SPURIOUS, -1)])[order]


def race(finished: Finished, row: Variant, slam: SlamConfig, looks: list[Look], sigma: Sigma, errors: Array) -> Figures:
    """Sums over scans of what an associator decides and what that costs."""
    config = with_change(slam, row.change).association.model_copy(update={"search_budget": BUDGET})
    associator, gate, rows = make_associator(config), chi2_gate(2, config.gate_probability), []
    for seen, error in zip(looks, errors, strict=True):
        view, belief = view_at(finished.pipeline, seen, sigma, error)
        verdict = judged(finished, seen, *decided(associator, seen, view, belief, CALLS))
        spent = 0
        if config.method == "jcbb":
            costs = pairing_table(seen.corners, view, belief, config, gate).costs
            builder = MatchBuilder(len(seen.corners))
            spent = pair_jointly(builder, seen.corners, costs, view.belief.ids, belief, config)
        rows.append(verdict | {"scans": 1, "budget_spent": spent >= BUDGET})
    return {name: float(column.sum()) for name, column in columns_of(rows).items()}


def summarise(drives: list[Sums]) -> Figures:
    """Results of all drives of a set, with 95 % intervals over drives."""
    return {sigma: {name: figures_of(drives, sigma, name) for name in METHODS} for sigma in map(named, SIGMAS)}


def figures_of(drives: list[Sums], sigma: str, name: str) -> Figures:
    """Results of one associator at one sigma."""
    runs = [drive[sigma][name] for drive in drives]
    own, ours, alike = (columns_of([drive[sigma][row] for drive in drives]) for row in (name, DEFAULT, AGAINST[name]))
    return {
        "ms": ratio(own["ms"], own["scans"]),
        **summary(runs, ("right", "polygon", "budget_spent", "wrong", "scans")),
        "ratio": ratio(ours["ms"], own["ms"]),
        "ratio_with_polygons": ratio(ours["ms"] + own["polygons_ms"], own["ms"]),
        "ratio_same_corners": ratio(alike["ms"], own["ms"]),
    }
