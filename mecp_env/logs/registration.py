"""Odometry made of scans: for a log without any, and where it has none for a while or stands still as the robot moves.

Each scan is registered to the ones before, from a constant-velocity prediction, by point-to-line ICP (Censi, An ICP
variant using a point-to-line metric, 2008) against the last key scan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.se2 import between, chained, composed, to_map, wrapped
from mecp_env.logs.log import Log

ROUNDS = 20  # of ICP at most
STILL = 1e-5  # m and rad: ICP has converged
REACH_M, LEAST_REACH_M = 0.6, 0.12  # of a point from its partner in the first round, and in the last
INLIER_M = 0.08  # of a point from the line of its partner
GOOD_SHARE, POOR_SHARE = 0.8, 0.5  # of the points that are inliers: no other start is tried; a new key scan is needed
KEY_M, KEY_RAD = 0.4, 0.4  # from the key scan; farther, the scan becomes the next one
SURFACE = 2.5  # times the spacing of the beams at a range, within which neighbours are one surface
POINTS = 400  # of a scan that are registered, at most
TURNS_RAD = np.radians((0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 45.0, -45.0))  # starts beside the prediction
GAP_S, GAP_TIMES = 1.0, 5.0  # without a sample of the odometry: longer than this, and so many times the usual time
STILL_S, STILL_SCANS = 2.0, 5  # without any motion by the odometry, at least
STILL_M = STILL_RAD = 1e-6  # of one step: no motion
MOVED_M, MOVED_SHARE = 0.1, 0.25  # a larger share of the readings changes by more than this: the robot moves,
MOVED_SCANS = 3  # in so many scans, at least
AGREE_M, AGREE_SHARE, AGREE_RAD = 0.1, 0.2, 0.2  # of the path, by which its ends by scans and by odometry may differ


@dataclass(frozen=True, slots=True)
class Surface:
    """The points of a scan that have a normal, robot frame."""

    points: Array  # (n,2) m
    normals: Array  # (n,2)
    tree: cKDTree


def registered(log: Log) -> Log:
    """The log with odometry made of its scans."""
    return replace(log, T_odom_robot=registered_path(log))


def registered_path(log: Log, rows: Sequence[int] | None = None) -> Array:
    """(n,3) m, rad: the poses of the scans (those of `rows`), in the frame of the first."""
    chosen: Sequence[int] = range(len(log)) if rows is None else rows
    path = np.zeros((len(chosen), 3))
    if not len(chosen):
        return path
    key, T_map_key = _surface(log, chosen[0]), np.zeros(3)
    step = np.zeros(3)  # the last motion, as a pose per second
    for n, row in enumerate(chosen[1:], start=1):
        scan, dt = _surface(log, row), float(log.t[row] - log.t[chosen[n - 1]])
        still = between(T_map_key, path[n - 1])
        moved, share = _best(key, scan, still, composed(still, step * dt))
        path[n] = composed(T_map_key, moved)
        step = between(path[n - 1], path[n]) / dt
        if share < GOOD_SHARE or math.hypot(*moved[:2]) > KEY_M or abs(moved[2]) > KEY_RAD:
            key, T_map_key = scan, path[n]
    return path


def bridged(log: Log, sampled: Array) -> Log:
    """The log with the motions of its scans where its odometry has none; a note says where.

    `sampled` (m,) s, ascending: the stamps of the odometry.
    """
    if log.T_odom_robot is None or len(log) < STILL_SCANS:
        return log
    steps = between(log.T_odom_robot[:-1], log.T_odom_robot[1:])
    if _is_still(steps).all():
        return log  # as a whole it is of no use: `--odometry none` does without, and says what that cannot show
    still = [(first, min(last + 1, len(steps))) for first, last in _runs(_is_still(steps)) if _moves(log, first, last)]
    runs = _runs(_in_gaps(log.t, sampled)) + still  # the odometry may catch up in the step behind
    if not runs:
        return log
    for first, last in runs:
        path = registered_path(log, range(first, last + 1))
        path = _ending_at(path, between(log.T_odom_robot[first], log.T_odom_robot[last]))
        steps[first:last] = between(path[:-1], path[1:])
    return replace(
        log, T_odom_robot=composed(log.T_odom_robot[0], chained(steps)), notes=(*log.notes, _said(log, runs))
    )


def with_ends(t: Array, T_odom_robot: Array, known: Bools) -> Bools:
    """(n,) the poses (n,3) that are `known`, and those long before and behind them, which get the nearest of them.

    There the odometry stands still, as far as it goes.
    """
    first, last = np.flatnonzero(known)[[0, -1]].tolist()
    known = known.copy()
    for rows, nearest in ((slice(0, first), first), (slice(last + 1, None), last)):
        if len(t[rows]) >= STILL_SCANS and np.ptp(t[rows]) >= STILL_S:
            T_odom_robot[rows], known[rows] = T_odom_robot[nearest], True
    return known


def _in_gaps(t: Array, sampled: Array) -> Bools:
    """(n-1,) true for each step between the stamps t (n,) that is within a gap of the odometry, with a scan in it."""
    pauses = np.diff(sampled)
    if not len(pauses):
        return np.zeros(len(t) - 1, np.bool_)
    gaps = np.flatnonzero(pauses > max(GAP_S, GAP_TIMES * float(np.median(pauses))))
    inside = np.zeros(len(t) - 1, np.bool_)
    for first, last in zip(
        np.searchsorted(t, sampled[gaps], "right") - 1, np.searchsorted(t, sampled[gaps + 1]), strict=True
    ):
        inside[max(int(first), 0) : int(last)] = last - first > 1
    return inside


def _is_still(steps: Array) -> Bools:
    """(n-1,) true for each step (n-1,3) that is no motion."""
    return (np.hypot(steps[:, 0], steps[:, 1]) < STILL_M) & (abs(steps[:, 2]) < STILL_RAD)


def _runs(chosen: Bools) -> list[tuple[int, int]]:
    """The first and the last scan of each run of chosen steps (n-1,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], chosen, [False])).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _moves(log: Log, first: int, last: int) -> bool:
    """True where the scans of a stretch change as those of a robot that moves, and for long enough."""
    if last - first < STILL_SCANS or log.t[last] - log.t[first] < STILL_S:
        return False
    change = abs(log.ranges[first + 1 : last + 1] - log.ranges[first])
    hits = np.isfinite(change).sum(axis=1)
    changed = (change > MOVED_M).sum(axis=1)
    return int((changed > MOVED_SHARE * hits).sum()) >= MOVED_SCANS


