"""One scan against a finished map, at a roughly known pose: what an associator decides, and whether that is right."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.common import Figures
from benchmarks.drives import Drive
from benchmarks.kiss import KissPointsAssociator
from benchmarks.tables import columns_of, means, ratios
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import compose, inverse
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.slam import Scan, SlamConfig, SlamPipeline
from mecp_env.slam.frontend import front_end as features_of
from mecp_env.slam.mecp import find_structure
from mecp_env.slam.messages import UNKNOWN_ROOM, Corners, MapView, Match, MergedScan, Polygon
from mecp_env.slam.protocols import Associator, Filter

FIRST_SCAN = 10  # of a drive
RIGHT_PAIRS = 3


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


def named(sigma: tuple[float, float]) -> str:
    """A sigma of the pose as a key."""
    return f"{sigma[0]:g} m {sigma[1]:g} deg"


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


def drawn_looks(drive: Drive, finished: Finished, count: int, rng: np.random.Generator) -> list[Look]:
    """So many scans of the drive, drawn at random."""
    steps = rng.choice(np.arange(FIRST_SCAN, len(drive.scans)), count, replace=False)
    return [look(drive, finished, int(step)) for step in steps]


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
    rows, seconds = [], []
    for seen, error in zip(looks, errors, strict=True):
        view, belief = rough_view(finished.pipeline, seen.T_map_robot + error * sigmas, sigmas, len(seen.corners))
        if isinstance(associator, KissPointsAssociator) and seen.beams is not None:
            associator.look_at(seen.beams, finished.pipeline.grid.canvas.grid)
        begun = time.perf_counter()
        match = associator.associate(seen.corners, seen.polygons, view, belief)
        seconds.append(time.perf_counter() - begun)
        possible = int((np.isin(seen.true, mapped) & (seen.true >= 0)).sum()) >= RIGHT_PAIRS
        rows.append(judged(finished, seen, match) | {"possible": possible})
    counts = {name: int(column.sum()) for name, column in columns_of(rows).items()}
    return {"scans": len(looks), **counts, "ms": 1e3 * float(np.median(seconds))}


def rough_view(pipeline: SlamPipeline, T_map_robot: Array, sigmas: Array, corners: int) -> tuple[MapView, Filter]:
    """What an associator sees of a map at a pose (3,) with sigmas (3,), the room unknown; and the filter there."""
    belief = pipeline.filter.copy()
    belief.set_pose(T_map_robot, np.diag(sigmas**2))
    graph = replace(pipeline.rooms.graph(), current=UNKNOWN_ROOM, in_doorway=False)
    through = np.full(corners, -1)
    return pipeline.map.view(belief.belief(), graph, through, pipeline.step_count + 1), belief


def judged(finished: Finished, seen: Look, match: Match) -> Figures:
    """How many pairs a match has, how many of them are wrong, whether it is right, and has a polygon."""
    paired = match.recognised()
    claimed, true = finished.identity[match.ids[paired]], seen.true[paired]
    pairs, wrong = len(paired), len(paired) - int(((claimed == true) & (true >= 0)).sum())
    right = pairs >= RIGHT_PAIRS and not wrong
    return {"right": right, "pairs": pairs, "wrong": wrong, "polygon": match.polygon >= 0}


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
