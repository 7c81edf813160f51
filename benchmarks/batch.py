"""The batch optimum of a whole record with known correspondences, by GTSAM (extra `lab`): what filters are measured by.

Given motions and measurements of a robot, it is the most likely path and map, with the covariances of the landmarks
there. No filter can know more: it sees the whole record, and linearises everything at the result.

Source: Dellaert and Kaess, "Factor graphs for robot perception", Foundations and Trends in Robotics 6, 2017.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.common import from_extra
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import Filter, SubmapEkf, make_filter
from mecp_env.slam.messages import Belief

MOST_STEPS, MOST_HALVED = 100, 20
SETTLED = 1e-12  # change of the cost
FLOOR = 1e-10  # m^2, rad^2, of a motion, so that its covariance is positive at rest


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What the robot measured at one pose."""

    z: Array  # (n,2) m, rad
    R: Array  # (2n,2n)
    ids: Ints  # (n,) true landmarks, each once

    def part(self, chosen: Bools) -> Sighting:
        """Some of the measurements; `chosen` (n,) says which."""
        rows = np.repeat(chosen, 2)
        return Sighting(self.z[chosen], self.R[np.ix_(rows, rows)], self.ids[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion to the next pose as it was measured."""

    odometry: Odometry  # for the filters
    T: Array  # (3,) the next pose in the frame of this one
    cov: Array  # (3,3) of x, y, heading, in the frame of the next pose (the twist of GTSAM)
    lacking: Array | None = None  # (3,3) the part of `cov` that is not in the odometry, and the filters know

    @classmethod
    def of_odometry(cls, odometry: Odometry, config: FilterConfig) -> Motion:
        """The motion and the noise that a filter predicts of it."""
        start = make_filter(config.model_copy(update={"kind": "ekf", "prior_sigma_m": 1e-9, "prior_sigma_rad": 1e-9}))
        start.predict(odometry)
        moved = start.belief()
        cov = turned(moved.pose_cov, -moved.T_map_robot[2]) + FLOOR * np.eye(3)
        return cls(odometry, moved.T_map_robot, cov)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A drive with known correspondences: what every filter and the batch optimum get."""

    start: Array  # (3,) the first pose
    start_cov: Array  # (3,3)
    motions: list[Motion]
    sightings: list[Sighting]  # at the first pose and after each motion


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """The most likely path and map."""

    T_map_robot: Array  # (n,3)
    ids: Ints  # (m,) ascending
    p_map: Array  # (m,2)
    covs: Array  # (m,2,2)
    chi2: float  # twice the cost there
    freedom: int  # its degrees of freedom


def turned(cov: Array, angle: float) -> Array:
    """(3,3) covariance of x, y, heading in axes that are turned by -angle."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rotated: Array = R @ cov @ R.T
    return rotated


Correct = Callable[[Filter, Sighting, Odometry | None], None]  # by known landmarks, after a motion or at the start


def filtered(record: Record, estimate: Filter, correct: Correct) -> Iterator[Belief]:
    """Run a filter on a record: predict, `correct`, take in new landmarks; what it believes after each pose."""
    estimate.set_pose(record.start, record.start_cov)
    for motion, sighting in zip([None, *record.motions], record.sightings, strict=True):
        if motion is not None:
            advance(estimate, motion)
        known = np.isin(sighting.ids, estimate.ids)
        if known.any():
            correct(estimate, sighting.part(known), motion.odometry if motion else None)
        new = sighting.part(~known)
        estimate.augment(new.z, new.R, new.ids)
        yield estimate.belief()


def advance(estimate: Filter, motion: Motion) -> None:
    """Predict, and add the noise that the odometry lacks."""
    estimate.predict(motion.odometry)
    if motion.lacking is not None:
        estimate.loosen(turned(motion.lacking, estimate.belief().T_map_robot[2]))


def in_order(estimate: Filter) -> tuple[Array, Array]:
    """Landmarks (m,2) and their covariances (m,2,2) by ascending id, after a last synchronisation of submaps."""
    if isinstance(estimate, SubmapEkf):
        estimate.synchronise()
    belief = estimate.belief()
    order = np.argsort(belief.ids)
    return belief.p_map[order], belief.covs[order]


def optimum(record: Record, path: Array, ids: Ints, p_map: Array) -> Optimum:
    """The batch optimum near a path (n,3) and landmarks p_map (m,2) with ids (m,), such as a filter's.

    Raises `OptionError` where GTSAM is missing.
    """
    gtsam = library()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = pose_of(gtsam, record.start)
    graph.add(gtsam.PriorFactorPose2(0, first, gtsam.noiseModel.Gaussian.Covariance(record.start_cov)))
    for number, motion in enumerate(record.motions):
        noise = gtsam.noiseModel.Gaussian.Covariance(motion.cov)
        graph.add(gtsam.BetweenFactorPose2(number, number + 1, pose_of(gtsam, motion.T), noise))
    for number, sighting in enumerate(record.sightings):
        if len(sighting.ids):
            graph.add(sighted(gtsam, number, len(path), sighting))
    for number, T in enumerate(path):
        values.insert(number, pose_of(gtsam, T))
    for landmark, point in zip(ids.tolist(), p_map, strict=True):
        values.insert(len(path) + landmark, gtsam.Point2(*point))
    best = minimised(graph, values)
    marginals, order = gtsam.Marginals(graph, best), np.sort(ids)
    measured = sum(2 * len(sighting.ids) for sighting in record.sightings)
    return Optimum(
        np.array([[T.x(), T.y(), T.theta()] for T in (best.atPose2(number) for number in range(len(path)))]),
        order,
        np.array([best.atPoint2(len(path) + landmark) for landmark in order.tolist()]),
        np.array([marginals.marginalCovariance(len(path) + landmark) for landmark in order.tolist()]),
        2.0 * graph.error(best),
        measured - 2 * len(order),  # each motion measures the pose that it adds
    )


def minimised(graph: Any, values: Any) -> Any:
    """The values of least cost: Gauss-Newton with steps halved until the cost falls.

    GTSAM's own optimizers take ten times as long with factors in Python.
    """
    cost = graph.error(values)
    for _ in range(MOST_STEPS):
        step = graph.linearize(values).optimize()
        for halved in range(MOST_HALVED):
            moved = values.retract(step.scale(0.5**halved))
            new = graph.error(moved)
            if new < cost:
                break
        else:
            return values
        settled, cost, values = cost - new < SETTLED * cost, new, moved
        if settled:
            return values
    raise ValueError(f"the batch optimum is not reached in {MOST_STEPS} steps")


def sighted(gtsam: Any, number: int, poses: int, sighting: Sighting) -> Any:
    """The factor of all measurements at one pose, with their joint covariance."""
    keys = [number, *(poses + sighting.ids).tolist()]

    def error(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        pose = values.atPose2(number)
        points = np.array([values.atPoint2(key) for key in keys[1:]])
        e, by_pose, by_point = measurement(np.array([pose.x(), pose.y(), pose.theta()]), points, sighting.z)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(by_pose.reshape(-1, 3))
            for k in range(len(points)):
                block = np.zeros((len(e), 2))
                block[2 * k : 2 * k + 2] = by_point[k]
                jacobians[1 + k] = np.asfortranarray(block)
        return e

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(sighting.R), keys, error)


def measurement(T: Array, points: Array, z: Array) -> tuple[Array, Array, Array]:
    """Predicted minus measured range and bearing (2m,), and the derivatives by the pose (m,2,3) and the points (m,2,2).

    The pose (3,) changes in its own frame, as GTSAM has it.
    """
    c, s = np.cos(T[2]), np.sin(T[2])
    turn = np.array([[c, s], [-s, c]])
    y = (points - T[:2]) @ turn.T
    r = np.hypot(*y.T)
    e = np.stack([r - z[:, 0], wrapped(np.arctan2(y[:, 1], y[:, 0]) - z[:, 1])], axis=1)
    by_place = np.stack([y / r[:, None], np.stack([-y[:, 1], y[:, 0]], axis=1) / (r * r)[:, None]], axis=1)
    by_turn = np.broadcast_to([[0.0], [-1.0]], (len(z), 2, 1))
    return e.ravel(), np.concatenate([-by_place, by_turn], axis=2), by_place @ turn


def pose_of(gtsam: Any, T: Array) -> Any:
    """A pose (3,) as GTSAM has it."""
    return gtsam.Pose2(*T.tolist())


def library() -> Any:
    """GTSAM. Raises `OptionError` where it is not installed."""
    return from_extra("gtsam", "the batch optimum needs GTSAM")
