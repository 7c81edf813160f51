"""Scale and bias of odometry and the mounting of the laser, by robust least squares over registered motions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mecp_env.core.array_types import Array, Ints
from mecp_env.evaluation.calibration.motions import Motions
from mecp_env.evaluation.calibration.noise import noise_of, variances
from mecp_env.evaluation.calibration.residuals import residuals

SPREAD = np.array([0.1, 0.1, 0.1, 0.3, 0.1])  # how far a robot is off, as in `NAMES`: a weak prior
SIGNIFICANT = 0.0  # sigmas; what is smaller is left as it is
ROUNDS = 4  # in which fit and noise follow each other


class Systematic(NamedTuple):
    """What was found, in the order of `NAMES`."""

    values: Array  # (5,) that are applied: those that are not significant are as before
    sigmas: Array  # (5,) of each value, applied or not; inf for one that nothing tells


def fitted(motions: Motions, T_robot_laser: Array, start: Array, free: Ints) -> Systematic:
    """The values that explain the motions, for a laser at T_robot_laser (3,) as described.

    Those that are not `free` (k,) stay as they are in `start` (5,), and so do those that are not significant.
    """
    values, sigmas = _fit(motions, T_robot_laser, start, free)
    significant = free[abs(values - start)[free] > SIGNIFICANT * sigmas[free]]
    return Systematic(_fit(motions, T_robot_laser, start, significant)[0], sigmas)


def _fit(motions: Motions, T_robot_laser: Array, start: Array, free: Ints) -> tuple[Array, Array]:
    """(5,) values and (5,) their sigmas, by least squares with a soft L1 loss; those that are not `free` stay."""
    values, sigmas = start.copy(), np.full(len(start), np.inf)
    for _ in range(ROUNDS * bool(len(free))):
        left = residuals(motions, values, T_robot_laser)
        scale = np.sqrt(variances(left, noise_of(left)))

        def whitened(chosen: Array, scale: Array = scale) -> Array:
            tried = values.copy()
            tried[free] = chosen
            off = residuals(motions, tried, T_robot_laser).off / scale
            return np.concatenate((off.ravel(), (chosen - start[free]) / SPREAD[free]))

        found = least_squares(whitened, values[free], x_scale=SPREAD[free], loss="soft_l1")
        values[free] = found.x
        sigmas[free] = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return values, sigmas
