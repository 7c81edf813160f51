"""Motions of the laser between scans, by registration, and what a corrected odometry leaves of them.

Scans by the stages of the estimator: surfaces for a registration, and the range noise about straight walls.

The laser moves by X^-1 m X where the robot, on which it sits at X, moves by m: the hand-eye equation in the plane.

Scale and bias of odometry and the mounting of the laser, by robust least squares over registered motions.

The noise that is left of odometry, per metre and per radian: robust variances, and what the filter has to cover.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import between, composed, wrapped
from mecp_env.core.sensors import Scan
from mecp_env.logs.odometry_model import measured
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend import front_end
from mecp_env.slam.messages import MergedScan, Segments
from mecp_env.slam.panorama.registration import RegistrationLimits, Surfaces, register_all, surfaces_of

SCANS = 60  # that tell the range noise, spread over a log
WIDE_M = 0.05  # range noise that straight walls are looked for with: with less than there is, they fall to pieces
LINE_BEAMS, LEAST_COSINE = 10, 0.7  # of a wall that tells the range noise: beams, and cosine of their incidence
TRIM = 2  # beams at each end of a line that may be on something else
STRAIGHT_SHARE = 0.9  # of the lines; the others may be no walls
LEAST_M, LEAST_RAD = 1.0, math.radians(30.0)  # of the motion between two scans that are registered, typically
AT_REST, STILL = 0.1, 1e-4  # of both: a motion of the laser, and a step of the odometry, up to which there is none
MOST_M, MOST_RAD = 3.0, math.radians(75.0)  # beyond, too little of a scan is seen again
BLOCK, BLOCKS = 8, 32  # successive motions that are registered together, and how many such blocks
PRIOR_M, PRIOR_RAD, GROWTH = 0.05, math.radians(3.0), 0.15  # sigmas of a prior at rest, and how they grow with a motion
NAMES = ("distance_scale", "turn_scale", "turn_bias_deg_per_m", "x_m", "heading_deg")  # of values, which are in rad
SHORT_M = 0.05  # a shorter motion has no direction
NOTHING = np.array([1.0, 1.0, 0.0, 0.0, 0.0])  # of an odometry without errors, on a robot as it is described
SPREAD = np.array([0.1, 0.1, 0.1, 0.3, 0.1])  # how far a robot is off, as in `NAMES`: a weak prior
ROUNDS = 4  # in which fit and noise follow each other
NOISE_ROUNDS = 12  # of reweighting
FARTHEST = 9.0  # of the variance, to which a square is cut;
CUT_GAUSS = 0.9733  # the mean of a Gaussian's squares is this part then
FLOOR = np.array([1e-3, 1e-3, 1e-4]) ** 2  # m^2, m^2, rad^2: of a motion, so that weights are finite
COVERED = 0.98  # of the motions
TOLD_M, TOLD_RAD = 0.05, math.radians(1.0)  # sigmas of a registration that tells a distance, and a turn
SIDE = 0.3125  # the variance to the side, per d^2, of a unit variance of the turn over two arcs of half the distance d
ALONG, LEFT, TURN = range(3)  # the components of a residual


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A scan as the registration takes it."""

    surfaces: Surfaces
    beams: MergedScan
    segments: Segments


def view(scan: Scan, config: SlamConfig) -> View:
    """The surfaces of a scan, by the stages of the estimator."""
    seen = front_end(scan, config)
    return View(surfaces_of(seen.beams, seen.segments, seen.wall, config.sensor), seen.beams, seen.segments)


def range_noise(scan_at: Callable[[int], Scan], scans: int, config: SlamConfig) -> float:
    """m: the standard deviation of single beams about straight walls; nan where no wall is long enough.

    `scan_at` gives the scan of each of so many rows; `config` has the laser as far as it is known.
    """
    wide = config.model_copy(update={"sensor": config.sensor.model_copy(update={"range_sigma_m": WIDE_M})})
    rows = np.unique(np.linspace(0, scans - 1, min(SCANS, scans)).astype(np.int64)).tolist()
    variances = np.sort([variance for row in rows for variance in _variances(view(scan_at(row), wide))])
    kept = variances[: math.ceil(STRAIGHT_SHARE * len(variances))]
    return math.sqrt(float(kept.mean())) if len(kept) else math.nan


