"""Recorded drives: the sensor data of a breadth-first episode, to compare estimators on the same data."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.errors import map_nees
from benchmarks.errors import nees as nees_of
from benchmarks.in_tree import random_commands
from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose, inverse, polar_to_points, wrap_angle
from mecp_env.env import MecpEnv
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.evaluation.metric_arrays import LostWatch
from mecp_env.evaluation.metrics import AssociationLog, EpisodeMetrics
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.slam import Odometry, Scan, SlamConfig, SlamOutput, SlamPipeline
from mecp_env.slam.association import OracleAssociator, make_associator
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter
from mecp_env.world.schema import Layout
from mecp_env.world.simulation import Motion
from mecp_env.wrappers import GoalActions

FAR_SHARE = 0.93  # of the laser's range; walls end there that go on


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
        rows = slice(first, first + count)
        parts = {name: getattr(self, name)[rows] for name in ("odometry", "scans", "T_world_robot")}
        return replace(self, **parts)


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """The result of an estimator on a drive."""

    log: AssociationLog
    error_m: Array  # (n,) position error after each scan
    nees: Array  # (n,) pose NEES, 3 expected
    position_nees: Array  # (n,) of the position alone, 2 expected
    counts: dict[str, Any]  # of the whole drive


@dataclass(slots=True, eq=False)
class WatchedAssociator(Associator):
    """An associator, how long it takes, and what part of its decisions polygons made."""

    watched: Associator
    seconds: list[float] = field(default_factory=list)  # of each scan
    scans: list[tuple[int, int, bool, int]] = field(default_factory=list)  # corners, paired by a polygon, ...
    first: list[tuple[int, float]] = field(default_factory=list)  # vertices and m2 of the first polygon, where any is

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """The match of the associator."""
        begun = time.perf_counter()
        match = self.watched.associate(corners, polygons, view, belief)
        self.seconds.append(time.perf_counter() - begun)
        paired = int((match.reason == Reason.POLYGON).sum())
        self.scans.append((len(corners), paired, match.polygon >= 0, len(polygons)))
        if polygons:
            ring = polar_to_points(corners.z[polygons[0].corners])
            following = np.roll(ring, -1, axis=0)
            twice_m2 = (ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]).sum()
            self.first.append((len(ring), 0.5 * float(twice_m2)))
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
        seen, paired, recognised, polygons = np.array(self.scans).T
        vertices, area_m2 = [float(np.mean(of)) for of in zip(*self.first, strict=True)] or (0.0, 0.0)
        return {
            "associate_ms": 1e3 * float(np.median(self.seconds)),
            "seen": int(seen.sum()),
            "paired": int(paired.sum()),
            "recognised": int(recognised.sum()),
            "scans": len(self.scans),
            "found": len(self.first),
            "unique": int((polygons == 1).sum()),
            "vertices": vertices,
            "area_m2": area_m2,
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


def exploration(env: GoalActions, seed: int) -> Iterator[tuple[dict[str, Any], bool]]:
    """Explore breadth first from a start given by the seed: the info after each goal, and whether it terminated."""
    policy, over = BreadthFirst(), False
    observation, _ = env.reset(seed=seed)
    while not over:
        observation, _, terminated, truncated, info = env.step(policy.act(observation, env.action_masks()))
        over = terminated or truncated
        yield info, terminated


def drive_at_random(env: MecpEnv, steps: int, seed: int = 0) -> None:
    """Random velocities, each held for ten steps; a new episode every 1,000 steps."""
    commands = random_commands(seed)
    for step in range(steps):
        if step % 1000 == 0:
            env.reset(seed=seed + step)
        _, _, terminated, truncated, _ = env.step(next(commands))
        if terminated or truncated:
            env.reset(seed=seed + step)


def record_drive(layout: str | Layout, seed: int, **keywords: Any) -> Drive:
    """A breadth-first exploration of `layout` with the estimated map, from a start given by the seed."""
    inner = RecordingEnv(layout=layout, start="random", **keywords)
    env = GoalActions(inner)
    for _ in exploration(env, seed):
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
    log = AssociationLog(len(drive.truth.outline.corners))
    T_map_world = inverse(drive.T_world_robot[0])
    errors, covs, seen = [], [], []
    for output, T_world_robot in drive.outputs(pipeline, associator.watched):
        true = drive.truth.identify(output.corners, T_world_robot)
        log.record(output, true)
        seen.append((*far_corners(output, true), bool(output.polygons)))
        error = compose(T_map_world, T_world_robot) - output.belief.T_map_robot
        error[2] = wrap_angle(error[2])
        errors.append(error)
        covs.append(output.belief.pose_cov)
        if output.diverged:
            break
    x, y, heading = np.array(errors).T
    error_m, (far, phantoms, with_polygon) = np.hypot(x, y), np.array(seen).T
    nees, position_nees = (nees_of(np.array(errors)[:, :size], np.array(covs)[:, :size, :size]) for size in (3, 2))
    lost = LostWatch()
    for step in zip(error_m.tolist(), heading.tolist(), strict=True):
        lost.look(*step)
    counts = {
        "rmse_m": float(np.sqrt((error_m**2).mean())),
        "nees": float(nees.mean()),
        "lost": lost.is_lost(output.diverged),
        "far": int(far.sum()),  # corners beyond 93 % of the laser's range
        "phantoms": int(phantoms.sum()),  # those of them that do not exist
        "polygon_share": float(with_polygon.mean()),  # of the scans, with a polygon
        **map_counts(drive, log, pipeline.filter, output),
        **associator.counts,
    }
    return Replay(log, error_m, nees, position_nees, counts)


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


def far_corners(output: SlamOutput, true: Ints) -> tuple[int, int]:
    """How many corners of a scan are beyond 93 % of the laser's range, and how many of them are none in truth."""
    beyond = output.corners.z[:, 0] > FAR_SHARE * output.beams.max_range_m
    return int(beyond.sum()), int((beyond & (true < 0)).sum())
