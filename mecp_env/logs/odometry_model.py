"""How the odometry of a robot errs: what is corrected before the estimator gets it, and the noise that is left.

The motion between two poses as odometry readings: arcs, and their noise per metre of path.
"""

from __future__ import annotations

import math
from typing import Any, Protocol, Self

import numpy as np
from pydantic import Field

from mecp_env.core.carriers import Array
from mecp_env.core.errors import SensorError
from mecp_env.core.se2 import between, chained, wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.core.settings import Settings

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

    Path and turn are those of all arcs together, and equal parts of noise and variance of each: a slip to the side
    between two scans is no extra path.
    """
    measured, count = increments, len(increments)
    if rng is not None:
        measured = increments + rng.standard_normal(2) * noise.sigmas(*abs(increments.sum(axis=0)).tolist()) / count
    variances = noise.sigmas(*abs(measured.sum(axis=0)).tolist()) ** 2 / count + np.array([FLOOR_M, FLOOR_RAD]) ** 2
    return Odometry(measured, np.tile(np.diag(variances), (count, 1, 1)), bumper=False)


QUARTER_TURN = math.pi / 2.0
PAPER_TURNING = math.sqrt(0.5 / QUARTER_TURN)  # a quarter turn counts as .5 m of path


class OdometryModel(Settings):
    """Scale and bias of the odometry, and its noise per metre of path and per radian of turn.

    The turn of a corrected motion is `turn_scale` times the measured one, plus `turn_bias_deg_per_m` times the signed
    distance. The variance of a distance is `distance_sigma_m`^2 per metre plus `distance_sigma_turning_m`^2 per rad,
    that of a turn `turn_sigma_deg`^2 per metre plus `turn_sigma_turning_deg`^2 per rad; by default those of the paper.
    """

    distance_scale: float = Field(1.0, ge=0.1, le=10.0)  # true distance per measured distance
    turn_scale: float = Field(1.0, ge=0.1, le=10.0)  # true turn per measured turn
    turn_bias_deg_per_m: float = Field(0.0, ge=-90.0, le=90.0)  # true turn per metre ahead where none is measured
    distance_sigma_m: float = Field(0.1, ge=0.0, le=10.0)  # of a distance, per square root of a metre and of a rad
    distance_sigma_turning_m: float = Field(0.1 * PAPER_TURNING, ge=0.0, le=10.0)
    turn_sigma_deg: float = Field(1.5, ge=0.0, le=180.0)  # of a turn, per square root of a metre and of a rad
    turn_sigma_turning_deg: float = Field(1.5 * PAPER_TURNING, ge=0.0, le=180.0)

    @classmethod
    def of_noise(cls, noise: Any, **corrections: float) -> Self:
        """The model with the noise of an `OdometryConfig` in its reading `per_metre`."""
        distance, turn = noise.scale * noise.distance_sigma_m, noise.scale * noise.turn_sigma_deg
        turning = math.sqrt(noise.turn_m / QUARTER_TURN)
        return cls(
            distance_sigma_m=distance,
            distance_sigma_turning_m=distance * turning,
            turn_sigma_deg=turn,
            turn_sigma_turning_deg=turn * turning,
            **corrections,
        )

    @property
    def correction(self) -> Array:
        """(3,) scale of distance, scale of turn, bias in rad per metre."""
        return np.array([self.distance_scale, self.turn_scale, math.radians(self.turn_bias_deg_per_m)])

    def sigmas(self, distance_m: float, turn_rad: float) -> Array:
        """(2,) m, rad: standard deviations of a motion of this path and turn, both at least 0."""
        per_root = np.array([self.distance_sigma_m, math.radians(self.turn_sigma_deg)])
        turning = np.array([self.distance_sigma_turning_m, math.radians(self.turn_sigma_turning_deg)])
        return np.sqrt(per_root**2 * distance_m + turning**2 * turn_rad)

    def corrected(self, motion: Array) -> Array:
        """(n,3) or (3,) m, rad: relative poses of the robot without scale and bias, of measured ones."""
        x, y, turn = np.moveaxis(motion, -1, 0)
        distance_scale, turn_scale, bias = self.correction
        true_turn = turn_scale * turn + bias * np.copysign(np.hypot(x, y), x)
        chord = distance_scale * (x + 1j * y) * np.exp(0.5j * (true_turn - turn))  # turns by half, as on an arc
        return np.stack((chord.real, chord.imag, wrapped(true_turn)), axis=-1)

    def between(self, T_odom_before: Any, T_odom_after: Any) -> Odometry:
        """The corrected motion, with its covariance, between two poses (3,) m, rad that the odometry gives.

        Raises `SensorError` for poses that are not finite or of another shape.
        """
        before, after = np.asarray(T_odom_before, np.float64), np.asarray(T_odom_after, np.float64)
        if before.shape != (3,) or after.shape != (3,) or not np.isfinite([before, after]).all():
            raise SensorError("T_odom_before, T_odom_after: finite, of shape (3,), expected")
        return reading(arcs(self.corrected(between(before, after))), self)


def measured(motion: Array, correction: Array) -> Array:
    """(n,3) or (3,) m, rad: what the odometry measures of true motions, without noise; `corrected` is the inverse."""
    x, y, turn = np.moveaxis(motion, -1, 0)
    distance_scale, turn_scale, bias = correction
    chord = (x + 1j * y) / distance_scale
    read = (turn - bias * np.copysign(abs(chord), x)) / turn_scale
    chord *= np.exp(0.5j * (read - turn))
    return np.stack((chord.real, chord.imag, wrapped(read)), axis=-1)
