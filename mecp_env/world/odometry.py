"""The odometry: the true motion of a period -> what the wheels say, with its covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.data import Odometry
from mecp_env.world.config import OdometryConfig
from mecp_env.world.simulation import Motion

Array = NDArray[np.float64]

FLOOR_M = 1e-6  # sigmas of an increment at rest, so that its covariance is positive
FLOOR_RAD = 1e-6
QUARTER_TURN = math.pi / 2.0


def measure(motion: Motion, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """The measured increments (M,2) with their covariances (M,2,2), noise from `rng`; bumper = contact.

    The noise grows with the true motion; the covariance that goes with the reading is made from the reading alone.
    """
    sigmas = np.sqrt(variances(motion.increments, config))  # none at rest
    measured = motion.increments + sigmas * rng.standard_normal(sigmas.shape)
    return Odometry(measured, _covariances(measured, config), motion.contact)


def _covariances(measured: Array, config: OdometryConfig) -> Array:
    """(M,2,2) what the increments (M,2) say of their own noise: that of the whole period, in equal parts."""
    even = np.tile(np.abs(measured).mean(axis=0), (len(measured), 1))
    cov = np.zeros((len(measured), 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = (variances(even, config) + np.array([FLOOR_M, FLOOR_RAD]) ** 2).T
    return cov


def variances(increments: Array, config: OdometryConfig) -> Array:
    """Variances (M,2) of distance (m^2) and turn (rad^2) of each increment (M,2) by the configured reading."""
    sigma = config.scale * np.array([config.distance_sigma_m, config.turn_sigma_rad])
    path, turn = np.abs(increments[:, 0]), np.abs(increments[:, 1])
    if config.reading == "per_metre":
        metres = path + config.turn_m * turn / QUARTER_TURN
        return np.outer(metres, sigma**2)
    arcs = len(increments)
    if config.reading == "per_step":
        moves = float(path.sum() + turn.sum() > 0.0)
        return np.tile(moves * sigma**2 / arcs, (arcs, 1))
    grown = np.array([path.sum(), path.sum() + turn.sum() / QUARTER_TURN])
    return np.tile((sigma * grown) ** 2 / arcs, (arcs, 1))