def _variances(seen: View) -> list[float]:
    """m^2: the variance of the ranges about each long line, as of a single beam."""
    beams, segments = seen.beams, seen.segments
    found, size = list[float](), len(beams.ranges)
    for (alpha, rho), first, last in zip(segments.line, segments.first, segments.last, strict=True):
        on = (segments.roll + np.arange(first + TRIM, last + 1 - TRIM)) % size
        cosine = np.cos(beams.bearings[on] - alpha)
        kept = beams.hit[on] & (cosine > LEAST_COSINE)
        on, cosine = on[kept], cosine[kept]
        if len(on) >= LINE_BEAMS:
            off = (beams.ranges[on] - rho / cosine) * np.sqrt(beams.count[on])
            design = np.column_stack((np.ones(len(on)), beams.bearings[on] - beams.bearings[on[0]]))
            off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
            found.append(float(off @ off) / (len(on) - 2))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Motions of the robot by odometry and of the laser by registration, between scans that follow each other."""

    measured: Array  # (n,3) m, rad: of the robot
    laser: Array  # (n,3) m, rad: of the laser, in its frame
    cov: Array  # (n,3,3) of `laser`, by the noise of single beams
    alike: float  # by which it grows where neighbouring beams err together
    tried: int  # pairs of scans that were compared
    stride: int  # scans from one end of a motion to the other

    def __len__(self) -> int:
        return len(self.measured)


def registered_motions(scan_at: Callable[[int], Scan], T_odom_robot: Array, config: SlamConfig) -> Motions:
    """The motions of blocks of scans that are spread over a log, with odometry poses (n,3).

    `scan_at` gives the scan of a row; `config` has the laser as far as it is known.
    """
    limits = RegistrationLimits.of(config)
    found, tried = list[tuple[Array, Array, Array]](), 0
    moving, stride = _moving_rows(T_odom_robot)
    for rows in _blocks(moving[::stride]):
        views = [view(scan_at(int(row)), config) for row in rows]
        steps = between(T_odom_robot[rows[:-1]], T_odom_robot[rows[1:]])
        tried += len(steps)
        found += _registered(views, steps, config.sensor.T_robot_laser, limits)
    measured, laser, cov = (np.array([one[k] for one in found]) for k in range(3))
    shapes = measured.reshape(-1, 3), laser.reshape(-1, 3), cov.reshape(-1, 3, 3)
    return Motions(*shapes, float(limits.alike_beams), tried, stride)


def _registered(
    views: list[View], steps: Array, T_robot_laser: Array, limits: RegistrationLimits
) -> list[tuple[Array, Array, Array]]:
    """Of each step (m,3) between views that can be registered: the step, the motion of the laser, its covariance."""
    single = replace(limits, alike_beams=1)  # what neighbouring beams have in common is no noise of the odometry
    T_laser, found = between(T_robot_laser, composed(steps, T_robot_laser)), list[tuple[Array, Array, Array]]()
    for step, expected, past, now in zip(steps, T_laser, views[:-1], views[1:], strict=True):
        prior = expected, _prior(step)
        is_short = math.hypot(*step[:2]) < MOST_M and abs(float(step[2])) < MOST_RAD
        one = register_all(past.surfaces, now.surfaces, past.beams, prior, limits) if is_short else None
        if one is not None and one.is_sound(prior, limits) and _size(one.T_past_now[None])[0] > AT_REST:
            found.append((step, one.T_past_now, one.cov(single)))
    return found


def _moving_rows(T_odom_robot: Array) -> tuple[Ints, int]:
    """Rows of scans without those at rest, and how many of them apart a motion is long enough.

    That is the same everywhere: by the odometry between two scans, its noise would select the motions.
    """
    size = _size(between(T_odom_robot[:-1], T_odom_robot[1:]))
    rows = np.concatenate(([0], 1 + np.flatnonzero(size > STILL)))
    ascending = np.sort(size[rows[1:] - 1])
    typical = ascending[np.searchsorted(np.cumsum(ascending), 0.5 * ascending.sum())] if len(ascending) else 1.0
    return rows, math.ceil(0.9 / float(typical))


def _size(motions: Array) -> Array:
    """(n,) of motions (n,3), 1 for one that is worth registering."""
    return np.hypot(motions[:, 0], motions[:, 1]) / LEAST_M + abs(motions[:, 2]) / LEAST_RAD


def _blocks(rows: Ints) -> list[Ints]:
    """Some blocks of rows (m,), spread evenly; in each the last of one motion is the first of the next."""
    firsts = np.arange(0, len(rows) - 1, BLOCK)
    spread = np.linspace(0, len(firsts) - 1, min(BLOCKS, len(firsts))).astype(np.int64)
    return [rows[first : first + BLOCK + 1] for first in firsts[spread]]


def _prior(step: Array) -> Array:
    """(3,3) covariance of a motion (3,) by odometry of which nothing is known."""
    metres, turn = math.hypot(*step[:2]), abs(float(step[2]))
    spread_m, spread_rad = PRIOR_M + GROWTH * metres, PRIOR_RAD + GROWTH * (math.sqrt(metres) + turn)
    return np.diag([spread_m, spread_m, spread_rad]) ** 2


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
    lever = composed(motions.laser, back) - motions.laser  # in the past frame
    x, y, _ = composed(np.array([0.0, 0.0, X[2]]), lever).T
    to_robot = _turned(np.full(len(off), X[2]))
    to_robot[:, 0, 2], to_robot[:, 1, 2] = -y, x  # m per rad: a laser that turns moves the robot
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
