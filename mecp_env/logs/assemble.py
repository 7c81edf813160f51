"""From what a reader found to a log: one geometry, ascending stamps, sound readings, a pose for each scan.

Whatever is skipped or repaired is counted; a few wrong stamps or readings are no reason to refuse a log.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.errors import LogError
from mecp_env.core.trajectories import between, chained, composed, interpolated, wrapped
from mecp_env.logs.log import Log
from mecp_env.logs.recording import Geometry, Recording, Sweep, Track

LATEST_S = 1e11  # no stamp is later: the year 5138
FARTHEST_M = 1e6  # no pose is farther
GAP = 5.0  # medians between two scans
FASTEST_M_S = 5.0  # a faster motion is a jump of the odometry, not one of the robot,
SLACK_M = 0.5  # if it is longer than this
FIXED_M, FIXED_RAD = 0.02, 0.02  # by which the pose of a laser that is fixed on the robot varies at most
REACH_M = 2.0  # no laser is mounted farther from the robot's centre
LONGEST_M = 1000.0  # no laser measures farther
LIMITS_M = (8.191, 16.0, 30.0, 32.0, 50.0, 80.0, 81.91)  # common readings of lasers where nothing returns
BELOW_LIMIT = 0.99  # of the largest range: from here on a reading is no return
FEWEST_BEAMS, NARROWEST_DEG = 8, 10.0


def assemble(recording: Recording, max_range_m: float | None = None, field_of_view_deg: float | None = None) -> Log:
    """The log. Readings from `max_range_m` on are no returns; beams outside the field of view are left out.

    Raises `LogError` where nothing is left.
    """
    counts = recording.counts
    sweeps = _in_order(recording.sweeps, counts)
    geometry = _most_common(sweeps)
    order, bearings = _ascending(geometry, field_of_view_deg)
    ranges = _on_beams(sweeps, geometry, counts)[:, order]
    limit = max_range_m or _limit(ranges, geometry.max_range_m)
    mount, reference = _mount(recording, sweeps, counts)
    t = np.array([sweep.t for sweep in sweeps])
    T_odom = _at(t, _odometry(recording, sweeps), "odometry", counts)
    T_ref = _at(t, reference, "reference pose", counts)
    kept = np.ones(len(t), bool) if T_odom is None else np.isfinite(T_odom[:, 0])
    if not kept.any():
        raise LogError(f"no scan with odometry ({_listed(counts)})")
    counts["gaps in time"] += _gaps(t[kept])
    return Log(
        *(recording.name, t[kept], _sound(ranges[kept], limit, geometry.min_range_m, counts), bearings, limit, mount),
        *(None if T_odom is None else _bridged(t[kept], T_odom[kept], counts), None if T_ref is None else T_ref[kept]),
        *(recording.relations, +counts),
    )


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{n} {what}" for what, n in (+counts).items()) or "nothing else is in it"


def _in_order(sweeps: list[Sweep], counts: Counter[str]) -> list[Sweep]:
    """The most sweeps whose stamps ascend, in the order of the file. Raises `LogError` without any."""
    stamps = np.array([sweep.t for sweep in sweeps], np.float64)
    rows = _ascending_rows(stamps)
    same = len(stamps) - len(np.unique(stamps))
    counts["scans with the stamp of another"] += same
    counts["scans with an impossible stamp, or out of order"] += len(stamps) - len(rows) - same
    if not len(rows):
        raise LogError(f"no scan that can be used ({_listed(counts)})")
    return [sweeps[row] for row in rows]


def _ascending_rows(t: Array) -> Ints:
    """Rows of the longest ascending subsequence of t (n,): one wrong stamp costs one row, wherever it points."""
    ends: list[float] = []  # of the best subsequence of each length, the last stamp
    last: list[int] = []  # and its row
    before = np.full(len(t), -1)
    for row in np.flatnonzero(abs(t) < LATEST_S).tolist():
        length = bisect_left(ends, t[row])
        before[row] = last[length - 1] if length else -1
        ends[length : length + 1], last[length : length + 1] = [float(t[row])], [row]
    rows = [last[-1]] if last else []
    while rows and before[rows[-1]] >= 0:
        rows.append(int(before[rows[-1]]))
    return np.array(rows[::-1], np.int64)


def _most_common(sweeps: list[Sweep]) -> Geometry:
    """The geometry that most sweeps have."""
    rounded = [_rounded(sweep.geometry) for sweep in sweeps]
    return sweeps[rounded.index(Counter(rounded).most_common(1)[0][0])].geometry


def _rounded(geometry: Geometry) -> Geometry:
    """The same for all sweeps of a laser, whatever the last digits are."""
    return geometry._replace(start_rad=round(geometry.start_rad, 4), step_rad=round(geometry.step_rad, 6))


def _ascending(geometry: Geometry, field_of_view_deg: float | None) -> tuple[Ints, Array]:
    """The readings that are used (B,), and their bearings (B,) rad, ascending. Raises `LogError`."""
    beams, step = geometry.beams, abs(geometry.step_rad)
    if not beams * step > 0.0 or not math.isfinite(beams * step):
        raise LogError(f"laser: {beams} beams {geometry.step_rad:g} rad apart")
    once = wrapped(geometry.angles[: round(2.0 * math.pi / step)])  # the last beam of a circle may repeat the first
    once[once == -math.pi] = math.pi
    order = np.argsort(once)
    order = order[abs(once[order]) <= math.radians(0.5 * (field_of_view_deg or 360.0)) + 1e-9]
    bearings = once[order]
    span = math.degrees(float(np.ptp(bearings))) if len(bearings) else 0.0
    if len(bearings) < FEWEST_BEAMS or span < NARROWEST_DEG or not (np.diff(bearings) > 0.0).all():
        raise LogError(
            f"laser: {len(bearings)} beams over {span:g} deg, at least {FEWEST_BEAMS} over {NARROWEST_DEG:g} expected"
        )
    return order, bearings


def _on_beams(sweeps: list[Sweep], geometry: Geometry, counts: Counter[str]) -> Array:
    """(n,B) m of all sweeps: those of another geometry give each beam the nearest of theirs."""
    ranges, usual = np.empty((len(sweeps), geometry.beams)), _rounded(geometry)
    for row, sweep in enumerate(sweeps):
        if _rounded(sweep.geometry) == usual:
            ranges[row] = sweep.ranges
        else:
            counts["scans with other beams, resampled"] += 1
            ranges[row] = _resampled(sweep, geometry)
    return ranges


def _resampled(sweep: Sweep, geometry: Geometry) -> Array:
    """(B,) m at the bearings of a geometry; nan where the sweep has no beam within a step."""
    step = sweep.geometry.step_rad or math.inf
    place = wrapped(geometry.angles - sweep.geometry.start_rad) / step
    place = np.where(place < -0.5, place + 2.0 * math.pi / abs(step), place)  # behind the first beam: the other way
    beam = np.rint(place).clip(-1, sweep.geometry.beams).astype(np.int64)
    there = (beam >= 0) & (beam < sweep.geometry.beams)
    return np.where(there, sweep.ranges[np.where(there, beam, 0)], np.nan)


def _limit(ranges: Array, stated: float) -> float:
    """m from which on a reading is no return: by the log, by a common limit near the largest reading, or that."""
    if 0.0 < stated <= LONGEST_M:
        return BELOW_LIMIT * stated
    top = float(ranges[ranges <= LONGEST_M].max(initial=0.0))
    if top <= 0.0:
        raise LogError("laser: no reading above 0 m")
    near = [limit for limit in LIMITS_M if BELOW_LIMIT * limit <= top <= 1.001 * limit]
    return BELOW_LIMIT * near[0] if near else float(np.nextafter(top, math.inf))


def _sound(ranges: Array, limit: float, least: float, counts: Counter[str]) -> Array:
    """The readings (n,B) with nan for all that measure nothing."""
    near = (ranges <= 0.0) | (ranges < least)
    far = ~near & ~(ranges < limit)
    counts["readings below the least range"] += int(near.sum())
    counts["readings without a return"] += int(far.sum())
    return np.where(near | far, np.nan, ranges)


def _odometry(recording: Recording, sweeps: list[Sweep]) -> Track:
    """The poses that the sweeps carry, or those between them."""
    poses = [sweep.T_odom_robot for sweep in sweeps if sweep.T_odom_robot is not None]
    return Track([sweep.t for sweep in sweeps], poses) if len(poses) == len(sweeps) else recording.odometry


def _mount(recording: Recording, sweeps: list[Sweep], counts: Counter[str]) -> tuple[Array, Track]:
    """The mounting pose (3,) of the laser, and the reference path.

    Where the poses of laser and robot differ by a constant, that is the mounting pose; otherwise the first has been
    corrected by another program, and serves as reference where the log has no other.
    """
    stated = np.zeros(3) if recording.T_robot_laser is None else recording.T_robot_laser
    pairs = [(s.T_odom_robot, s.T_odom_laser) for s in sweeps if s.T_odom_robot is not None]
    if not pairs:
        return _near(stated, counts), recording.reference
    T_robot, T_laser = (np.array(poses, np.float64) for poses in zip(*pairs, strict=True))
    offsets = between(T_robot, T_laser)
    middle = np.median(offsets, axis=0)
    off = between(middle, offsets)
    fixed = (np.hypot(off[:, 0], off[:, 1]) < FIXED_M) & (abs(off[:, 2]) < FIXED_RAD)
    if 2 * fixed.sum() > len(fixed):
        return _near(middle, counts), recording.reference
    corrected = Track([sweep.t for sweep in sweeps], list(T_laser))
    return _near(stated, counts), recording.reference if recording.reference.t else corrected


def _near(T_robot_laser: Array, counts: Counter[str]) -> Array:
    """The mounting pose; zero for one that is none."""
    if np.isfinite(T_robot_laser).all() and (abs(T_robot_laser[:2]) <= REACH_M).all():
        return np.array([*T_robot_laser[:2], math.remainder(float(T_robot_laser[2]), 2.0 * math.pi)])
    counts["impossible mounting pose, taken as centred"] += 1
    return np.zeros(3)


def _at(t: Array, track: Track, what: str, counts: Counter[str]) -> Array | None:
    """(n,3) the poses of a track at the stamps t (n,), nan where it has none; None for an empty track."""
    if not track.t:
        return None
    stamps, poses = np.array(track.t, np.float64), np.array(track.poses, np.float64)
    rows = np.flatnonzero((abs(poses) < FARTHEST_M).all(axis=1))
    rows = rows[_ascending_rows(stamps[rows])]
    counts[f"samples of the {what} that are damaged or out of order"] += len(stamps) - len(rows)
    inside = (t >= stamps[rows[0]]) & (t <= stamps[rows[-1]]) if len(rows) else np.zeros(len(t), bool)
    counts[f"scans without {what}"] += int((~inside).sum())
    found = np.full((len(t), 3), np.nan)
    if inside.any():
        found[inside] = interpolated(stamps[rows], poses[rows], t[inside])
    return found


def _bridged(t: Array, T_odom_robot: Array, counts: Counter[str]) -> Array:
    """The poses (n,3) without jumps: a robot whose odometry was set to another pose has not moved."""
    steps = between(T_odom_robot[:-1], T_odom_robot[1:])
    jumps = np.hypot(steps[:, 0], steps[:, 1]) > SLACK_M + FASTEST_M_S * np.diff(t)
    if not jumps.any():
        return T_odom_robot
    counts["jumps of the odometry, taken as no motion"] += int(jumps.sum())
    steps[jumps] = 0.0
    return composed(T_odom_robot[0], chained(steps))


def _gaps(t: Array) -> int:
    """How many intervals of the stamps t (n,) are much longer than most."""
    steps = np.diff(t)
    return int((steps > GAP * np.median(steps)).sum()) if len(steps) else 0
