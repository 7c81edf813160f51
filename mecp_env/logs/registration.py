"""Odometry for a log without any: each scan is registered to the ones before, from a constant-velocity prediction.

Point-to-line ICP (Censi, An ICP variant using a point-to-line metric, 2008) against the last key scan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.se2 import between, composed
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
    key, T_map_key = surface_of(log, chosen[0]), np.zeros(3)
    step = np.zeros(3)  # the last motion, as a pose per second
    for n, row in enumerate(chosen[1:], start=1):
        scan, dt = surface_of(log, row), float(log.t[row] - log.t[chosen[n - 1]])
        still = between(T_map_key, path[n - 1])
        moved, share = _best(key, scan, still, composed(still, step * dt))
        path[n] = composed(T_map_key, moved)
        step = between(path[n - 1], path[n]) / dt
        if share < GOOD_SHARE or math.hypot(*moved[:2]) > KEY_M or abs(moved[2]) > KEY_RAD:
            key, T_map_key = scan, path[n]
    return path


def surface_of(log: Log, row: int) -> Surface:
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


def _moved(points: Array, pose: Array) -> Array:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = points.T
    return np.stack((pose[0] + c * x - s * y, pose[1] + s * x + c * y), axis=1)


def _distance(key: Surface, scan: Surface, pose: Array) -> float:
    """The mean distance of the points of a scan from those of the key scan, far ones limited."""
    distance, _ = key.tree.query(_moved(scan.points, pose), distance_upper_bound=REACH_M)
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
    moved = _moved(scan.points, pose)
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
