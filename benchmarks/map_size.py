"""Time per step of every filter and every associator in maps of 25 to 2,000 landmarks.

The map is that of a drive on `paper` at its first 25 landmarks; larger maps have copies of it, rooms and polygons too,
each 50 m beside the other. The next 12 scans of the drive are timed. `filters`: whole steps of the estimator with that
filter, CPU time of the thread; the robot stays among the first landmarks, so that `riekf_submaps` takes no other
submap (`scale` measures explorations, where it does). `associators`: the decision alone, with the default filter and a
spurious corner for every fourth corner (see `clutter`); the pose is off by 0.3 m and 3 degrees (sigmas), its covariance
says so, and the room is unknown; the fastest of three calls counts. Milliseconds by the number of landmarks, means over
scans with their 95 % intervals.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from benchmarks import loop
from benchmarks.clutter import cluttered
from benchmarks.common import Figures, Options, estimate, in_parallel
from benchmarks.drives import Drive
from benchmarks.plots import Panel, panel_rows
from benchmarks.records import IN_MEMORY, Records
from benchmarks.rough_pose import Look, decided, polygons_of, rough_view
from benchmarks.variants import associators, with_change
from mecp_env.core.se2 import compose, inverse, to_robot
from mecp_env.slam.config import KINDS, SlamConfig
from mecp_env.slam.frontend import front_end
from mecp_env.slam.messages import MapPolygon
from mecp_env.slam.pipeline import SlamPipeline

COUNTS, QUICK = (25, 50, 100, 200, 500, 1000, 2000), (25, 50)
FILTERS, ASSOCIATORS = "filters", "associators"
FIRST, SCANS, APART_M = 25, 12, 50.0
SPURIOUS = 0.25  # per corner: a fifth of all
SIGMA = (0.3, 3.0)  # m, deg: of the pose
ROOMS, CALLS = 1000, 3  # numbers of rooms between copies; of which the fastest counts
NOT_TIMED = ("known",)  # looks up the truth
SEED, SIGMA_M = 0, 0.01


def run(options: Options) -> Figures:
    """Milliseconds by part, name and number of landmarks."""
    names = {FILTERS: [*KINDS.ours, *KINDS.others], ASSOCIATORS: [n for n in associators() if n not in NOT_TIMED]}
    counts = QUICK if options.quick else COUNTS
    tasks = [(part, name, count) for count in counts for part, of in names.items() for name in of]
    task = partial(measure, records=Records(options.records))
    figures: Figures = {part: {name: {} for name in of} for part, of in names.items()}
    for (part, name, count), ms in zip(tasks, in_parallel(task, list[float], tasks, options), strict=True):
        figures[part][name][str(count)] = estimate(ms)
    return figures


def measure(task: tuple[str, str, int], records: Records = IN_MEMORY) -> list[float]:
    """Milliseconds of each scan."""
    part, name, count = task
    return (step_ms if part == FILTERS else association_ms)(records.drive(loop.course("paper", SEED)), name, count)


def step_ms(drive: Drive, name: str, count: int) -> list[float]:
    """Milliseconds of each step with a filter, CPU time of this thread."""
    pipeline, first = enlarged(drive, with_change(drive.slam, {"filter": {"kind": name}}), count)
    clock = [time.thread_time()]
    clock += [time.thread_time() for _ in drive.part(first, SCANS).outputs(pipeline)]
    return (1e3 * np.diff(clock)).tolist()


def association_ms(drive: Drive, name: str, count: int) -> list[float]:
    """Milliseconds of each decision in a map of so many landmarks."""
    pipeline, first = enlarged(drive, drive.slam, count)
    associator = associators()[name].associator(drive.slam)
    rng, T_map_world, ms = np.random.default_rng(SEED), inverse(drive.T_world_robot[0]), list[float]()
    for number in range(first, first + SCANS):
        plain = front_end(drive.scans[number], drive.slam)
        found = plain.with_corners(cluttered(plain.corners, plain.beams, 1.0, SPURIOUS, rng))
        unknown, T_map_robot = np.full(len(found.corners), -1), compose(T_map_world, drive.T_world_robot[number])
        seen = Look(found.corners, polygons_of(found, drive.slam), unknown, T_map_robot)
        ms.append(decided(associator, seen, *rough_view(pipeline, seen, SIGMA, rng.normal(size=3)), CALLS)[1])
    return ms


def enlarged(drive: Drive, slam: SlamConfig, count: int) -> tuple[SlamPipeline, int]:
    """An estimator on the drive with so many landmarks, and the number of the scan that comes next."""
    pipeline = SlamPipeline(slam)
    outputs = drive.outputs(pipeline)
    for number, _ in enumerate(outputs, 1):
        if len(pipeline.filter.ids) >= FIRST:
            enlarge(pipeline, count)
            next(outputs)  # divides a map into submaps
            return pipeline, number + 1
    raise ValueError(f"the drive has {len(pipeline.filter.ids)} landmarks, {FIRST} expected")


def enlarge(pipeline: SlamPipeline, count: int) -> None:
    """Add copies of the map, each in its own place and rooms, until it has `count` landmarks."""
    first, own = pipeline.filter.belief(), tuple(pipeline.map.polygons.polygons)
    for number in range(1, -(-count // FIRST)):
        belief = pipeline.filter.belief()
        old = first.ids[: count - len(belief.ids)]
        rows = pipeline.map.features.rows[old].copy()
        rows["room"] += ROOMS * number
        new = pipeline.map.features.append(rows)
        p_robot = to_robot(belief.T_map_robot, first.p_map[: len(old)] + np.array([APART_M * number, 0.0]))
        z = np.stack([np.hypot(*p_robot.T), np.arctan2(p_robot[:, 1], p_robot[:, 0])], axis=1)
        sigmas = np.stack([np.full(len(z), SIGMA_M), SIGMA_M / z[:, 0]], axis=1)
        pipeline.filter.augment(z, np.diag(sigmas.ravel() ** 2), new)
        copy_polygons(pipeline, own, dict(zip(old.tolist(), new.tolist(), strict=True)), ROOMS * number)


def copy_polygons(pipeline: SlamPipeline, own: tuple[MapPolygon, ...], to: dict[int, int], rooms: int) -> None:
    """Add the polygons of the first map, with the vertices that its landmarks have become."""
    store = pipeline.map.polygons
    for polygon in own:
        if to.keys() >= set(polygon.ids.tolist()):
            ring = np.array([to[vertex] for vertex in polygon.ids.tolist()])
            store.polygons.append(replace(polygon, ids=ring, room=polygon.room + rooms))
    store.row, store.outdated = {}, True  # indexed again
    store.prune(pipeline.map.features, pipeline.rooms.resolve)


def figure(figures: Figures) -> Figure:
    """Milliseconds by the number of landmarks, both on a logarithmic scale."""
    panels = {
        part: Panel(list(next(iter(rows.values()))), {name: list(of.values()) for name, of in rows.items()})
        for part, rows in figures.items()
    }
    return panel_rows({"landmarks, count": panels}, "time, ms", log=True)
