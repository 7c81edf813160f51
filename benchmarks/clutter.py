"""Corners that are missed and corners that do not exist, between front end and association, on recorded drives.

Every corner that the front end finds is kept with the probability `detection`; for a share `spurious` of them, another
one is added: a copy of it, with its covariance and descriptor, turned to a random beam and put where that beam ends, at
least 0.5 m from every corner found. Front end, drives and draws are the same for every associator, and a corner that is
missed at a detection of 0.95 is missed at 0.9, too. A jamb that is missed takes its door sighting with it. `known`
pairs by the true correspondences, and is what an associator could reach.

The drives were recorded with the true pose as the driver (`hard`: generated buildings of the test split, those of
`loop`). Precision and recall count all corners, with the identity that each landmark has at the end: a spurious corner
paired with a landmark is wrong; recall is that of corners whose landmark there was. `rmse_m` is that of the pose, means
over drives. A drive is lost when the pose is more than 1 m or 10 degrees off for 20 control steps in a row or at the
end, or has diverged. `associate_ms` are milliseconds of association per scan, the median of a drive.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import noise
from benchmarks.common import Figures, Options, runs_of
from benchmarks.loop import course
from benchmarks.plots import Panel, panel_rows
from benchmarks.records import HARD, IN_MEMORY, Records, on_records
from benchmarks.tables import by_row, sections, summaries, table
from benchmarks.variants import associators, replays
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import polar_to_points, wrap_angle
from mecp_env.slam import SlamConfig, SlamPipeline
from mecp_env.slam.messages import Belief, CornerKind, Corners, Doorways, MergedScan, ScanFeatures
from mecp_env.slam.rooms import RoomGraphEstimator

DETECTION, SPURIOUS = (1.0, 0.95, 0.9, 0.8), (0, 10, 20, 30)  # probability; per cent
CELLS = (*((d, 0) for d in DETECTION), *((1.0, s) for s in SPURIOUS[1:]), (0.9, 20), (0.8, 30))
SETS = {"paper": 20, HARD: 4}
CLEAR_M = 0.5
TABLE_ONLY = ("mecp_paper", "ccda", "jcbb with descriptor and rooms", "nearest_room")  # too many lines for a figure
METRICS = ("precision", "recall", "rmse_m", "lost", "associate_ms")
DRAWN = {"precision": "1 - precision", "recall": "1 - recall", "rmse_m": "pose RMSE, m"}


def run(options: Options) -> Figures:
    """Results of every layout, cell and associator."""
    drives = [(layout, *cell, seed) for layout, seed in runs_of(options, SETS) for cell in CELLS]
    figures: Figures = {}
    for (layout, *cell), runs in on_records(compare, dict[str, Figures], drives, options).items():
        figures.setdefault(layout, {})[named(*cell)] = summaries(by_row(runs), noise.COLUMNS)
    return figures


def named(detection: float, spurious: int) -> str:
    """A cell as a key."""
    return f"detection {detection:g}, spurious {spurious} %"


def compare(task: tuple[str, float, int, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each associator on one drive of a cell."""
    layout, detection, spurious, seed = task
    drive = records.drive(course(layout, seed))
    made = partial(ClutteredPipeline, chances=(detection, spurious / 100.0), seed=seed)
    return {name: outcome.counts for name, outcome in replays(drive, associators(), made).items()}


class ClutteredRooms(RoomGraphEstimator):
    """The room graph, to which the corners of a scan go before any other stage: it is given others."""

    corners: Corners

    def mark_beyond(self, corners: Corners, belief: Belief) -> tuple[Corners, Ints]:
        """As the room graph does, with the other corners."""
        return super().mark_beyond(self.corners, belief)


class ClutteredPipeline(SlamPipeline):
    """The estimator behind a front end that misses corners and invents some; the same ones for every associator."""

    rooms: ClutteredRooms

    def __init__(self, config: SlamConfig, chances: tuple[float, float], seed: int, **parts: Any) -> None:
        super().__init__(config, **parts)
        self.rooms = ClutteredRooms(self.rooms.config)
        self.chances, self.seed = chances, seed

    def register(self, scan: ScanFeatures) -> bool:
        """The corners change here, where the features of a scan are first used."""
        rng = np.random.default_rng((self.seed, self.step_count))
        self.rooms.corners = cluttered(scan.corners, scan.beams, *self.chances, rng)
        return super().register(scan.with_corners(self.rooms.corners))


