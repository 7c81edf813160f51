"""Recorded drives: the sensor data of a breadth-first episode, to compare estimators on the same data.

And the errors of poses and points, and how well covariances and confidence predict them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import mannwhitneyu

from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import compose, inverse, polar_to_points, to_map, wrap_angle
from mecp_env.env import MecpEnv
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.evaluation.metric_arrays import LostWatch
from mecp_env.evaluation.metrics import AssociationLog, EpisodeMetrics
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.render.shapes import signed_area
from mecp_env.slam import Odometry, Scan, SlamConfig, SlamOutput, SlamPipeline
from mecp_env.slam.association import OracleAssociator, make_associator
from mecp_env.slam.config import AssociationConfig, chi2_of_point
from mecp_env.slam.messages import Corners, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter
from mecp_env.world.schema import Layout
from mecp_env.world.simulation import Motion
from mecp_env.wrappers import GoalActions, Step

FAR_SHARE = 0.93  # of the laser's range; walls end there that go on
ELLIPSE = chi2_of_point(0.9)
WRONG_M = 0.5  # a position error that is no longer small
BINS = 10  # of confidence


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The sensor data of one episode; the first scans are taken at rest, before any odometry."""

    truth: GroundTruth
    slam: SlamConfig  # the estimator during the drive
    odometry: list[Odometry | None]
    scans: list[Scan]
    T_world_robot: list[Array]  # true poses

    def outputs(
        self, pipeline: SlamPipeline, associator: Associator | None = None
    ) -> Iterator[tuple[SlamOutput, Array]]:
        """The output of an estimator at each scan, and the true pose (3,) there; `known` gets the true pairs."""
        for odometry, scan, T_world_robot in zip(self.odometry, self.scans, self.T_world_robot, strict=True):
            if isinstance(associator, OracleAssociator):
                associator.correspondences = self.truth.correspondences(T_world_robot)
            yield pipeline.start(scan) if odometry is None else pipeline.step(odometry, scan), T_world_robot

    def part(self, first: int, count: int) -> Drive:
        """So many scans of the drive, from one on."""
        parts = {name: getattr(self, name)[first : first + count] for name in ("odometry", "scans", "T_world_robot")}
        return replace(self, **parts)


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """The result of an estimator on a drive."""

    log: AssociationLog
    error_m: Array  # (n,) position error after each scan
    nees: Array  # (n,) pose NEES, 3 expected
    counts: dict[str, Any]  # of the whole drive


@dataclass(slots=True, eq=False)
class WatchedAssociator(Associator):
    """An associator, how long it takes, and what part of its decisions polygons made."""

    watched: Associator
    rows: list[tuple[float, ...]] = field(default_factory=list)  # of each scan, the columns of `counts`

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """The match of the associator."""
        begun = time.perf_counter()
        match = self.watched.associate(corners, polygons, view, belief)
        seconds, paired = time.perf_counter() - begun, int((match.reason == Reason.POLYGON).sum())
        ring = polar_to_points(corners.z[polygons[0].corners if polygons else []])
        first = len(polygons), len(ring), signed_area(ring)
        self.rows.append((seconds, len(corners), paired, match.polygon >= 0, *first))
        return match

    def remember(self, match: Match) -> None:
        """As the associator does."""
        self.watched.remember(match)

    @property
    def stands_for(self) -> Associator:
        """The associator, which may be a custom one."""
        return self.watched

    @property
    def counts(self) -> dict[str, Any]:
        """Milliseconds per scan, the median; and sums and means over the drive."""
        seconds, seen, paired, recognised, polygons, vertices, area_m2 = np.array(self.rows).T
        found = max(int((polygons > 0).sum()), 1)  # scans with a polygon
        return {
            "associate_ms": 1e3 * float(np.median(seconds)),
            "seen": int(seen.sum()),
            "paired": int(paired.sum()),
            "recognised": int(recognised.sum()),
            "scans": len(self.rows),
            "found": int((polygons > 0).sum()),
            "unique": int((polygons == 1).sum()),
            "vertices": float(vertices.sum() / found),  # of the first polygon
            "area_m2": float(area_m2.sum() / found),
        }


