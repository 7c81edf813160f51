"""Poorer sensors on recorded drives: odometry, range, field of view and number of beams, on the layout `paper`.

Each drive is recorded with the true pose as the driver, and every variant gets the same data. Drives of `odometry` and
`range` are recorded with that odometry and that laser. For `view` and `beams`, the scans of the drives with the default
sensors are cut: beams outside the field of view are left out, or every n-th beam of the burst in order of bearing is
kept. That gives the scans of a laser with that field of view or number of beams, but on the same drives; a robot that
sees less drives elsewhere. In the cells `slip` the wheels slip in a share of the control steps of the same drives: the
odometry of such a step measures a distance 1 to 3 times as long as the robot drove, and a turn that is off by an error
with a sigma of 10 degrees; its covariance is as before. The steps of 1 % are among those of 5 %. `known` pairs by the
true correspondences; `mecp in one pass` pairs everything at the prediction, however wide that is. `jcbb` and `ccda` are
in docs/associators.md.

`rmse_m` and `nees` (3 expected) are means over drives, `map_rmse_m` is that of the landmarks at the end from their true
corners, nothing fitted, and `landmarks_false` counts those of no true corner. A drive is lost when the pose is more
than 1 m or 10 degrees off for 20 control steps in a row or at the end, or has diverged. `far` counts the corners beyond
93 % of the range, and `phantoms` is the share of them that do not exist. `associate_ms` are milliseconds of association
per scan, the median of a drive; for `known` that is the work of the benchmark.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Figures, Options
from benchmarks.drives import Drive
from benchmarks.plots import Panel, line_panels
from benchmarks.records import IN_MEMORY, Course, Records, on_drives
from benchmarks.tables import summaries
from benchmarks.variants import DEFAULT, Variant, own_rows, replays, rows_of
from mecp_env.core.sensors import Odometry, Scan

LAYOUT = "paper"
VARIANTS = rows_of(
    *(DEFAULT, "mecp without polygons", "mecp in one pass", "jcbb with descriptor", "ccda with descriptor", "known")
)
SLIP_MOST, SLIP_TURN_RAD = 3.0, np.radians(10.0)
COLUMNS = ("rmse_m", "nees", "precision", "recall", "map_rmse_m", "landmarks_false", "duplicates", "lost")
COLUMNS += ("associate_ms", "far", "phantoms")


def narrowed(scan: Scan, degrees: float) -> Scan:
    """The scan of a laser with a field of view of so many degrees, ahead."""
    inside = np.abs(scan.bearings[0]) <= np.radians(degrees / 2.0)
    ranges, bearings, hit = (np.ascontiguousarray(a[:, inside]) for a in (scan.ranges, scan.bearings, scan.hit))
    return Scan(ranges, bearings, hit, scan.max_range_m)


def thinned(scan: Scan, every: int) -> Scan:
    """Every n-th beam of a burst in order of bearing, interleaved as before."""
    rings = (a.T.ravel()[every - 1 :: every] for a in (scan.ranges, scan.bearings, scan.hit))
    ranges, bearings, hit = (np.ascontiguousarray(ring.reshape(-1, len(scan.ranges)).T) for ring in rings)
    return Scan(ranges, bearings, hit, scan.max_range_m)


def rescanned(drive: Drive, seed: int, cut: Callable[[Scan], Scan]) -> Drive:
    """The drive with each scan cut."""
    return replace(drive, scans=[cut(scan) for scan in drive.scans])


def slipped(drive: Drive, seed: int, share: float) -> Drive:
    """The drive with wheels that slip in a share of its control steps, drawn from the seed."""
    rng = np.random.default_rng(seed)
    return replace(drive, odometry=[slip(odometry, rng, share) for odometry in drive.odometry])


def slip(odometry: Odometry | None, rng: np.random.Generator, share: float) -> Odometry | None:
    """What wheels measure that slip with a probability: they turn farther than the robot moves, and it turns aside."""
    drawn, farther, aside = rng.random(), rng.uniform(1.0, SLIP_MOST), rng.normal(0.0, SLIP_TURN_RAD)
    if odometry is None or drawn >= share:
        return odometry
    increments = odometry.increments * [farther, 1.0]
    increments[:, 1] += aside / len(increments)
    return replace(odometry, increments=increments)


BASE = "odometry_x1"  # with a range of 30 m, a view of 360 degrees, and 720 beams
RECORDED: dict[str, dict[str, Any]] = {  # cell -> the sensors of its drives
    BASE: {},
    **{f"odometry_x{scale}": {"odometry": {"scale": float(scale)}} for scale in (2, 4, 8)},
    **{f"range_{metres}_m": {"laser": {"max_range_m": float(metres)}} for metres in (10, 6, 4)},
}
CHANGED: dict[str, Callable[[Drive, int], Drive]] = {  # cell -> what it makes of a drive of BASE and its seed
    **{f"view_{wide}_deg": partial(rescanned, cut=partial(narrowed, degrees=float(wide))) for wide in (270, 180)},
    **{f"beams_{720 // every}": partial(rescanned, cut=partial(thinned, every=every)) for every in (2, 4, 8)},
    **{f"slip_{percent}_pct": partial(slipped, share=percent / 100.0) for percent in (1, 5)},
}
AXES = {  # of the figure: sensor -> cells and their names
    "odometry noise": {BASE: "x1", "odometry_x2": "x2", "odometry_x4": "x4", "odometry_x8": "x8"},
    "range": {BASE: "30 m", "range_10_m": "10 m", "range_6_m": "6 m", "range_4_m": "4 m"},
    "field of view": {BASE: "360 deg", "view_270_deg": "270 deg", "view_180_deg": "180 deg"},
    "beams": {BASE: "720", "beams_360": "360", "beams_180": "180", "beams_90": "90"},
    "steps with slip": {BASE: "0", "slip_1_pct": "1 %", "slip_5_pct": "5 %"},
}
SETS = dict.fromkeys((*RECORDED, *CHANGED), 20)


def run(options: Options) -> Figures:
    """Results of every cell and variant."""
    return {cell: summaries(rows, COLUMNS) for cell, rows in on_drives(compare, SETS, options).items()}


def all_variants() -> dict[str, Variant]:
    """The rows, with those of parts that modules have registered."""
    return VARIANTS | own_rows()


def compare(task: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each variant on one drive of a cell."""
    return {name: outcome.counts for name, outcome in replays(drive_of(*task, records), all_variants()).items()}


def drive_of(cell: str, seed: int, records: Records) -> Drive:
    """A drive with the sensors of a cell."""
    drive = records.drive(Course(LAYOUT, seed, {"estimator": "truth", **RECORDED.get(cell, {})}))
    return CHANGED[cell](drive, seed) if cell in CHANGED else drive


def figure(figures: Figures) -> Figure:
    """Pose RMSE of every variant by the sensors."""
    measured = [name for name in all_variants() if all(name in cell for cell in figures.values())]
    panels = {
        title: Panel(
            [label for cell, label in cells.items() if cell in figures],
            {name: [figures[cell][name]["rmse_m"] for cell in cells if cell in figures] for name in measured},
        )
        for title, cells in AXES.items()
    }
    return line_panels(panels, "pose RMSE, m", log=True)
