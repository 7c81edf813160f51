"""One scan against a finished map, at a roughly known pose: what an associator decides, and whether that is right."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.common import Figures
from benchmarks.drives import Drive
from benchmarks.kiss import KissPointsAssociator
from benchmarks.tables import columns_of
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose, inverse
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.slam import SlamConfig, SlamPipeline
from mecp_env.slam.frontend import front_end
from mecp_env.slam.mecp import find_structure
from mecp_env.slam.messages import UNKNOWN_ROOM, Corners, MapView, Match, MergedScan, Polygon, ScanFeatures
from mecp_env.slam.protocols import Associator, Filter

FIRST_SCAN = 10  # of a drive
RIGHT_PAIRS = 3
COLUMNS = ("right", "possible", "wrong", "wrong_pairs", "polygon", "ms", "scans")  # figures of a cell
Sigma = tuple[float, float]  # m, deg


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The map of a drive: what an associator may look at, and which true corner each landmark is."""

    pipeline: SlamPipeline
    identity: Ints  # (F,) true corner of each feature, -1 for none
    T_map_world: Array  # (3,)

    @property
    def mapped(self) -> Ints:
        """The true corners that are landmarks."""
        return self.identity[self.pipeline.filter.ids]


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The features of one scan, and what they are."""

    corners: Corners
    polygons: tuple[Polygon, ...]
    true: Ints  # (n,) true corner of each corner, -1 for none
    T_map_robot: Array  # (3,) true pose
    beams: MergedScan | None = None


def named(sigma: Sigma) -> str:
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
    found, T_world_robot = front_end(drive.scans[step], drive.slam), drive.T_world_robot[step]
    polygons = polygons_of(found, drive.slam)
    true = drive.truth.identify(found.corners, T_world_robot)
    return Look(found.corners, polygons, true, compose(finished.T_map_world, T_world_robot), found.beams)


def polygons_of(found: ScanFeatures, slam: SlamConfig) -> tuple[Polygon, ...]:
    """The polygons of a scan."""
    return find_structure(found.corners, found.beams, slam.polygon, found.wall)


def drawn_looks(drive: Drive, finished: Finished, count: int, rng: np.random.Generator) -> list[Look]:
    """So many scans of the drive, drawn at random."""
    steps = rng.choice(np.arange(FIRST_SCAN, len(drive.scans)), count, replace=False)
    return [look(drive, finished, int(step)) for step in steps]


def count_scans(finished: Finished, associator: Associator, looks: list[Look], sigma: Sigma, errors: Array) -> Figures:
    """Counts of one associator on the scans, with `errors` (n,3) of the pose in units of sigma."""
    rows = []
    for seen, error in zip(looks, errors, strict=True):
        view, belief = rough_view(finished.pipeline, seen, sigma, error)
        if isinstance(associator, KissPointsAssociator) and seen.beams is not None:
            associator.look_at(seen.beams, finished.pipeline.grid.canvas.grid)
        rows.append(judged(finished, seen, *decided(associator, seen, view, belief)))
    of = columns_of(rows)
    ms = float(np.median(of.pop("ms")))
    return {"scans": len(looks), **{name: int(column.sum()) for name, column in of.items()}, "ms": ms}


def rough_view(pipeline: SlamPipeline, seen: Look, sigma: Sigma, error: Array) -> tuple[MapView, Filter]:
    """What an associator sees of a map at a pose that is off by `error` (3,) sigmas, the room unknown; the filter."""
    belief, sigmas = pipeline.filter.copy(), np.array([sigma[0], sigma[0], math.radians(sigma[1])])
    belief.set_pose(seen.T_map_robot + error * sigmas, np.diag(sigmas**2))
    graph = replace(pipeline.rooms.graph(), current=UNKNOWN_ROOM, in_doorway=False)
    through = np.full(len(seen.corners), -1)
    return pipeline.map.view(belief.belief(), graph, through, pipeline.step_count + 1), belief


def decided(associator: Associator, seen: Look, view: MapView, belief: Filter, calls: int = 1) -> tuple[Match, float]:
    """The match of a scan, and the milliseconds of the fastest call."""
    seconds = []
    for _ in range(calls):
        begun = time.perf_counter()
        match = associator.associate(seen.corners, seen.polygons, view, belief)
        seconds.append(time.perf_counter() - begun)
    return match, 1e3 * min(seconds)


def judged(finished: Finished, seen: Look, match: Match, ms: float) -> Figures:
    """How many pairs a match has, how many of them are wrong, whether it is right, and has a polygon; its time."""
    paired = match.recognised()
    claimed, true = finished.identity[match.ids[paired]], seen.true[paired]
    pairs, wrong = len(paired), len(paired) - int(((claimed == true) & (true >= 0)).sum())
    possible = int((np.isin(seen.true, finished.mapped) & (seen.true >= 0)).sum()) >= RIGHT_PAIRS
    right = pairs >= RIGHT_PAIRS and not wrong
    verdict = {"right": right, "pairs": pairs, "wrong": wrong, "polygon": match.polygon >= 0}
    return verdict | {"possible": possible, "ms": ms}


def right_share(cells: list[Figures]) -> Array:
    """(n,) share of right scans of each drive."""
    columns = columns_of(cells)
    return columns["right"] / columns["scans"]
