"""Recorded drives: the sensor data of a breadth-first episode, to compare estimators on the same data."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.errors import nees as nees_of
from benchmarks.map_consistency import map_nees
from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose, inverse, wrap_angle
from mecp_env.core.sensors import Odometry, Scan
from mecp_env.env import MecpEnv
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.evaluation.metric_arrays import is_lost
from mecp_env.evaluation.metrics import AssociationLog, EpisodeMetrics
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.slam.association import OracleAssociator, make_associator
from mecp_env.slam.config import AssociationConfig, SlamConfig
from mecp_env.slam.messages import Corners, MapView, Match, Polygon
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.pipeline import SlamPipeline
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

    def outputs(self, pipeline: SlamPipeline) -> Iterator[tuple[SlamOutput, Array]]:
        """The output of an estimator at each scan, and the true pose (3,) there."""
        for odometry, scan, T_world_robot in zip(self.odometry, self.scans, self.T_world_robot, strict=True):
            yield pipeline.start(scan) if odometry is None else pipeline.step(odometry, scan), T_world_robot


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """The result of an estimator on a drive."""

    log: AssociationLog
    error_m: Array  # (n,) position error after each scan
    error_rad: Array  # (n,) heading error
    nees: Array  # (n,) pose NEES, 3 expected
    position_nees: Array  # (n,) of the position alone, 2 expected
    duplicates: int
    map_rmse_m: float  # of the landmarks from their true corners
    landmarks_false: int  # that are of no true corner
    landmark_nees: float  # 2 expected
    pair_nees: float  # of the offset of two landmarks seen together, 2 expected
    diverged: bool
    associate_ms: float  # median per scan
    far: int  # corners beyond 93 % of the laser's range
    phantoms: int  # those of them that do not exist
    polygon_share: float  # of the scans, with a polygon

    @property
    def counts(self) -> dict[str, Any]:
        """The figures of the whole drive."""
        tp, fp, fn, _ = (int(n) for n in self.log.final_counts())
        plain = ("map_rmse_m", "landmarks_false", "duplicates", "far", "phantoms", "associate_ms", "polygon_share")
        return {
            "tp": tp,
            "fp": fp,
            "fn": fn,
            "rmse_m": float(np.sqrt((self.error_m**2).mean())),
            "nees": float(self.nees.mean()),
            "lost": is_lost(self.error_m, self.error_rad, self.diverged),
            **{name: getattr(self, name) for name in (*plain, "landmark_nees", "pair_nees")},
        }


@dataclass(slots=True, eq=False)
class TimedAssociator(Associator):
    """An associator, and how long it takes."""

    timed: Associator
    seconds: list[float] = field(default_factory=list)  # of each scan

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """The match of the associator."""
        begun = time.perf_counter()
        match = self.timed.associate(corners, polygons, view, belief)
        self.seconds.append(time.perf_counter() - begun)
        return match

    def remember(self, match: Match) -> None:
        """As the associator does."""
        self.timed.remember(match)

    @property
    def median_ms(self) -> float:
        """Milliseconds per scan."""
        return 1e3 * float(np.median(self.seconds))


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
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if step % 1000 == 0:
            env.reset(seed=seed + step)
        if step % 10 == 0:
            action = rng.uniform([0.3, -0.4], [1.0, 0.4])
        _, _, terminated, truncated, _ = env.step(action)
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
    associator = TimedAssociator(make(slam.association))
    pipeline = estimator(slam, associator=associator)
    log = AssociationLog(len(drive.truth.outline.corners))
    T_map_world = inverse(drive.T_world_robot[0])
    errors, covs, polygons, far = [], [], [], np.zeros(2, np.int64)
    for odometry, scan, T_world_robot in zip(drive.odometry, drive.scans, drive.T_world_robot, strict=True):
        if isinstance(associator.timed, OracleAssociator):
            associator.timed.correspondences = drive.truth.correspondences(T_world_robot)
        output = pipeline.start(scan) if odometry is None else pipeline.step(odometry, scan)
        true = drive.truth.identify(output.corners, T_world_robot)
        log.record(output, true)
        far += far_corners(output, true)
        polygons.append(bool(output.polygons))
        error = compose(T_map_world, T_world_robot) - output.belief.T_map_robot
        error[2] = wrap_angle(error[2])
        errors.append(error)
        covs.append(output.belief.pose_cov)
        if output.diverged:
            break
    nees, position_nees = (nees_of(np.array(errors)[:, :size], np.array(covs)[:, :size, :size]) for size in (3, 2))
    x, y, heading = np.array(errors).T
    duplicates = log.duplicates(output.belief.ids)
    metrics = EpisodeMetrics(drive.T_world_robot[0], T_map_world, np.empty((0, 0), np.bool_), log)
    of_map = metrics.map_error(drive.truth, output.belief) + map_nees(drive.truth, log, pipeline.filter, T_map_world)
    scores = log, np.hypot(x, y), heading, nees, position_nees, duplicates, *of_map, output.diverged
    return Replay(*scores, associator.median_ms, *far.tolist(), float(np.mean(polygons)))


def far_corners(output: SlamOutput, true: Ints) -> tuple[int, int]:
    """How many corners of a scan are beyond 93 % of the laser's range, and how many of them are none in truth."""
    beyond = output.corners.z[:, 0] > FAR_SHARE * output.beams.max_range_m
    return int(beyond.sum()), int((beyond & (true < 0)).sum())
