"""What a corrected odometry leaves of the registered motions, for a scale and bias, and a mounting of the laser.

The laser moves by X^-1 m X where the robot, on which it sits at X, moves by m: the hand-eye equation in the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mecp_env.core.array_types import Array, Bools
from mecp_env.core.trajectories import between, composed, wrapped
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
