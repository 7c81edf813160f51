"""The noise that is left of odometry, per metre and per radian: robust variances, and what the filter has to cover."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri

from mecp_env.core.array_types import Array, Bools
from mecp_env.evaluation.calibration.residuals import Residuals

ROUNDS = 12  # of reweighting
FARTHEST = 9.0  # of the variance, to which a square is cut;
CUT_GAUSS = 0.9733  # the mean of a Gaussian's squares is this part then
FLOOR = np.array([1e-3, 1e-3, 1e-4]) ** 2  # m^2, m^2, rad^2: of a motion, so that weights are finite
COVERED = 0.98  # of the motions
TOLD_M, TOLD_RAD = 0.05, math.radians(1.0)  # sigmas of a registration that tells a distance, and a turn
SIDE = 0.3125  # the variance to the side, per d^2, of a unit variance of the turn over two arcs of half the distance d
ALONG, LEFT, TURN = range(3)  # the components of a residual


def noise_of(left: Residuals) -> Array:
    """(3,2) variances along a motion, to its side and in heading, per metre and per rad of turn."""
    return np.array([_per_metre_and_rad(left, component) for component in (ALONG, LEFT, TURN)])


def variances(left: Residuals, noise: Array) -> Array:
    """(n,3) of each residual: of the motion and of its registration."""
    of_motion = np.column_stack((left.metres, left.turn)) @ noise.T
    total: Array = of_motion + np.diagonal(left.cov, 0, 1, 2) + FLOOR
    return total


def _per_metre_and_rad(left: Residuals, component: int) -> Array:
    """(2,) not negative, by least squares of the squares, each weighted by its variance and cut far out."""
    square, known = left.off[:, component] ** 2, left.cov[:, component, component] + FLOOR[component]
    design = np.column_stack((left.metres, left.turn))
    found = np.full(2, np.median(square) / max(float(np.median(design.sum(axis=1))), 1e-9))
    for _ in range(ROUNDS):
        variance = design @ found + known
        cut = np.minimum(square, FARTHEST * variance) / CUT_GAUSS
        found = nnls(design / variance[:, None], (cut - known) / variance)[0]
    return found


def told(left: Residuals) -> tuple[Bools, Bools]:
    """(n,), (n,) the motions whose distance and whose turn the surfaces tell: a corridor tells no distance."""
    along, side, turn = np.sqrt(np.diagonal(left.cov, 0, 1, 2)).T
    turns = (turn < TOLD_RAD) & (side < TOLD_M)
    return turns & (along < TOLD_M), turns


def with_tails(left: Residuals, noise: Array) -> Array:
    """(3,2) variances that grow until `COVERED` of the motions are within the bound that holds as many of a Gaussian.

    The robust ones ignore what is far out; the estimator, which assumes Gaussian noise, rejects scans there.
    """
    of_motion = np.column_stack((left.metres, left.turn)) @ noise.T
    known = np.diagonal(left.cov, 0, 1, 2) + FLOOR
    needed = (left.off**2 / chdtri(1, 1.0 - COVERED) - known) / np.maximum(of_motion, FLOOR)
    grown: Array = noise * np.maximum(1.0, np.quantile(needed, COVERED, axis=0))[:, None]
    return grown


def slip_as_turn(left: Residuals, noise: Array) -> float:
    """rad^2 per metre: the variance of the turn that covers what moves a robot to its side beyond the `noise` (3,2).

    Odometry is a chain of arcs, whose noise has no component to the side: that of the turn has to cover it, of as many
    motions as in `with_tails`. In a chain of scans, a turn may come before all of the path.
    """
    driven = left.metres >= float(np.median(left.metres))
    metres, square = left.metres[driven], left.off[driven, LEFT] ** 2
    of_motion = np.column_stack((metres, left.turn[driven])) @ noise.T
    of_turn = (1.0 if left.is_chain else SIDE) * (metres**2 + of_motion[:, ALONG]) * of_motion[:, TURN]
    known = of_turn + left.alike * left.cov[driven, LEFT, LEFT] + FLOOR[LEFT]
    needed = (square / chdtri(1, 1.0 - COVERED) - known) / (SIDE * metres**3)
    return max(0.0, float(np.quantile(needed, COVERED)))
