"""Spatial structures (the paper's future work, VI) on the same drives: the MECP against the largest polygon.

`mecp` is the empty convex polygon around the robot with most vertices, `largest_area` the one that covers most floor;
structures registered by the modules of `--with` have rows too. All else is the default estimator.

Closed loop, breadth-first drives: columns as in `association`. `by_polygon` is the share of corners that a recognised
polygon paired, `recognised` the share of scans with such a polygon, `unique` that of scans with a single polygon,
`vertices` and `area_m2` are means of the first one, and `us` is the time of one call, the median of a drive.
`false_per_100` are false loop closures per 100 episodes. Rough pose, as in `loop`: one scan against the finished map
that the structure made, the share of scans with at least three right pairs and none wrong.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks import association, loop
from benchmarks.common import Figures, Options, estimate, ratio, runs_of
from benchmarks.drives import Drive, replay
from benchmarks.polygon_speed import median_us
from benchmarks.records import HARD, IN_MEMORY, Records, on_records
from benchmarks.rough_pose import COLUMNS, named, polygons_of, right_share
from benchmarks.tables import by_row, columns_of, summary
from benchmarks.variants import DEFAULT, rows_of, with_change
from mecp_env.slam import SlamConfig, config
from mecp_env.slam.frontend import front_end

SETS = {"paper": 30, "furnished": 15, "office": 10, "twins": 100, HARD: 8}
ROUGH = {"paper": 10, "furnished": 10, "twins": 10, HARD: 6}  # drives of the second part
SIGMAS = ((1.0, 10.0), (2.0, 20.0))
VARIANTS = rows_of(DEFAULT, "mecp without descriptor")
SUMMARY = ("precision", "recall", "duplicates_per_corner", "closure_recall", "events", "rmse_m", "map_rmse_m", "lost")
OF_POLYGONS = ("by_polygon", "recognised", "unique", "vertices", "area_m2", "us")
TIMED_SCANS = 25  # of a drive
PLAIN = "mecp"


def run(options: Options) -> Figures:
    """Both parts, for each layout and structure."""
    drives = runs_of(options, SETS)
    units = [("closed", layout, seed) for layout, seed in drives]
    units += [("rough", layout, seed) for layout, seed in drives if seed < ROUGH.get(layout, 0)]
    parts: Figures = {"closed": {}, "rough": {}}
    for (kind, layout), runs in on_records(measure, dict[str, Any], units, options).items():
        rows, of = by_row(runs), of_closed if kind == "closed" else of_rough
        parts[kind][layout] = {name: of(own, rows[PLAIN]) for name, own in rows.items()}
    return parts


def measure(unit: tuple[str, str, int], records: Records = IN_MEMORY) -> Figures:
    """The counts of each structure on one drive."""
    kind, layout, seed = unit
    drive, found = records.drive((loop if kind == "rough" else association).course(layout, seed)), Figures()
    for name in (*config.STRUCTURE_NAMES.ours, *config.STRUCTURE_NAMES.others):
        own = replace(drive, slam=with_change(drive.slam, {"polygon": {"structure": name}}))
        if kind == "rough":
            found[name] = loop.on_drive(own, loop.SCANS, seed, VARIANTS, SIGMAS)
        else:
            found[name] = association.counts(own, replay(own, own.slam)) | {"us": time_us(own, own.slam)}
    return found


def time_us(drive: Drive, slam: SlamConfig) -> float:
    """Microseconds of one call, the median over scans of a drive."""
    scans = drive.scans[:: max(len(drive.scans) // TIMED_SCANS, 1)]
    fronts = [front_end(scan, slam) for scan in scans]
    return median_us(lambda found: polygons_of(found, slam), fronts, repeats=5)


def of_closed(runs: list[Figures], base: list[Figures]) -> Figures:
    """Figures of one structure over all drives of a layout, with 95 % intervals and differences to `mecp`."""
    columns, usual = columns_of(runs), columns_of(base)
    paired, usually = (of["paired"] / np.maximum(of["seen"], 1.0) for of in (columns, usual))
    return {
        "drives": len(runs),
        **summary(runs, SUMMARY),
        "false_per_100": ratio(100.0 * columns["false_closures"], np.ones(len(runs))),
        **summary(runs, OF_POLYGONS),
        **association.differences(runs, base),
        "by_polygon_minus_mecp": estimate(paired - usually),
    }


def of_rough(runs: list[Any], base: list[Any]) -> Figures:
    """Right and wrong of one structure, and the difference to `mecp` on the same scans."""
    figures: Figures = {}
    for variant, sigma in product(VARIANTS, map(named, SIGMAS)):
        own, usual = ([run[variant][sigma] for run in some] for some in (runs, base))
        gained = right_share(own) - right_share(usual)
        figures[f"{variant}, {sigma}"] = summary(own, COLUMNS) | {"right_minus_mecp": estimate(gained)}
    return figures
