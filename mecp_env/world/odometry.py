"""The odometry: the true motion of a step -> the measured motion with its covariance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.sensors import Odometry
from mecp_env.world.config import READINGS, OdometryConfig
from mecp_env.world.simulation import Motion

FLOOR_M = 1e-6  # sigmas of an increment at rest, so that its covariance is positive
FLOOR_RAD = 1e-6
QUARTER_TURN = math.pi / 2.0
PER_METRE, PER_STEP = READINGS.index("per_metre"), READINGS.index("per_step")


def measure(motion: Motion, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """The measured increments (M,2) with their covariances (M,2,2), noise from `rng`; bumper = contact.

    The noise grows with the true motion; the covariance is computed from the reading alone.
    """
    noise = rng.standard_normal(motion.increments.shape)
    measured, cov = _measure(motion.increments, noise, config.record)
    odometry = Odometry(measured, cov, motion.contact)
    return slip(odometry, config, rng) if config.slip_share > 0.0 else odometry


def slip(odometry: Odometry, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """What wheels measure that slip with a probability: they turn farther than the robot moves, and it turns aside."""
    drawn, farther, aside = (
        rng.random(),
        rng.uniform(1.0, config.slip_most),
        rng.normal(0.0, math.radians(config.slip_turn_deg)),
    )
    if drawn >= config.slip_share or not odometry.increments.any():  # a robot at rest does not slip
        return odometry
    increments = odometry.increments * [farther, 1.0]
    increments[:, 1] += aside / len(increments)
    return replace(odometry, increments=increments)


@compiled
def _measure(increments: Array, noise: Array, config: Rows) -> tuple[Array, Array]:
    """The increments (M,2) with noise, given in sigmas (M,2), and their covariances (M,2,2)."""
    measured, variance = np.empty_like(increments), _variances(increments, config)
    for m in range(increments.shape[0]):  # no noise at rest
        measured[m, 0] = increments[m, 0] + math.sqrt(variance[m, 0]) * noise[m, 0]
        measured[m, 1] = increments[m, 1] + math.sqrt(variance[m, 1]) * noise[m, 1]
    arcs = increments.shape[0]
    even, cov = np.zeros((arcs, 2)), np.zeros((arcs, 2, 2))
    for k in range(2):  # the noise of the whole step, in equal parts
        total = 0.0
        for m in range(arcs):
            total += abs(measured[m, k])
        for m in range(arcs):
            even[m, k] = total / arcs
    variance = _variances(even, config)
    for m in range(arcs):
        cov[m, 0, 0] = variance[m, 0] + FLOOR_M * FLOOR_M
        cov[m, 1, 1] = variance[m, 1] + FLOOR_RAD * FLOOR_RAD
    return measured, cov


@compiled
def _variances(increments: Array, config: Rows) -> Array:
    """Variances (M,2) of distance (m^2) and turn (rad^2) of each increment (M,2)."""
    limits, arcs = config[0], increments.shape[0]
    distance, turn = limits.scale * limits.distance_sigma_m, limits.scale * limits.turn_sigma_rad
    variance = np.empty((arcs, 2))
    path, turned = 0.0, 0.0
    for m in range(arcs):
        path += abs(increments[m, 0])
        turned += abs(increments[m, 1])
    for m in range(arcs):
        if limits.rule == PER_METRE:
            metres = abs(increments[m, 0]) + limits.turn_m / QUARTER_TURN * abs(increments[m, 1])
            variance[m, 0], variance[m, 1] = metres * distance * distance, metres * turn * turn
        elif limits.rule == PER_STEP:
            moves = 1.0 if path + turned > 0.0 else 0.0
            variance[m, 0], variance[m, 1] = moves * distance * distance / arcs, moves * turn * turn / arcs
        else:
            variance[m, 0] = (distance * path) ** 2 / arcs
            variance[m, 1] = (turn * (path + turned / QUARTER_TURN)) ** 2 / arcs
    return variance
