"""Is the laser mounted as the log says? Its scans and the odometry must agree about turns and headings."""

from __future__ import annotations

import cmath
import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import between, composed
from mecp_env.logs.log import Log
from mecp_env.logs.registration import registered_path

MOST_SCANS = 600  # that are registered
LEAST_TURN_RAD, MOST_TURN_RAD = math.radians(1.0), math.radians(40.0)  # of one step that counts as a turn
TURNS_RAD, TURNS = 2.0 * math.pi, 12  # of all turns together, and their number: then there is enough to compare
OPPOSITE = -0.8  # the correlation of turns from here down is that of a mirrored laser
LEAST_MOVE_M, STRAIGHT_RAD = 0.02, math.radians(5.0)  # of one step that counts as straight on
MOVES, AGREE = 8, 0.8  # steps straight on, whose directions must agree so well
LEAST_YAW_RAD = math.radians(15.0)
LEAST_FARTHER, MOST_FARTHER = 0.5, 2.0  # by the scans than by the odometry: beyond, units differ,
MOST_SCALE = 10.0  # which the option can mend so far
MOST_WIDER, VIEWS_DEG = 1.25, (90.0, 100.0, 120.0, 180.0, 190.0, 240.0, 270.0, 360.0)  # a laser sees by its turns
# than assumed, at most, and what lasers usually see
NEAR_VIEW = 0.1  # of it: a usual field of view is meant
STEADY_SHARE = 0.8  # of the steps are as much farther as most: no failures of registration


def laser_fault(log: Log, distance_scale: float = 1.0) -> str | None:
    """What is wrong with the laser, with the option that mends it; None where scans and odometry agree, or too few do.

    The check needs a few turns, or some metres straight on. Distances of the odometry count `distance_scale` times.
    """
    if log.T_odom_robot is None or not np.isfinite(log.T_odom_robot).all():
        return None
    rows = _moving(log.T_odom_robot)
    odometry = between(log.T_odom_robot[rows[:-1]], log.T_odom_robot[rows[1:]]) * (distance_scale, distance_scale, 1.0)
    path = composed(registered_path(log, rows.tolist()), log.T_robot_laser) if len(rows) > 1 else np.zeros((1, 3))
    scans = between(path[:-1], path[1:])  # of the laser, in its frame
    turning = (abs(odometry[:, 2]) > LEAST_TURN_RAD) & (abs(odometry[:, 2]) < MOST_TURN_RAD)
    turns = odometry[turning, 2], scans[turning, 2]
    mirrored = _are_opposite(*turns)
    wider = _wider(*turns) if log.view_assumed else 1.0
    if not 1.0 / MOST_WIDER < wider < MOST_WIDER:
        return _other_view(log.field_of_view_deg, wider)
    turn = _turn(odometry, scans, -log.T_robot_laser[2], mirrored)
    farther = abs(turn)
    if not LEAST_FARTHER < farther < MOST_FARTHER:
        mends = max(farther, 1.0 / farther) < MOST_SCALE
        option = f"--noise.distance-scale {farther:.3g} where the odometry is wrong, or " * mends
        return (
            f"the robot drives {farther:.3g} times as far by its scans as by its odometry, readings and poses in m "
            f"expected: try {option}--odometry none"
        )
    yaw = -cmath.phase(turn)
    turned, degrees = abs(yaw) > LEAST_YAW_RAD, 180 - (180 - round(math.degrees(yaw))) % 360
    options = ["--mirror"] * mirrored + [f"--laser-yaw-deg {degrees}"] * turned
    if not options:
        return None
    faults = ["mirrored (turns by scans and by odometry are opposite)"] * mirrored
    faults += [f"turned by {degrees} deg on the robot"] * turned
    return f"the laser seems to be {' and '.join(faults)}: try {' '.join(options)}"


def _wider(odometry: Array, scans: Array) -> float:
    """How many times as wide as assumed the field of view is, by turns (n,) rad by the odometry and by scans.

    Scans of one that sees twice as much turn by half. The larger a turn, the more it counts. 1 where too few agree.
    """
    if len(odometry) < TURNS // 2:
        return 1.0
    ratios, weights = scans / odometry, abs(odometry)
    order = np.argsort(ratios)
    middle = float(ratios[order][np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())])
    steady = abs(ratios - middle) < (MOST_WIDER - 1.0) * abs(middle)
    return 1.0 / middle if middle > 0.0 and weights[steady].sum() > 0.5 * weights.sum() else 1.0


def _other_view(view_deg: float, wider: float) -> str:
    """That the field of view is another than assumed, and which."""
    found = min(view_deg * wider, 360.0)
    usual = min(VIEWS_DEG, key=lambda view: abs(math.log(view / found)))
    found = usual if abs(usual - found) < NEAR_VIEW * found else found
    return (
        f"the robot turns {wider:.2g} times as far by its odometry as by its scans: the log does not say the field of "
        f"view, and {view_deg:.0f} deg are taken: try --field-of-view-deg {found:.0f}"
    )


def _moving(T_odom_robot: Array) -> Ints:
    """Rows of the scans between which the robot moves, up to a few turns."""
    rows, turned, turns = [0], 0.0, 0
    for row in range(1, len(T_odom_robot)):
        x, y, turn = between(T_odom_robot[rows[-1]], T_odom_robot[row]).tolist()
        if math.hypot(x, y) < LEAST_MOVE_M and abs(turn) < LEAST_TURN_RAD:
            continue
        rows.append(row)
        turned, turns = turned + abs(turn), turns + (abs(turn) > LEAST_TURN_RAD)
        if len(rows) == MOST_SCANS or (turned > TURNS_RAD and turns > TURNS and row > MOVES * TURNS):
            break
    return np.array(rows, np.int64)


def _are_opposite(odometry: Array, scans: Array) -> bool:
    """True where turns (n,) rad by the odometry and by scans have opposite signs."""
    if len(odometry) < TURNS // 2 or abs(odometry).sum() < 0.25 * TURNS_RAD:
        return False
    size = math.sqrt(float((odometry * odometry).sum() * (scans * scans).sum()))
    return size > 0.0 and float((odometry * scans).sum()) < OPPOSITE * size


def _turn(odometry: Array, scans: Array, heading: float, mirrored: bool) -> complex:
    """By what the motion of the odometry is multiplied in that of the scans: how much farther, and turned by how much.

    `heading` is that of the robot in the frame of the laser, as the log says. 1 where too little is straight on, or
    where single motions differ much, as along a corridor whose walls do not show how far the robot drives.
    """
    a = (odometry[:, 0] + 1j * odometry[:, 1]) * np.exp(1j * heading)
    b = scans[:, 0] + 1j * scans[:, 1]
    moves: Bools = (abs(a) > LEAST_MOVE_M) & (abs(odometry[:, 2]) < STRAIGHT_RAD) & (abs(b) > 0.5 * LEAST_MOVE_M)
    if moves.sum() < MOVES:
        return 1.0
    a, b = a[moves], (b.conj() if mirrored else b)[moves]
    common, size = complex((a.conj() * b).sum()), float((abs(a) * abs(b)).sum())
    farther = abs(b) / abs(a)
    middle = float(np.median(farther))
    steady = (abs(np.log(farther / middle)) < math.log(MOST_FARTHER)).mean() > STEADY_SHARE
    if abs(common) < AGREE * size or not (steady or LEAST_FARTHER < middle < MOST_FARTHER):
        return 1.0
    return middle * common / abs(common)