def cluttered(
    corners: Corners, beams: MergedScan, detection: float, spurious: float, rng: np.random.Generator
) -> Corners:
    """The corners that are detected, and for a share of all another one elsewhere, in order of bearing."""
    kept, donors, ends = rng.random(len(corners)), rng.random(len(corners)), rng.random(len(corners))
    clear = clear_hits(corners, beams)
    old = np.flatnonzero(kept < detection)
    donor = np.flatnonzero(donors < spurious) if len(clear) else old[:0]
    at = clear[(ends[donor] * len(clear)).astype(np.int64)]
    z = np.concatenate([corners.z[old], np.stack([beams.ranges[at], beams.bearings[at]], axis=1)])
    return placed(corners, z, old, donor, beams.bearings[at] - corners.z[donor, 1])[0]


def clear_hits(corners: Corners, beams: MergedScan) -> Ints:
    """The beams that hit something far from every corner."""
    hits = np.flatnonzero(beams.hit)
    points = polar_to_points(np.stack([beams.ranges[hits], beams.bearings[hits]], axis=1))
    apart = np.hypot(*np.moveaxis(points[:, None] - polar_to_points(corners.z), 2, 0))
    return hits[(apart > CLEAR_M).all(axis=1)]


def placed(corners: Corners, z: Array, old: Ints, donor: Ints, turns: Array) -> tuple[Corners, Ints]:
    """The corners `old`, and a turned copy of each of the corners `donor`, at `z` (n,2); both in order of bearing.

    Also the order (n,): which of `z` each is. A copy is independent of all others, and no jamb.
    """
    order = np.argsort(z[:, 1], kind="stable")
    source, false = np.concatenate([old, donor])[order], order >= len(old)
    place = np.full(len(corners), -1)  # of each old corner now
    place[source[~false]] = np.flatnonzero(~false)
    jambs = place[corners.doorways.jambs.reshape(-1, 2)]
    there = (jambs >= 0).all(axis=1)
    number = np.append(np.where(there, np.cumsum(there) - 1, -1), -1)  # of each doorway now; the last: of none
    kind = np.where(false & (corners.kind[source] == CornerKind.JAMB), CornerKind.FREE_END, corners.kind[source])
    turned = corners.normals[source] + np.concatenate([np.zeros(len(old)), turns])[order][:, None]
    normals = np.array([[wrap_angle(a) for a in row] for row in turned.tolist()]).reshape(-1, 2)
    beyond = np.where(false, -1, number[corners.beyond[source]])
    marks = corners.convex[source], normals, beyond, corners.sites[source]
    alone = np.repeat(false, 2)
    own = np.kron(np.eye(len(false), dtype=bool), np.ones((2, 2), dtype=bool))
    cov = np.where(own | ~(alone[:, None] | alone), corners.measurements(source)[1], 0.0)
    doorways = Doorways(jambs[there], corners.doorways.width[there], corners.doorways.confirmable[there])
    return Corners(z[order], cov, kind.astype(np.int64), *marks, doorways), order


def report(figures: Figures) -> str:
    """Per layout a table of each metric, with a row per associator and a column per cell."""
    parts = {}
    for layout, cells in figures.items():
        first, tables = next(iter(cells.values())), []
        columns = [cell.replace("detection ", "").replace("spurious ", "") for cell in cells]
        for metric in METRICS:
            rows = [[name, *(of[name][metric] for of in cells.values())] for name in first]
            tables.append(table([f"`{metric}`: detection, spurious", *columns], rows))
        parts[f"{layout} ({next(iter(first.values()))['rmse_m']['n']} drives)"] = "\n\n".join(tables)
    return sections(parts)


def figure(figures: Figures) -> Figure:
    """A panel per layout and metric, over detection and over spurious corners."""
    points_of = {"detection": [(d, 0) for d in DETECTION], "spurious, %": [(1.0, s) for s in SPURIOUS]}
    rows: dict[str, dict[str, Panel]] = {}
    for number, (x, points) in enumerate(points_of.items()):
        for layout, cells in figures.items():
            measured = {f"{cell[number]:g}": cells[named(*cell)] for cell in points if named(*cell) in cells}
            panels = {label: Panel(list(measured), lines_of(measured.values(), key)) for key, label in DRAWN.items()}
            rows.setdefault(x, {}).update({f"{layout}: {label}": panel for label, panel in panels.items()})
    return panel_rows(rows, "", log=True, sharey=False)


def lines_of(cells: Collection[Figures], metric: str) -> dict[str, list[Figures]]:
    """What is drawn of each associator that all cells have."""
    names = [name for name in next(iter(cells), {}) if name not in TABLE_ONLY]
    return {name: [drawable(of[name], metric) for of in cells] for name in names if all(name in of for of in cells)}


def drawable(row: Figures, metric: str) -> Figures:
    """A share as what is missing from it, which a log scale shows; anything else as it is."""
    figure: Figures = row[metric]
    if metric == "rmse_m" or figure["value"] is None:
        return figure
    return {"value": 1.0 - figure["value"], "low": 1.0 - figure["high"], "high": 1.0 - figure["low"]}