class RecordingEnv(MecpEnv):
    """The environment, recording its sensor data."""

    def __init__(self, config: EnvConfig | dict[str, Any] | None = None, **keywords: Any) -> None:
        super().__init__(config, **keywords)
        self.drive = Drive(self._true_world.truth, self._slam, [], [], [])

    def _look(self, T_world_robot: Array) -> Scan:
        scan = super()._look(T_world_robot)
        self.drive.odometry.append(None)
        self.drive.scans.append(scan)
        self.drive.T_world_robot.append(T_world_robot)
        return scan

    def _sense(self, motion: Motion, T_world_robot: Array) -> tuple[Odometry, Scan]:
        odometry, scan = super()._sense(motion, T_world_robot)  # calls `_look`
        self.drive.odometry[-1] = odometry
        return odometry, scan


def exploration(env: GoalActions, seed: int | None) -> Iterator[Step]:
    """Explore breadth first from a start given by the seed, or go on (None): what the step of each goal returned."""
    policy, over = BreadthFirst(), False
    observation = env.base.observation() if seed is None else env.reset(seed=seed)[0]
    while not over:
        step = env.step(policy.act(observation, env.action_masks()))
        observation, over = step[0], step[2] or step[3]
        yield step


def record_drive(layout: str | Layout, seed: int, **keywords: Any) -> Drive:
    """A breadth-first exploration of `layout` with the estimated map, from a start given by the seed."""
    inner = RecordingEnv(layout=layout, start="random", **keywords)
    for _ in exploration(GoalActions(inner), seed):
        pass
    return inner.drive


def replay(
    drive: Drive,
    slam: SlamConfig,
    make: Callable[[AssociationConfig], Associator] = make_associator,
    estimator: Callable[..., SlamPipeline] = SlamPipeline,
) -> Replay:
    """Run an estimator on a drive; its decisions feed back into its filter (closed loop)."""
    associator = WatchedAssociator(make(slam.association))
    pipeline = estimator(slam, associator=associator)
    log, lost = AssociationLog(len(drive.truth.outline.corners)), LostWatch()
    T_map_world = inverse(drive.T_world_robot[0])
    errors, covs, seen = [], [], []
    for output, T_world_robot in drive.outputs(pipeline, associator.watched):
        true = drive.truth.identify(output.corners, T_world_robot)
        log.record(output, true)
        far = output.corners.z[:, 0] > FAR_SHARE * output.beams.max_range_m
        seen.append((far.sum(), (far & (true < 0)).sum(), bool(output.polygons)))
        error = compose(T_map_world, T_world_robot) - output.belief.T_map_robot
        error[2] = wrap_angle(error[2])
        lost.look(float(np.hypot(*error[:2])), error[2])
        errors.append(error)
        covs.append(output.belief.pose_cov)
        if output.diverged:
            break
    e, P = np.array(errors), np.array(covs)
    error_m, pose_nees, (far_corners, phantoms, with_polygon) = np.hypot(*e[:, :2].T), nees(e, P), np.array(seen).T
    counts = {
        "rmse_m": float(np.sqrt((error_m**2).mean())),
        "nees": float(pose_nees.mean()),
        "in_ellipse": float((nees(e[:, :2], P[:, :2, :2]) <= ELLIPSE).mean()),  # of 90 %, share of the scans
        "lost": lost.is_lost(output.diverged),
        "far": int(far_corners.sum()),  # corners beyond 93 % of the laser's range
        "phantoms": int(phantoms.sum()),  # those of them that do not exist
        "polygon_share": float(with_polygon.mean()),  # of the scans, with a polygon
        **map_counts(drive, log, pipeline.filter, output),
        **associator.counts,
    }
    return Replay(log, error_m, pose_nees, counts)


