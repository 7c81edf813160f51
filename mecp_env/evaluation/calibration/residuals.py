"""What a corrected odometry leaves of the registered motions, for a scale and bias, and a mounting of the laser.

The laser moves by X^-1 m X where the robot, on which it sits at X, moves by m: the hand-eye equation in the plane.

Scale and bias of odometry and the mounting of the laser, by robust least squares over registered motions.

The noise that is left of odometry, per metre and per radian: robust variances, and what the filter has to cover.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import between, composed, wrapped
from mecp_env.evaluation.calibration.motions import Motions
from mecp_env.logs.odometry_model import measured

NAMES = ("distance_scale", "turn_scale", "turn_bias_rad_per_m", "x_m", "heading_rad")
SHORT_M = 0.05  # a shorter motion has no direction
NOTHING = np.array([1.0, 1.0, 0.0, 0.0, 0.0])  # of an odometry without errors, on a robot as it is described


class Residuals(NamedTuple):
    """What is left of the measured motions, along the chord of each, to its left, and in heading."""

    off: Array  # (n,3) m, m, rad: measured less expected
    cov: Array  # (n,3,3) of the registration
    metres: Array  # (n,) of path
    turn: Array  # (n,) rad, not negative
    alike: float  # by which the covariance grows where neighbouring beams err together
    is_chain: bool  # a motion is that of several scans

    def of(self, rows: Bools) -> Residuals:
        """Those of some motions."""
        return Residuals(self.off[rows], self.cov[rows], self.metres[rows], self.turn[rows], self.alike, self.is_chain)


def residuals(motions: Motions, values: Array, T_robot_laser: Array, course: Array | None = None) -> Residuals:
    """Of all motions, for values (5,) as in `NAMES`, and the mounting pose (3,) that they are relative to.

    The odometry is expected from the registered motion, not the other way round: it is by far the noisier of both, and
    a scale by what is noisy comes out too small. `course` (n,) rad: the directions of the motions, by default those of
    these values; as a part of what is minimised, they would follow the noise.
    """
    X, robot = _of_robot(motions, values, T_robot_laser)
    back, read = between(X, np.zeros(3)), measured(robot, values[:3])
    off = motions.measured - read
    off[:, 2] = wrapped(off[:, 2])
    lever = composed(motions.laser, np.broadcast_to(back, off.shape)) - motions.laser
    to_robot = _turned(np.full(len(off), X[2]))
    to_robot[:, 0, 2], to_robot[:, 1, 2] = _turn_moves(lever, X[2])
    rows = np.swapaxes(_turned(courses(read) if course is None else course), 1, 2)
    A = rows @ to_robot
    cov = A @ motions.cov @ np.swapaxes(A, 1, 2)
    metres = np.hypot(*robot[:, :2].T)
    return Residuals(
        np.einsum("nij,nj->ni", rows, off), cov, metres, abs(robot[:, 2]), motions.alike, motions.stride > 1
    )


def expected(motions: Motions, values: Array, T_robot_laser: Array) -> Array:
    """(n,3) what the odometry measures of the registered motions, without noise; the rest as in `residuals`."""
    return measured(_of_robot(motions, values, T_robot_laser)[1], values[:3])


def _of_robot(motions: Motions, values: Array, T_robot_laser: Array) -> tuple[Array, Array]:
    """The mounting pose X (3,), and the motions (n,3) of a robot whose laser is mounted there."""
    X = T_robot_laser + np.array([values[3], 0.0, values[4]])
    return X, composed(composed(X, motions.laser), between(X, np.zeros(3)))


def courses(motion: Array) -> Array:
    """(n,) rad: the directions of motions (n,3), half of the turn for one that is hardly more than a turn."""
    x, y, turn = motion.T
    course: Array = np.where(np.hypot(x, y) > SHORT_M, np.arctan2(y, x), 0.5 * turn)
    return course


def _turned(angles: Array) -> Array:
    """(n,3,3) rotations of x and y by angles (n,)."""
    turned = np.zeros((len(angles), 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angles)
    turned[:, 1, 0] = np.sin(angles)
    turned[:, 0, 1] = -turned[:, 1, 0]
    turned[:, 2, 2] = 1.0
    return turned


def _turn_moves(lever: Array, heading: float) -> tuple[Array, Array]:
    """(n,), (n,) m per rad: by how much the robot moves for a laser that turns, at a lever (n,3) in the past frame."""
    c, s = np.cos(heading), np.sin(heading)
    x, y = c * lever[:, 0] - s * lever[:, 1], s * lever[:, 0] + c * lever[:, 1]
    return -y, x


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


NOISE_ROUNDS = 12  # of reweighting
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
    for _ in range(NOISE_ROUNDS):
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
