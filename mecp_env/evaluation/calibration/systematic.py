"""Scale and bias of odometry and the mounting of the laser, by robust least squares over registered motions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mecp_env.core.array_types import Array, Ints
from mecp_env.evaluation.calibration.motions import Motions
from mecp_env.evaluation.calibration.noise import noise_of, variances
from mecp_env.evaluation.calibration.residuals import courses, expected, residuals

SPREAD = np.array([0.1, 0.1, 0.1, 0.3, 0.1])  # how far a robot is off, as in `NAMES`: a weak prior
ROUNDS = 4  # in which fit and noise follow each other


class Systematic(NamedTuple):
    """What was found, in the order of `NAMES`."""

    values: Array  # (5,)
    sigmas: Array  # (5,), inf for a value that is fixed


def fitted(motions: Motions, T_robot_laser: Array, start: Array, free: Ints) -> Systematic:
    """The values that explain the motions, for a laser at T_robot_laser (3,) as described.

    By least squares with a soft L1 loss; values that are not `free` (k,) stay as they are in `start` (5,).
    """
    values, sigmas = start.copy(), np.full(len(start), np.inf)
    course = 0.5 * motions.laser[:, 2]  # of arcs, wherever the laser is
    for _ in range(ROUNDS * bool(len(free))):
        left = residuals(motions, values, T_robot_laser, course)
        scale = np.sqrt(variances(left, noise_of(left)))

        def whitened(chosen: Array, scale: Array = scale, course: Array = course) -> Array:
            tried = values.copy()
            tried[free] = chosen
            off = residuals(motions, tried, T_robot_laser, course).off / scale
            return np.concatenate((off.ravel(), (chosen - start[free]) / SPREAD[free]))

        found = least_squares(whitened, values[free], x_scale=SPREAD[free], loss="soft_l1")
        values[free] = found.x
        course = courses(expected(motions, values, T_robot_laser))
        jacobian = np.asarray(found.jac)
        sigmas[free] = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    return Systematic(values, sigmas)
