"""The noise that is left of odometry, per metre and per radian: robust variances, and what the filter has to cover."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri

from mecp_env.core.array_types import Array, Bools
from mecp_env.evaluation.calibration.residuals import Residuals

ROUNDS = 12  # of reweighting
FARTHEST = 9.0  # of the variance, to which a square is cut;
CUT_GAUSS = 0.9733  # the mean of a Gaussian's squares is this part then
FLOOR = np.array([1e-3, 1e-3, 1e-4]) ** 2  # m^2, m^2, rad^2: of a motion, so that weights are finite
COVERED = 0.98  # of the motions lie within the bound within which as many Gaussian ones do
FACTORS = (1.0, 1e4)  # by which a variance grows for that
TOLD_M, TOLD_RAD = 0.1, np.radians(2.0)  # sigmas of a registration that tells a distance, and a turn
SIDE, SIDE_TURN = 0.3125, 0.5  # of a unit variance of the turn, over two arcs of half the distance each: the variance
# to the side per d^2, and its covariance with the turn per d


def noise_of(left: Residuals) -> Array:
    """(3,2) variances along a motion, to its side and in heading, per metre and per rad of turn."""
    return np.array([_per_metre_and_rad(left, component) for component in range(3)])


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


def told(left: Residuals) -> Bools:
    """(n,) the motions whose distance and turn the surfaces tell: not along a corridor, nor beside a single wall."""
    along, side, turn = np.diagonal(left.cov, 0, 1, 2).T
    return (np.maximum(along, side) < TOLD_M**2) & (turn < TOLD_RAD**2)


def covering(left: Residuals, noise: Array) -> Array:
    """(2,2) variances of distance and turn per metre and per rad that cover the motions: arcs have no noise to the side.

    Heavy tails and what moves the robot to its side widen them: the estimator rejects corners beyond its gate.
    """
    along = left.off[:, 0] ** 2
    v_along = left.metres * noise[0, 0] + left.turn * noise[0, 1]
    distance = _factor(lambda k: along / (k * v_along + left.cov[:, 0, 0] + FLOOR[0]), 1)
    turn = _factor(lambda k: _nis(left, distance * v_along, k * (left.metres * noise[2, 0] + left.turn * noise[2, 1])), 3)
    return np.array([distance * noise[0], turn * noise[2]])


def _nis(left: Residuals, v_along: Array, v_turn: Array) -> Array:
    """(n,) squares of the residuals in terms of the covariance of two arcs with these variances (n,)."""
    cov = left.cov + np.diag(FLOOR)
    cov[:, 0, 0] += v_along
    cov[:, 1, 1] += SIDE * v_turn * left.metres**2
    cov[:, 2, 2] += v_turn
    for i, j in ((1, 2), (2, 1)):
        cov[:, i, j] += SIDE_TURN * v_turn * left.metres
    nis: Array = np.einsum("ni,ni->n", left.off, np.linalg.solve(cov, left.off[:, :, None])[:, :, 0])
    return nis


def _factor(nis_at: Callable[[float], Array], freedom: int) -> float:
    """The least factor of a variance with which `COVERED` of the motions lie within a Gaussian's bound."""
    bound, (low, high) = float(chdtri(freedom, 1.0 - COVERED)), np.log(FACTORS)
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.quantile(nis_at(float(np.exp(middle))), COVERED) > bound else (low, middle)
    return float(np.exp(high))
