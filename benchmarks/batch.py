"""The batch optimum of a whole record with known correspondences, by GTSAM (extra `lab`): what filters are measured by.

Given motions and measurements of a robot, it is the most likely path and map, with the covariances of the landmarks
there. No filter can know more: it sees the whole record, and linearises everything at the result.

Source: Dellaert and Kaess, "Factor graphs for robot perception", Foundations and Trends in Robotics 6, 2017.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import from_lab
from benchmarks.known_pairs import Record, Sighting, polar
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import to_robot, wrapped

MOST_STEPS, MOST_HALVED = 100, 20
SETTLED = 1e-12  # change of the cost


class Optimum(NamedTuple):
    """The most likely path and map."""

    T_map_robot: Array  # (n,3)
    ids: Ints  # (m,) ascending
    p_map: Array  # (m,2)
    covs: Array  # (m,2,2)
    chi2: float  # twice the cost there
    freedom: int  # its degrees of freedom


def optimum(record: Record, path: Array, ids: Ints, p_map: Array) -> Optimum:
    """The batch optimum near a path (n,3) and landmarks p_map (m,2) with ids (m,), such as a filter's.

    Raises `OptionError` where GTSAM is missing.
    """
    gtsam = from_lab("gtsam", "the batch optimum needs GTSAM")
    graph, values, noise = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Gaussian.Covariance
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*record.start), noise(record.start_cov)))
    for number, motion in enumerate(record.motions):
        graph.add(gtsam.BetweenFactorPose2(number, number + 1, gtsam.Pose2(*motion.T), noise(motion.cov)))
    for number, sighting in enumerate(record.sightings):
        if len(sighting.ids):
            graph.add(sighted(gtsam, number, len(path), sighting))
    for number, T in enumerate(path):
        values.insert(number, gtsam.Pose2(*T))
    for landmark, point in zip(ids.tolist(), p_map, strict=True):
        values.insert(len(path) + landmark, gtsam.Point2(*point))
    best, order = minimised(graph, values), np.sort(ids)
    marginals, keys = gtsam.Marginals(graph, best), (len(path) + order).tolist()
    measured = sum(2 * len(sighting.ids) for sighting in record.sightings)
    return Optimum(
        np.array([[T.x(), T.y(), T.theta()] for T in map(best.atPose2, range(len(path)))]),
        order,
        np.array([best.atPoint2(key) for key in keys]),
        np.array([marginals.marginalCovariance(key) for key in keys]),
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
        tried = (values.retract(step.scale(0.5**halved)) for halved in range(MOST_HALVED))
        better = next(((moved, new) for moved in tried if (new := graph.error(moved)) < cost), None)
        if better is None:
            return values
        values, before, cost = better[0], cost, better[1]
        if before - cost < SETTLED * before:
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
    y = to_robot(T, points)
    e, r = polar(y) - z, np.hypot(*y.T)[:, None]
    e[:, 1] = wrapped(e[:, 1])
    by_place = np.stack([y / r, np.stack([-y[:, 1], y[:, 0]], axis=1) / (r * r)], axis=1)
    by_turn = np.broadcast_to([[0.0], [-1.0]], (len(z), 2, 1))
    return e.ravel(), np.concatenate([-by_place, by_turn], axis=2), by_place @ np.array([[c, s], [-s, c]])
