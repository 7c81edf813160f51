"""Pose graphs of a simulated drive: a robot that goes round and round between landmarks."""

from dataclasses import dataclass

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import between, chained, wrapped
from mecp_env.slam.smoothing.optimum import Links, PoseGraph, Priors, Sightings

MOTION = np.array([0.02, 0.01, 0.01])  # m, m, rad: sigmas of a step
REGISTERED = np.array([0.01, 0.01, 0.004])
CORNER = np.array([0.01, 0.004])  # m, rad
REACH_M = 6.0


@dataclass(frozen=True)
class Drive:
    """The truth, and the graph of what was measured; its first poses are dead reckoning."""

    T_map_laser: Array
    p_map: Array
    graph: PoseGraph


def drive(seed: int, poses: int = 60, landmarks: int = 20) -> Drive:
    """Laps of 30 poses on a circle of 3 m."""
    rng = np.random.default_rng(seed)
    turn = 2.0 * np.pi / 30.0
    chord, half = 6.0 * np.sin(0.5 * turn), 0.5 * turn
    true = chained(np.tile([chord * np.cos(half), chord * np.sin(half), turn], (poses - 1, 1)))
    p_map = rng.uniform((-5.0, -2.0), (5.0, 8.0), (landmarks, 2))
    odometry = [link(true, k, k + 1, MOTION, rng) for k in range(poses - 1)]
    registrations = [link(true, k, k + 3, REGISTERED, rng) for k in range(0, poses - 3, 3)]
    seen = [part for k in range(poses) if len((part := sighting(true[k], k, p_map, rng))[1])]
    first = chained(np.array([T for _, _, T, _ in odometry]))
    none = np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))
    priors = Priors(true[0], 1e8 * np.eye(3), *none)
    places = p_map + rng.normal(0.0, 0.2, p_map.shape)
    factors = Links.of(odometry), Links.of(registrations), Sightings.of(seen)
    return Drive(true, p_map, PoseGraph(first, places, priors, *factors))


def link(T: Array, start: int, end: int, sigmas: Array, rng: np.random.Generator) -> tuple[int, int, Array, Array]:
    """A relative pose as it is measured."""
    return start, end, between(T[start], T[end]) + sigmas * rng.standard_normal(3), np.diag(sigmas**2)


def sighting(T: Array, pose: int, p_map: Array, rng: np.random.Generator) -> tuple[int, Ints, Array, Array]:
    """The landmarks in reach of a pose as they are measured; neighbours share half of their noise."""
    offset = p_map - T[:2]
    r = np.hypot(*offset.T)
    near = np.flatnonzero((r < REACH_M) & (r > 0.3))
    sigmas = np.tile(CORNER, len(near))
    R = sigmas[:, None] * (0.5 * np.eye(len(sigmas)) + 0.5) * sigmas
    noise = sigmas * np.sqrt(0.5) * (rng.standard_normal(len(sigmas)) + rng.standard_normal())
    z = np.stack([r, wrapped(np.arctan2(offset[:, 1], offset[:, 0]) - T[2])], axis=1)[near]
    return pose, near, z + noise.reshape(len(near), 2), R


def error_m(T: Array, true: Array) -> float:
    """RMSE of positions, m; both begin at one pose."""
    return float(np.sqrt(np.mean(np.sum((T - true)[:, :2] ** 2, axis=1))))
