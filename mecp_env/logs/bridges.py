"""Motions by scans where a log lacks odometry for a while, or where it stands still although the robot moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.se2 import between, chained, composed, wrapped
from mecp_env.logs.log import Log
from mecp_env.logs.registration import registered_path

GAP_S, GAP_TIMES = 1.0, 5.0  # without a sample of the odometry: longer than this, and so many times the usual time
STILL_S, STILL_SCANS = 2.0, 5  # without any motion by the odometry, at least
STILL_M = STILL_RAD = 1e-6  # of one step: no motion
MOVED_M, MOVED_SHARE = 0.1, 0.25  # a larger share of the readings changes by more than this: the robot moves,
MOVED_SCANS = 3  # in so many scans, at least
AGREE_M, AGREE_SHARE, AGREE_RAD = 0.1, 0.2, 0.2  # of the path, by which its ends by scans and by odometry may differ


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
    still: Bools = (np.hypot(steps[:, 0], steps[:, 1]) < STILL_M) & (abs(steps[:, 2]) < STILL_RAD)
    return still


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