def map_counts(drive: Drive, log: AssociationLog, belief: Filter, output: SlamOutput) -> dict[str, Any]:
    """Right, wrong and missed pairs of a drive, and errors of the map at its end."""
    start = drive.T_world_robot[0]
    T_map_world = inverse(start)
    metrics = EpisodeMetrics(start, T_map_world, np.empty((0, 0), np.bool_), log)
    map_rmse_m, landmarks_false = metrics.map_error(drive.truth, output.belief)
    landmark_nees, pair_nees = map_nees(drive.truth, log, belief, T_map_world)
    tp, fp, fn, _ = (int(n) for n in log.final_counts())
    return {
        "tp": tp,
        "fp": fp,
        "fn": fn,
        "map_rmse_m": map_rmse_m,  # of the landmarks from their true corners
        "landmarks_false": landmarks_false,  # that are of no true corner
        "duplicates": log.duplicates(output.belief.ids),
        "landmark_nees": landmark_nees,  # 2 expected
        "pair_nees": pair_nees,  # of the offset of two landmarks seen together, 2 expected
    }


def nees(errors: Array, covs: Array) -> Array:
    """(n,) e^T P^-1 e of errors (n,m) with covariances (n,m,m)."""
    return np.asarray((errors * np.linalg.solve(covs, errors[:, :, None])[:, :, 0]).sum(axis=1))


def mean_nees(errors: Array, covs: Array) -> float:
    """Its mean; nan without any."""
    return float(nees(errors, covs).mean()) if len(errors) else float("nan")


def rms(errors: Array) -> float:
    """Root mean square of the lengths of errors (n,2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def sigma_ratio(covs: Array, best_covs: Array) -> float:
    """Median ratio of the sigma of a landmark to the best there is, from covariances (n,2,2) of both."""
    sigmas, best = (np.sqrt(np.trace(some, axis1=1, axis2=2)) for some in (covs, best_covs))
    return float(np.median(sigmas / best))


def off(T_map_robot: Array, truth: Array) -> tuple[float, float]:
    """Distance and turn between two poses (3,)."""
    x, y, heading = T_map_robot - truth
    return math.hypot(x, y), abs(wrap_angle(heading))


def roc_area(confidence: Array, error_m: Array) -> float:
    """Probability that a scan with a small error has more confidence than one with a large error; ties count half."""
    right, wrong = (confidence[mask] for mask in (error_m < WRONG_M, error_m >= WRONG_M))
    pairs = len(right) * len(wrong)
    return float(mannwhitneyu(right, wrong).statistic / pairs) if pairs else math.nan


def calibration_error(confidence: Array, error_m: Array) -> float:
    """Mean difference of mean confidence and share of small errors in ten bins, weighted by their scans."""
    bins = np.minimum((confidence * BINS).astype(np.int64), BINS - 1)
    gap = np.bincount(bins, confidence - (error_m < WRONG_M), BINS)
    return float(np.abs(gap).sum() / len(confidence))


def map_nees(truth: GroundTruth, log: AssociationLog, belief: Filter, T_map_world: Array) -> tuple[float, float]:
    """Mean NEES of the landmarks, and of the offset of two that were matched in one scan (2 expected of both).

    Those of no true corner are left out; nan where none is left.
    """
    still, corner = len(truth.outline.corners), log.corners_of(belief.ids)
    slots = np.flatnonzero((corner >= 0) & (corner < still))
    mean, cov = belief.marginal(belief.ids[slots])
    p_map = to_map(T_map_world, np.ascontiguousarray(truth.outline.corners.p_world[corner[slots]]))
    errors, m = mean[3:].reshape(-1, 2) - p_map, len(slots)
    blocks = cov[3:, 3:].reshape(m, 2, m, 2).transpose(0, 2, 1, 3)  # (m,m,2,2)
    step, _, feature, matched = log.rows[: log.used].T
    seen = np.zeros((int(step.max(initial=0)) + 1, m))
    rows, columns = np.nonzero((feature[:, None] == belief.ids[slots]) & (matched > 0)[:, None])
    seen[step[rows], columns] = 1.0
    together = np.triu(seen.T @ seen, 1) > 0  # both were matched in one scan
    a, b = np.nonzero(together & (corner[slots][:, None] != corner[slots]))  # duplicates are one corner
    offsets = blocks[a, a] + blocks[b, b] - blocks[a, b] - blocks[b, a]
    return mean_nees(errors, blocks[np.arange(m), np.arange(m)]), mean_nees(errors[a] - errors[b], offsets)
