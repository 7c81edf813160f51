"""Angles that are not counter-clockwise in rad: of the laser by their size, of odometry by where the robot drives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.logs.readings import MOST_TURNS, Geometry, Recording, Track

FARTHEST_M = 1e8  # no pose is farther: world coordinates have millions of m
TURN_RAD, TURN_DEG = 2.0 * math.pi, 360.0
MOST_START_RAD = 2.0 * TURN_RAD  # of the first bearing
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


def take_radians(recording: Recording) -> None:
    """Take angles of the laser that are too large for rad as degrees, with a note."""
    fits = {geometry: _in_radians(geometry) for geometry in dict.fromkeys(s.geometry for s in recording.sweeps)}
    first = next((geometry for geometry, fit in fits.items() if fit != geometry), None)
    if first is None:
        return
    recording.notes.append(
        f"warning: the angles of the laser are taken as degrees: {first.beams} beams {first.step_rad:g} apart from "
        f"{first.start_rad:g} on are not within {MOST_TURNS:g} turns in rad"
    )
    recording.sweeps = [replace(sweep, geometry=fits[sweep.geometry]) for sweep in recording.sweeps]


def _in_radians(geometry: Geometry) -> Geometry:
    """The geometry with the degrees of its first bearing, or of that and the spacing, made rad; itself without any."""
    start, step = geometry.start_rad, geometry.step_rad
    turns = geometry.beams * abs(step) / TURN_RAD
    if turns > MOST_TURNS and geometry.beams * abs(step) <= MOST_TURNS * TURN_DEG:
        return geometry._replace(start_rad=math.radians(start), step_rad=math.radians(step))
    if turns <= MOST_TURNS and MOST_START_RAD < abs(start) <= TURN_DEG:
        return geometry._replace(start_rad=math.radians(start))
    return geometry


def headings_in_radians(track: Track, notes: list[str]) -> Track:
    """The track, whose headings are counter-clockwise in rad; others are seen by where the robot drives, and noted."""
    poses = np.array(track.poses, np.float64).reshape(-1, 3)
    poses = poses[(abs(poses) < FARTHEST_M).all(axis=1)]
    driven = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T)) if len(poses) > 1 else np.zeros(1)
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
