"""Several lasers as one scanner at the robot's centre: sweeps that were taken at nearly the same time, merged.

What a beam without a return means for a laser: nothing within its range, or a wall that it does not see.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import between, interpolated, to_map
from mecp_env.logs.poses import sound
from mecp_env.logs.readings import Readings
from mecp_env.logs.recording import Geometry, Sweep, Track

NEAR_SHARE = 0.8  # of the range: gaps between nearer hits are mostly walls, those between farther ones open space
LOST_SHARE = 0.13  # of all beams, in such gaps, and
NARROW_SHARE = 0.01  # as a share of the hits, in gaps narrower than
NARROW_M = 1.0  # this between their two hits: from both on, the laser is weak
SWEEPS = 300  # that are looked at, spread over the log


def no_return_of(ranges: Array, step_rad: float, max_range_m: float) -> Literal["free", "unknown"]:
    """`unknown` for a weak laser, whose beams (n,B) m often do not return (nan) between two near hits."""
    some = ranges[:: max(1, len(ranges) // SWEEPS)]
    gaps = np.array([_gaps(sweep, step_rad, NEAR_SHARE * max_range_m) for sweep in some]).reshape(-1, 3).sum(axis=0)
    lost, narrow, hits = gaps.tolist()
    weak = lost > LOST_SHARE * some.size and narrow > NARROW_SHARE * hits
    return "unknown" if weak else "free"


def _gaps(ranges: Array, step_rad: float, near_m: float) -> tuple[int, int, int]:
    """Beams (B,) without a return between two near hits; those of them in narrow gaps; and hits."""
    hits = np.flatnonzero(np.isfinite(ranges))
    empty = np.diff(hits) - 1
    first, last = ranges[hits[:-1]], ranges[hits[1:]]
    angle = np.minimum((empty + 1) * step_rad, np.pi)
    width = np.sqrt(np.maximum(first**2 + last**2 - 2.0 * first * last * np.cos(angle), 0.0))
    near = np.maximum(first, last) < near_m
    return int(empty[near].sum()), int(empty[near & (width < NARROW_M)].sum()), len(hits)


SWALLOWED, MOST_SWALLOWED = 0.02, 0.5  # shares of the beams: fewer lost ones are chance, more are not looked for
ON_WALL_M, ON_WALL_STEPS = 0.05, 3.0  # two hits nearer than this, or than so many times their spacing: one wall


def swallowed_of(ranges: Array, step_rad: float) -> float:
    """The share of the beams (n,B) m that walls swallow (nan); 0 where that is little.

    Where each beam is lost with a probability p, two hits on a wall are p times as often beside one lost beam as beside
    each other.
    """
    some = ranges[:: max(1, len(ranges) // SWEEPS)]
    beside = _on_one_wall(some[:, :-1], some[:, 1:], step_rad)
    lost_between = _on_one_wall(some[:, :-2], some[:, 2:], 2.0 * step_rad) & np.isnan(some[:, 1:-1])
    share = float(lost_between.sum()) / max(int(beside.sum()), 1)
    return min(share, MOST_SWALLOWED) if share > SWALLOWED else 0.0


def _on_one_wall(a: Array, b: Array, angle: float) -> Bools:
    """True for ranges m, so many rad apart, whose points are near each other; not for nan."""
    apart = np.sqrt(np.maximum(a * a + b * b - 2.0 * math.cos(angle) * a * b, 0.0))
    return apart < np.maximum(ON_WALL_M, ON_WALL_STEPS * angle * np.minimum(a, b))


JOINED_M, JOINED_STEPS = 0.1, 6.0  # neighbouring hits nearer than this, or than so many times their spacing, are one
# surface, which fills the beams between them
MOST_TURN_RAD = math.radians(5.0)  # between two sweeps: after a larger turn the second is left out
WIDEST = 64  # beams that two neighbouring hits fill at most


def one_scanner(
    lasers: Sequence[tuple[list[Sweep], Readings, Array]], odometry: Track, counts: Counter[str]
) -> list[Sweep]:
    """The sweeps of the laser that has the most, each with those of the others that were taken nearest to it.

    Each laser has its mounting pose (3,) m, rad. Beams that no laser covers have no return.
    """
    base = max((sweeps for sweeps, _, _ in lasers), key=len)
    beams = round(2.0 * math.pi / min(float(np.diff(readings.bearings).min()) for _, readings, _ in lasers))
    geometry = Geometry(beams, 2.0 * math.pi / beams - math.pi, 2.0 * math.pi / beams)
    t = np.array([sweep.t for sweep in base])
    merged = [Sweep(stamp, np.full(beams, np.inf), geometry) for stamp in t.tolist()]
    for sweeps, readings, mount in lasers:
        partners, motions = _partners(t, sweeps, odometry)
        counts["scans without one of another laser at the same time"] += int((partners < 0).sum())
        for row in np.flatnonzero(partners >= 0):
            _rasterise(_points(readings, partners[row], mount, motions[row]), merged[row].ranges)
    return merged


def _partners(t: Array, sweeps: list[Sweep], odometry: Track) -> tuple[Ints, Array]:
    """For each stamp of t (n,) the nearest sweep (n,), -1 where none is near, and the robot's motion to it (n,3)."""
    other = np.array([sweep.t for sweep in sweeps])
    after = np.searchsorted(other, t).clip(min(1, len(other) - 1), len(other) - 1)
    before = np.maximum(after - 1, 0)
    partner = np.where(abs(other[before] - t) <= abs(other[after] - t), before, after)
    motion = _motion(t, other[partner], odometry)
    period = float(np.median(np.diff(t))) if len(t) > 1 else math.inf
    near = (abs(other[partner] - t) <= 0.51 * period) & (abs(motion[:, 2]) <= MOST_TURN_RAD)
    return np.where(near, partner, -1), motion