def _ending_at(path: Array, end: Array) -> Array:
    """A path (n,3) by scans, brought to its end (3,) by the odometry where the two nearly agree.

    They do where messages were lost; they do not where the odometry stood still, or began again elsewhere.
    """
    length = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
    off = end - path[-1]
    off[2] = math.remainder(float(off[2]), 2.0 * math.pi)
    if math.hypot(*off[:2]) > AGREE_M + AGREE_SHARE * length or abs(off[2]) > AGREE_RAD:
        return path
    brought: Array = path + np.linspace(0.0, 1.0, len(path))[:, None] * off
    brought[:, 2] = wrapped(brought[:, 2])
    return brought


def _said(log: Log, runs: list[tuple[int, int]]) -> str:
    """Where the motions are those of the scans."""
    scans, (first, last) = sum(last - first for first, last in runs), runs[0]
    return (
        f"warning: the odometry has no motion in {scans} of {len(log)} scans although the robot moves by its scans, "
        f"first from {log.t[first]:.3f} s to {log.t[last]:.3f} s: motions are those of the scans there"
    )


def _surface(log: Log, row: int) -> Surface:
    """The points of a scan, with normals by their neighbours."""
    ranges, x, y = log.ranges[row], *log.T_robot_laser[:2]
    angles = log.bearings + log.T_robot_laser[2]
    points = np.stack((x + ranges * np.cos(angles), y + ranges * np.sin(angles)), axis=1)
    along = points[2:] - points[:-2]
    length = np.hypot(*along.T)
    near = length < SURFACE * (0.02 + log.step_rad * ranges[1:-1])
    rows = np.flatnonzero(near & (length > 0.0))  # nan is neither
    rows = rows[:: 1 + len(rows) // POINTS]
    normals = np.stack((-along[rows, 1], along[rows, 0]), axis=1) / length[rows, None]
    return Surface(points[rows + 1], normals, cKDTree(points[rows + 1]))


def _best(key: Surface, scan: Surface, still: Array, predicted: Array) -> tuple[Array, float]:
    """(3,) the pose of a scan in the frame of the key scan, and the share of its points that fit."""
    if min(len(key.points), len(scan.points)) < 3:
        return predicted, 0.0
    best, share = _icp(key, scan, predicted)
    if share >= GOOD_SHARE:
        return best, share
    starts = [start + np.array([0.0, 0.0, turn]) for start, turn in product((predicted, still), TURNS_RAD)]
    starts.sort(key=lambda start: _distance(key, scan, start))
    for start in starts[:3]:
        pose, its = _icp(key, scan, start)
        if its > share:
            best, share = pose, its
    return (best, share) if share > POOR_SHARE else (predicted, share)


def _distance(key: Surface, scan: Surface, pose: Array) -> float:
    """The mean distance of the points of a scan from those of the key scan, far ones limited."""
    distance, _ = key.tree.query(to_map(pose, scan.points), distance_upper_bound=REACH_M)
    return float(np.minimum(distance, REACH_M).mean())


def _icp(key: Surface, scan: Surface, start: Array) -> tuple[Array, float]:
    """The pose (3,) from a start, and the share of the points that lie on lines of the key scan there."""
    pose, reach = start.copy(), REACH_M
    fit = np.zeros(len(scan.points), np.bool_)
    for _ in range(ROUNDS):
        step, fit = _gauss_newton(key, scan, pose, reach)
        pose += step
        reach = max(LEAST_REACH_M, 0.7 * reach)
        if reach == LEAST_REACH_M and abs(step).max() < STILL:
            break
    return pose, float(fit.mean())


def _gauss_newton(key: Surface, scan: Surface, pose: Array, reach: float) -> tuple[Array, Bools]:
    """One step (3,), and which points (n,) fit."""
    moved = to_map(pose, scan.points)
    distance, partner = key.tree.query(moved, distance_upper_bound=reach)
    found = np.flatnonzero(np.isfinite(distance))
    partner = np.asarray(partner)
    fit = np.zeros(len(moved), np.bool_)
    if len(found) < 3:
        return np.zeros(3), fit
    normal, offset = key.normals[partner[found]], moved[found] - key.points[partner[found]]
    turned = np.stack((pose[1] - moved[found, 1], moved[found, 0] - pose[0]), axis=1)
    residual = (normal * offset).sum(axis=1)
    jacobian = np.column_stack((normal, (normal * turned).sum(axis=1)))
    weight = 1.0 / (1.0 + (residual / (0.5 * INLIER_M)) ** 2)
    information = jacobian.T @ (jacobian * weight[:, None]) + 1e-3 * np.eye(3)  # keeps the prediction along a corridor
    step: Array = -np.linalg.solve(information, jacobian.T @ (weight * residual))
    fit[found] = abs(residual) < INLIER_M
    return step, fit
