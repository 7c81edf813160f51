"""Scale and bias of odometry and the mounting of the laser, by robust least squares over registered motions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from mecp_env.core.array_types import Array, Ints
from mecp_env.evaluation.calibration.motions import Motions
from mecp_env.evaluation.calibration.noise import noise_of, variances
from mecp_env.evaluation.calibration.residuals import NAMES, NOTHING, residuals

SPREAD = np.array([0.1, 0.1, 0.1, 0.3, 0.1])  # how far a robot may be off: a weak prior, and bounds of three times it
SIGNIFICANT = 3.0  # sigmas; what is smaller is left as it is
ROUNDS = 4  # in which fit and noise follow each other


class Systematic(NamedTuple):
    """What was found, in the order of `NAMES`."""

    values: Array  # (5,) applied: those that are not significant are `NOTHING`
    sigmas: Array  # (5,) of each value, applied or not; inf for one that nothing tells


def fitted(motions: Motions, T_robot_laser: Array, fixed: frozenset[str] = frozenset()) -> Systematic:
    """The values that explain the motions, for a laser at T_robot_laser (3,) as described; those `fixed` are kept."""
    free = np.array([i for i, name in enumerate(NAMES) if name not in fixed], np.int64)
    values, sigmas = _fit(motions, T_robot_laser, free)
    known = free[abs(values - NOTHING)[free] > SIGNIFICANT * sigmas[free]]
    return Systematic(_fit(motions, T_robot_laser, known)[0], sigmas)


def _fit(motions: Motions, T_robot_laser: Array, free: Ints) -> tuple[Array, Array]:
    """(5,) values and (5,) their sigmas, by Gauss-Newton with a soft L1 loss; those that are not `free` stay."""
    values, sigmas = NOTHING.copy(), np.full(len(NOTHING), np.inf)
    if not (len(free) and len(motions)):
        return values, sigmas
    for _ in range(ROUNDS):
        left = residuals(motions, values, T_robot_laser)
        scale = np.sqrt(variances(left, noise_of(left)))

        def whitened(chosen: Array, scale: Array = scale) -> Array:
            tried = values.copy()
            tried[free] = chosen
            off = residuals(motions, tried, T_robot_laser).off / scale
            return np.concatenate((off.ravel(), (chosen - NOTHING[free]) / SPREAD[free]))

        found = least_squares(whitened, values[free], x_scale=SPREAD[free], loss="soft_l1", method="trf")
        values[free] = found.x
        sigmas[free] = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return values, sigmas
