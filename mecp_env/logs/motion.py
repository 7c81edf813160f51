"""The motion between two poses as odometry readings: arcs, and their noise per metre of path."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.messages import Odometry
from mecp_env.core.trajectories import chained

FLOOR_M = FLOOR_RAD = 1e-6  # least sigmas of a reading, so that its covariance is positive


class NoiseModel(Protocol):
    """Noise that grows with the path: `OdometryModel`, and `OdometryConfig` in its reading `per_metre`."""

    def sigmas(self, distance_m: float, turn_rad: float) -> Array:
        """(2,) m, rad: standard deviations of distance and turn of a motion of this path and turn."""


def arcs(motion: Array) -> Array:
    """(2,2) m, rad: two arcs of equal length that end at a relative pose (3,), backwards where that is nearer.

    The mean heading of both is the direction of the chord, so an arc that is one (no sideways slip) becomes two halves.
    """
    x, y, turn = motion.tolist()
    sign = -1.0 if x < 0.0 else 1.0
    towards = math.atan2(sign * y, sign * x)
    first = 2.0 * towards - 0.5 * turn
    half = 0.5 * sign * math.hypot(x, y) / math.cos(0.25 * turn)
    return np.array([[half, first], [half, turn - first]])


def end_of(increments: Array) -> Array:
    """The relative pose (3,) at the end of arcs (M,2)."""
    distance, turn = increments.T
    steps = np.stack((distance * np.cos(0.5 * turn), distance * np.sin(0.5 * turn), turn), axis=1)
    end: Array = chained(steps)[-1]
    return end


def reading(increments: Array, noise: NoiseModel, rng: np.random.Generator | None = None) -> Odometry:
    """Increments (M,2) with the covariance of their path, and with noise from `rng` where there is one.

    Path and turn are those of all arcs together: a slip to the side between two scans is no extra path.
    """
    measured = increments if rng is None else increments + _noise(increments, noise, rng)
    return Odometry(measured, _covariances(measured, noise), bumper=False)


def _noise(increments: Array, noise: NoiseModel, rng: np.random.Generator) -> Array:
    """(M,2) m, rad: equal parts of one draw."""
    return rng.standard_normal(2) * _sigmas(increments, noise) / len(increments)


def _sigmas(increments: Array, noise: NoiseModel) -> Array:
    """(2,) m, rad: standard deviations of the sum of increments (M,2)."""
    return noise.sigmas(*abs(increments.sum(axis=0)).tolist())


def _covariances(increments: Array, noise: NoiseModel) -> Array:
    """(M,2,2) of each increment, equal parts of that of the sum."""
    variances = _sigmas(increments, noise) ** 2 / len(increments) + np.array([FLOOR_M, FLOOR_RAD]) ** 2
    return np.tile(np.diag(variances), (len(increments), 1, 1))
