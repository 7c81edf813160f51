"""KISS-Matcher as a rival: a core of the graph of pairs that agree, and a robust solver for the pose.

H. Lim, D. Kim, G. Shin, J. Shi, I. Vizzo, H. Myung, J. Park and L. Carlone, "KISS-Matcher: fast and robust point cloud
registration revisited", IEEE International Conference on Robotics and Automation, 2025; the package `kiss-matcher`
(extra `lab`). It registers clouds of points in 3D, with the radii and the bounds that its authors recommend for a size
of voxel.

`KissAssociator` gives its pruning (the largest core of the graph of equal distances) and its solver (graduated
non-convexity for the heading, truncated least squares for the position) the pairs of corner and landmark that are the
nodes of `ccda`: inside the gate, with descriptors. `KissPointsAssociator` gives the whole method, which has its own
features of points, the walls that the scan and the map show, made `HEIGHT_M` high: in a flat cloud all normals are
equal. The map's walls are those within reach of the predicted pose, in its frame, so that the normals of both clouds
point to the robot.

The nodes of `ccda` whose corner and landmark are no further apart at the pose found than the bound of the core, each
corner and landmark once, must pass the joint test of `ccda`. The package keeps the bound of its first heading for the
life of a process, so that both have the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import from_lab
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose, inverse, polar_to_points, to_map
from mecp_env.lab.rivals import TableAssociator
from mecp_env.slam.association import MatchBuilder
from mecp_env.slam.association.cliques import candidate_pairs, jointly_compatible
from mecp_env.slam.association.gating import one_to_one
from mecp_env.slam.messages import Belief, Cell, Corners, Decision, MapView, MergedScan, Reason, SemanticGrid
from mecp_env.slam.protocols import Filter

PACKAGE = "kiss_matcher"
VOXEL_M = 0.2  # also the bound of the core; that of the solver is 3/4 of it
HEIGHT_M = 1.0
REACH_SIGMAS = 3.0  # of the predicted position, beyond the range of the laser
LEAST_PAIRS = 2  # that show a heading


@dataclass(slots=True, eq=False)
class KissAssociator(TableAssociator):
    """The pairs that fit at the pose of KISS-Matcher's pruning and solver, as far as they fit together."""

    matcher: Any = field(init=False)

    def __post_init__(self) -> None:
        TableAssociator.__post_init__(self)
        found = from_lab(PACKAGE, "the rows `kiss-matcher` need KISS-Matcher")
        self.matcher = found.KISSMatcher(found.KISSMatcherConfig(voxel_size=VOXEL_M, use_quatro=True))

    def _pair(self, builder: MatchBuilder, corners: Corners, costs: Array, view: MapView, belief: Filter) -> None:
        rows, columns = candidate_pairs(costs, self.gate, self.config.search_budget)
        rows, columns = self._fitting(polar_to_points(corners.z), rows, columns, view.belief)
        ids = view.belief.ids[columns]
        iterate = not self.config.is_sharp(view.belief)
        fits = jointly_compatible(corners, rows, ids, belief, self.config, iterate)
        builder.assign(rows[fits], Decision.LANDMARK, Reason.JOINT, ids[fits], costs[rows, columns][fits])

    def _fitting(self, p_robot: Array, rows: Ints, columns: Ints, predicted: Belief) -> tuple[Ints, Ints]:
        """Those of the pairs (P,) that are within VOXEL_M at the pose found, (k,) each; no corner or landmark twice."""
        T_map_robot = self._pose(p_robot[rows], predicted.p_map[columns], predicted)
        if T_map_robot is None:
            return rows[:0], columns[:0]
        apart = np.full((len(p_robot), len(predicted.ids)), math.inf)
        off = to_map(T_map_robot, p_robot)[rows] - predicted.p_map[columns]
        apart[rows, columns] = np.hypot(*off.T)
        chosen = one_to_one(apart, VOXEL_M)
        fitting = np.flatnonzero(chosen >= 0)
        return fitting, chosen[fitting]

    def _pose(self, p_robot: Array, p_map: Array, predicted: Belief) -> Array | None:
        """The pose (3,) that the pairs of points (P,2) agree on; None: none."""
        if len(p_robot) < LEAST_PAIRS:
            return None
        self.matcher.reset_solver()  # which otherwise answers for too few pairs with its last pose
        return _planar(self.matcher.prune_and_solve(_flat(p_robot), _flat(p_map)))


@dataclass(slots=True, eq=False)
class KissPointsAssociator(KissAssociator):
    """The pairs that fit at the pose of KISS-Matcher's whole method on the walls, as far as they fit together."""

    p_robot: Array = field(init=False)  # (W,2) walls that the scan shows
    p_map: Array = field(init=False)  # (W,2) walls of the map
    range_m: float = field(init=False)

    def look_at(self, beams: MergedScan, grid: SemanticGrid) -> None:
        """What the next scan to be associated shows of walls, and what the map does."""
        self.p_robot = polar_to_points(np.stack([beams.ranges, beams.bearings], axis=1)[beams.hit])
        cells = np.argwhere(grid.label == Cell.OCCUPIED)[:, ::-1]
        self.p_map, self.range_m = grid.origin + (cells + 0.5) * grid.resolution_m, beams.max_range_m

    def _pose(self, p_robot: Array, p_map: Array, predicted: Belief) -> Array | None:
        """The pose (3,) at which the walls look alike; None: none."""
        T_map_guess = predicted.T_map_robot
        reach = self.range_m + REACH_SIGMAS * math.sqrt(np.linalg.eigvalsh(predicted.pose_cov[:2, :2])[-1])
        near = self.p_map[np.hypot(*(self.p_map - T_map_guess[:2]).T) <= reach]
        if min(len(self.p_robot), len(near)) < LEAST_PAIRS:
            return None
        self.matcher.reset()
        found = _planar(self.matcher.estimate(_raised(self.p_robot), _raised(to_map(inverse(T_map_guess), near))))
        return None if found is None else compose(T_map_guess, found)


def _planar(solution: Any) -> Array | None:
    """The pose (3,) of x, y, heading of a solution; None: it is none."""
    (cos, *_), (sin, *_), _ = np.asarray(solution.rotation)
    x, y, _ = np.ravel(solution.translation)
    return np.array([x, y, math.atan2(sin, cos)]) if solution.valid else None


def _flat(points: Array, z: float = 0.0) -> list[NDArray[np.float32]]:
    """Points (n,2) at a height, as the package takes them."""
    return list(np.column_stack([points, np.full(len(points), z)]).astype(np.float32))


def _raised(points: Array) -> list[NDArray[np.float32]]:
    """Walls (n,2) in layers, one to a voxel."""
    return [point for z in np.arange(VOXEL_M / 2, HEIGHT_M, VOXEL_M).tolist() for point in _flat(points, z)]