def _motion(t: Array, other: Array, odometry: Track) -> Array:
    """(n,3) the robot's pose at the stamps `other` (n,) in its frame at t (n,), by the odometry."""
    stamps, poses = sound(odometry)
    if len(stamps) < 2:
        return np.zeros((len(t), 3))
    return between(*(interpolated(stamps, poses, at) for at in (t, other)))


def _points(readings: Readings, row: int, mount: Array, motion: Array) -> Array:
    """(B,2) m in the robot's frame, nan where nothing returned."""
    ranges, angles = readings.ranges[row], readings.bearings + mount[2]
    x, y = mount[0] + ranges * np.cos(angles), mount[1] + ranges * np.sin(angles)
    return to_map(motion, np.stack((x, y), axis=1))


def _rasterise(points: Array, ranges: Array) -> None:
    """Bring the ranges (B,) of a scanner at the origin down to the points (n,2), and to the surfaces between them."""
    step = 2.0 * math.pi / len(ranges)
    near, beam, reach = _surfaces(points, step)
    alone = np.isfinite(points[:, 0])
    alone[near] = alone[near + 1] = False
    place = np.rint(np.arctan2(points[alone, 1], points[alone, 0]) / step).astype(np.int64)
    beams, reaches = np.append(beam, place), np.append(reach, np.hypot(*points[alone].T))
    np.minimum.at(ranges, (beams + len(ranges) // 2 - 1) % len(ranges), reaches)


def _surfaces(points: Array, step: float) -> tuple[Ints, Ints, Array]:
    """The points (k,) that are one surface with the next, and the beams (m,) that meet these surfaces, after m (m,)."""
    a, b = points[:-1], points[1:]
    usual = JOINED_STEPS * step * np.hypot(*a.T)
    near = np.flatnonzero(np.hypot(*(b - a).T) < np.maximum(JOINED_M, usual))
    a, b = a[near], b[near]
    first, turn = np.arctan2(a[:, 1], a[:, 0]), np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    low, high = np.minimum(first, first + turn), np.maximum(first, first + turn)
    begin, end = np.ceil(low / step - 1e-9).astype(np.int64), np.floor(high / step + 1e-9).astype(np.int64)
    count = (end - begin + 1).clip(0, WIDEST)
    owner = np.repeat(np.arange(len(near)), count)
    beam = begin[owner] + np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    c, s, along = np.cos(beam * step), np.sin(beam * step), (b - a)[owner]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (a[owner, 0] * along[:, 1] - a[owner, 1] * along[:, 0]) / (c * along[:, 1] - s * along[:, 0])
    ahead = np.isfinite(reach) & (reach > 0.0)
    return near, beam[ahead], reach[ahead]
