"""What smoothing needs of a run, kept while the pipeline maps, and the final path and map made of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import composed, inverse
from mecp_env.core.sensors import Odometry
from mecp_env.slam.filters import Filter, make_filter
from mecp_env.slam.filters.mounting import predict_mounted
from mecp_env.slam.messages import NO_ID, NO_IDS, Belief, SemanticGrid
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.smoothing.optimum import Links, PoseGraph, Priors, Sightings, SmoothingError, inverses, smooth

Seen = tuple[int, Ints, Array, Array]  # scan, ids (c,), z (c,2), R (2c,2c)


@dataclass(frozen=True, slots=True, eq=False)
class FinalMap:
    """Path, landmarks and grid of a run, smoothed over all its scans."""

    T_map_robot: Array  # (n,3) m, rad, of each scan
    belief: Belief  # the last pose and all landmarks; covariances are those of the filter
    grid: SemanticGrid
    steps: int  # of Gauss-Newton
    odometry_scale: float  # by which the variances of the odometry were multiplied


@dataclass(slots=True, eq=False, init=False)
class Trace:
    """A record of a run of a pipeline; call `add` after each of its steps, and `final` at the end.

    It keeps per scan the pose, the motion by odometry with the covariance that the filter predicts with, the
    registration with recent scans, and the corners that were associated with features.
    """

    pipeline: SlamPipeline
    probe: Filter
    before: Belief  # of the laser, before the first scan
    localised: bool  # before the first scan
    T_map_laser: list[Array] = field(default_factory=list)  # (3,) of each scan
    odometry: list[tuple[int, int, Array, Array]] = field(default_factory=list)
    registrations: list[tuple[int, int, Array, Array]] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    marked: dict[int, int] = field(default_factory=dict)  # mark of a past pose -> scan
    painted: dict[int, int] = field(default_factory=dict)  # step of the grid -> scan

    def __init__(self, pipeline: SlamPipeline) -> None:
        self.pipeline, self.before = pipeline, pipeline.filter.belief()
        self.localised = pipeline.guard.localised
        self.probe = make_filter(pipeline.config.filter.model_copy(update={"kind": "ekf"}))
        self.T_map_laser, self.odometry, self.registrations, self.seen = [], [], [], []
        self.marked, self.painted = {}, {pipeline.grid.step: NO_ID}

    def add(self, odometry: Odometry | None, output: SlamOutput) -> None:
        """Record a step of the pipeline, which made the `output` of a scan and of the odometry before it, if any."""
        scan, recent = len(self.T_map_laser), self.pipeline.recent
        self.T_map_laser.append(output.T_map_laser)
        if odometry is not None and scan:
            self.odometry.append((scan - 1, scan, *self._motion(odometry)))
        motion = recent.registered
        if motion is not None and motion.mark in self.marked:
            self.registrations.append((self.marked[motion.mark], scan, motion.T_past_now, motion.cov))
        if recent.scans:
            self.marked.setdefault(int(recent.scans[-1].marks[0]), scan)
        self.painted.setdefault(self.pipeline.grid.step, scan)
        known = np.flatnonzero(output.match.ids > NO_ID)
        if len(known):
            self.seen.append((scan, output.match.ids[known], *output.corners.measurements(known)))

    def _motion(self, odometry: Odometry) -> tuple[Array, Array]:
        """The motion of the laser (3,), and its covariance (3,3) as the filter predicts it."""
        config = self.pipeline.config.filter
        self.probe.set_pose(np.zeros(3), np.diag([config.prior_sigma_m] * 2 + [config.prior_sigma_rad]) ** 2)
        predict_mounted(self.probe, odometry, self.pipeline.config.sensor)
        T, cov = self.probe.marginal(np.empty(0, np.int64))
        return T, cov

    def final(self) -> FinalMap:
        """Path and map of the run, smoothed. The pipeline stays as it is.

        Raises `SmoothingError` before the first scan, and where the optimum is not reached.
        """
        if not self.T_map_laser:
            raise SmoothingError("no scan was added")
        ids, graph = self.graph()
        found = smooth(graph, self.pipeline.config.association.gate_probability)
        belief = self.pipeline.filter.belief()
        known = np.isin(belief.ids, ids)
        p_map = belief.p_map.copy()
        p_map[known] = found.p_map[np.searchsorted(ids, belief.ids[known])]
        path = composed(found.T_map_laser, inverse(self.pipeline.config.sensor.T_robot_laser))
        belief = replace(belief, T_map_robot=path[-1], p_map=p_map)
        grid = self._grid(belief, found.T_map_laser)
        return FinalMap(path, belief, grid, found.steps, found.odometry_scale)

    def graph(self) -> tuple[Ints, PoseGraph]:
        """The ids (l,) of the landmarks, ascending, and the pose graph of the run so far, from the online estimate on.

        A feature that was merged is the one that it became. Those that were dropped later, or that never became
        landmarks, are landmarks of their own if two scans saw them.
        """
        seen = [(scan, self._resolved(of_scan), z, R) for scan, of_scan, z, R in self.seen]
        belief = self.pipeline.filter.belief()
        every, count = np.unique(np.concatenate([NO_IDS, *(ids for _, ids, *_ in seen)]), return_counts=True)
        ids = every[(count > 1) | np.isin(every, belief.ids)]
        sightings = Sightings.of([part for part in (rows_of(one, ids) for one in seen) if len(part[1])])
        T_map_laser = np.array(self.T_map_laser)
        p_map = mean_places(sightings, T_map_laser, len(ids))
        held = np.isin(ids, belief.ids)
        p_map[held] = belief.p_map[belief.rows(ids[held])]
        links = Links.of(self.odometry), Links.of(self.registrations)
        return ids, PoseGraph(T_map_laser, p_map, self._priors(ids), *links, sightings)

    def _resolved(self, ids: Ints) -> Ints:
        """(c,) the features that the features became by merges."""
        merged = self.pipeline.map.merged
        if merged.keys().isdisjoint(ids.tolist()):
            return ids
        return self._resolved(np.array([merged.get(one, one) for one in ids.tolist()], np.int64))

    def _priors(self, ids: Ints) -> Priors:
        """What the belief before the first scan says of the first pose and of the landmarks `ids` (l,)."""
        before, old = self.before, self._resolved(self.before.ids)
        first = np.isin(old, ids) & (old == before.ids)
        rows = np.searchsorted(ids, old[first])
        places = rows, before.p_map[first], inverses(before.covs[first])
        if not self.localised:  # the first pose is searched for: what holds it is the map
            return Priors(self.T_map_laser[0], np.eye(3), *places)
        return Priors(before.T_map_robot, inverses(before.pose_cov), *places)

    def _grid(self, belief: Belief, T_map_laser: Array) -> SemanticGrid:
        """The grid with the key scans at the final poses, and polygons and doors at the final landmarks."""
        painter, moved = self.pipeline.grid, self.pipeline.grid.scans.T_map_robot.copy()
        scans = np.array([self.painted.get(step, NO_ID) for step in painter.scans.step.tolist()], np.int64)
        moved[scans > NO_ID] = T_map_laser[scans[scans > NO_ID]]
        return painter.redrawn(belief, moved, self.pipeline.rooms.graph())


def rows_of(seen: Seen, ids: Ints) -> Seen:
    """Of the corners of a scan those of the landmarks `ids` (l,), with rows in place of ids."""
    scan, of_scan, z, R = seen
    kept = np.flatnonzero(np.isin(of_scan, ids))
    both = (2 * kept[:, None] + [0, 1]).ravel()
    return scan, np.searchsorted(ids, of_scan[kept]), z[kept], R[np.ix_(both, both)]


def mean_places(sightings: Sightings, T_map_laser: Array, count: int) -> Array:
    """(count,2) m: the mean of where the scans saw each landmark."""
    T, (r, bearing) = T_map_laser[sightings.pose], sightings.z.T
    turn, seen = T[:, 2] + bearing, np.bincount(sightings.landmark, minlength=count)
    places = T[:, 0] + r * np.cos(turn), T[:, 1] + r * np.sin(turn)
    sums = [np.bincount(sightings.landmark, place, count) for place in places]
    return np.stack(sums, axis=1) / np.maximum(seen, 1)[:, None]
