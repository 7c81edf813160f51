"""The poses of a track at the stamps of the scans: headings in rad, without samples and jumps that no robot makes."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between, chained, composed, interpolated
from mecp_env.logs.clock import FASTEST_M_S, ascending_rows
from mecp_env.logs.recording import Track

FARTHEST_M = 1e8  # no pose is farther: world coordinates have millions of m
SLACK_M = 0.5  # a motion that is longer, and faster than a robot, is a jump of the odometry;
SPIKE, MOST_SPIKES = 5, 0.1  # samples that jump away and back again, at most, and their share of all;
USUAL = 0.95  # of the motions are shorter than those of which a robot is back
JUMPS = 3  # of them, and half of all motions: more are no odometry in m
MOVED_M = 0.02  # a shorter motion is none
STEP_M, STEPS = 0.1, 20  # driven, from whose direction the meaning of headings is seen, so often at least
LONGEST_M = 1e5  # of the path that is looked at
AGREE = 0.95  # a resultant of so much between headings and directions says that they belong together,
BETTER = 0.5  # if it misses 1 by less than so much of what it does for headings in rad
ROUND = 0.5  # a resultant of the directions below: the robot drove in all of them
MEANINGS = {
    "in degrees, taken as such": math.pi / 180.0,
    "clockwise, turned round": -1.0,
    "clockwise in degrees, turned round": -math.pi / 180.0,
}


def headings_in_radians(track: Track, notes: list[str]) -> Track:
    """The track, whose headings are counter-clockwise in rad; others are seen by where the robot drives, and noted."""
    poses = np.array(track.poses, np.float64).reshape(-1, 3)
    poses = poses[(abs(poses) < FARTHEST_M).all(axis=1)]
    driven = np.cumsum(_lengths(poses)) if len(poses) > 1 else np.zeros(1)
    rows = np.unique(np.searchsorted(driven, np.arange(0.0, min(float(driven[-1]), LONGEST_M), STEP_M)))
    meaning = _meaning(poses[rows]) if len(rows) > STEPS else None
    if meaning is None:
        return track
    notes.append(f"warning: by where the robot drives, the headings of the odometry are {meaning}")
    factors = np.array([1.0, 1.0, MEANINGS[meaning]])
    return Track(track.t, [np.asarray(pose, np.float64) * factors for pose in track.poses], track.order)


def _meaning(poses: Array) -> str | None:
    """What the headings of poses (n,3) seem to be; None where they are counter-clockwise in rad, or it is not clear.

    Motion backwards counts like motion forwards, unless the robot came round: then most of it is forwards.
    """
    steps = np.diff(poses[:, :2], axis=0)
    direction = np.arctan2(steps[:, 1], steps[:, 0])
    for power in (1, 2) if abs(np.exp(1j * direction).mean()) < ROUND else (2,):
        stated = _agreement(poses, direction, 1.0, power)
        if stated >= AGREE:
            return None
        fits = {meaning: _agreement(poses, direction, factor, power) for meaning, factor in MEANINGS.items()}
        meaning = max(fits, key=lambda meaning: fits[meaning])
        if fits[meaning] >= AGREE and 1.0 - fits[meaning] < BETTER * (1.0 - stated):
            return meaning
    return None


def _agreement(poses: Array, direction: Array, factor: float, power: int) -> float:
    """How constant the angle is between headings, times a factor, and directions of motion (n-1,): 1 is always the
    same, 0 any; with `power` 2 forwards or backwards.
    """
    heading, turn = factor * poses[:-1, 2], factor * np.diff(poses[:, 2])
    middle = heading + 0.5 * np.remainder(turn + math.pi, 2.0 * math.pi) - 0.5 * math.pi
    return float(abs(np.exp(power * 1j * (direction - middle)).mean()))


def sound(track: Track) -> tuple[Array, Array]:
    """The stamps (m,) and poses (m,3) of the samples that are finite and in order."""
    stamps, poses = np.array(track.t, np.float64), np.array(track.poses, np.float64).reshape(-1, 3)
    rows = np.flatnonzero((abs(poses) < FARTHEST_M).all(axis=1))
    rows = rows[ascending_rows(stamps[rows])]
    return stamps[rows], poses[rows]


def poses_at(t: Array, track: Track, what: str, counts: Counter[str]) -> Array | None:
    """(n,3) the poses of a track at the stamps t (n,), nan where it has none; None for an empty track."""
    if not track.t:
        return None
    stamps, poses = sound(track)
    counts[f"samples of the {what} that are damaged or out of order"] += len(track.t) - len(stamps)
    steady = ~_spikes(stamps, poses)
    counts[f"samples of the {what} that jump away and back"] += int((~steady).sum())
    stamps, poses = stamps[steady], poses[steady]
    inside = (t >= stamps[0]) & (t <= stamps[-1]) if len(stamps) else np.zeros(len(t), bool)
    counts[f"scans without {what}"] += int((~inside).sum())
    found = np.full((len(t), 3), np.nan)
    if inside.any():
        found[inside] = interpolated(stamps, poses, t[inside])
    return found


def _spikes(stamps: Array, poses: Array) -> Bools:
    """(m,) true for single poses that jump away from those before and after them, which fit each other.

    None where they are many: then the unit is another than m.
    """
    away, jumps = np.zeros(len(stamps), np.bool_), _are_jumps(stamps, poses)
    if not jumps.any():
        return away
    usual_m = float(np.quantile(_lengths(poses)[~jumps], USUAL)) if not jumps.all() else 0.0
    for row in np.flatnonzero(jumps).tolist():
        if not away[row]:
            near = poses[row + 2 : row + SPIKE + 2, :2] - poses[row, :2]
            back = np.flatnonzero(np.hypot(*near.T) < SLACK_M + usual_m * np.arange(2, len(near) + 2))
            away[row + 1 : row + 2 + back[0] if len(back) else row + 1] = True
    return away if away.sum() <= MOST_SPIKES * len(away) else np.zeros_like(away)


def _lengths(poses: Array) -> Array:
    """(m-1,) m from each of the poses (m,3) to the next."""
    lengths: Array = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    return lengths


def _are_jumps(stamps: Array, poses: Array) -> Bools:
    """(m-1,) true where a robot would be too fast from one of the poses (m,3) to the next."""
    return _lengths(poses) > SLACK_M + FASTEST_M_S * np.diff(stamps)


def without_jumps(t: Array, T_odom_robot: Array, counts: Counter[str]) -> Array:
    """The poses (n,3) without jumps: a robot whose odometry was set to another pose has not moved.

    Raises `LogError` where half of the motions are jumps.
    """
    steps = between(T_odom_robot[:-1], T_odom_robot[1:])
    jumps, moves = _are_jumps(t, T_odom_robot), int((np.hypot(steps[:, 0], steps[:, 1]) > MOVED_M).sum())
    if jumps.sum() > max(JUMPS, 0.5 * moves):
        raise LogError(
            f"odometry: {jumps.sum()} of {moves} motions are faster than {FASTEST_M_S:g} m/s, "
            "poses in m and stamps in s expected: --odometry none does without"
        )
    if not jumps.any():
        return T_odom_robot
    counts["jumps of the odometry, taken as no motion"] += int(jumps.sum())
    steps[jumps] = 0.0
    return composed(T_odom_robot[0], chained(steps))
