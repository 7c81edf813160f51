"""The stamps of a recording: those of its messages, or the order of the file where they are of no use."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LogError
from mecp_env.logs.readings import Recording, Sweep, Track

Clock = Literal["message", "received"]
LATEST_S = 1e11  # no stamp is later: the year 5138
LEAST_UNIT_S = 2e-9  # the least unit of a stamp is ns
SLOWEST_S = 5.0  # from one scan to the next, usually; longer times are in ms, us or ns,
FASTEST_M_S = 5.0  # unless the robot were faster in such a unit: no robot is
DAY_S, DATES, SHORTEST_S = 86400.0, (3e4, 8e5), 1e-3  # dates of Excel and MATLAB count days; scans are not nearer
LATE_S = 0.3  # messages are received later than their stamps by times that differ by less
USEFUL_SHARE = 0.75  # of the stamps ascend, and
DISTINCT_SHARE = 0.02  # of them differ, at least; otherwise the order of the file counts
OUT_OF_ORDER, MOST_OUT = "scans with an impossible stamp, or out of order", 0.05  # of the scans, without a warning
UNUSABLE = "stamps of the messages are equal, missing or not ascending: the order of the file counts"
RECEIVED = "--clock received: the order of the file counts (in a bag, the times when messages were received)"


def set_stamps(recording: Recording, clock: Clock) -> None:
    """Give the sweeps of each laser ascending stamps, and poses those of the same clock.

    Raises `LogError` without any sweep.
    """
    _take_seconds(recording)
    have_poses = all(sweep.T_odom_robot is not None for sweep in recording.sweeps)
    useful = _all_useful(recording, have_poses)
    if clock == "received" or not useful:
        recording.notes.append(RECEIVED if clock == "received" else UNUSABLE)
        _take_order(recording)
    recording.counts["scans without a useful stamp, in the order of the file"] += (not useful) * len(recording.sweeps)
    lasers = recording.by_laser().values()
    found = [sweep for sweeps in lasers for sweep in _sorted_out(sweeps, have_poses, recording.counts)]
    if not found:
        raise LogError(f"no scan that can be used ({listed(recording)})")
    _note_out_of_order(recording)
    recording.sweeps = found


def _note_out_of_order(recording: Recording) -> None:
    """Note where many scans are left out."""
    out, scans = recording.counts[OUT_OF_ORDER], len(recording.sweeps)
    if out > MOST_OUT * scans:
        recording.notes.append(
            f"warning: {out} of {scans} scans are out of order by their stamps and left out: "
            "--clock received takes the order of the file (in a bag, the times of receipt)"
        )


def note_delay(recording: Recording) -> None:
    """Note where scans and odometry of a bag are stamped by clocks that differ, as their times of receipt show."""
    stamps = [np.array([s.t for s in recording.sweeps]), np.array(recording.odometry.t)]
    received = [np.array([s.order for s in recording.sweeps]), np.array(recording.odometry.order)]
    if not all(len(t) and are_useful(t) for t in stamps):
        return
    scans, odometry = (float(np.median(after - t)) for after, t in zip(received, stamps, strict=True))
    if abs(odometry - scans) > LATE_S:
        recording.notes.append(
            f"warning: by the times of receipt, the clocks of scans and odometry differ by {odometry - scans:.2f} s: "
            "--clock received takes those times"
        )


def _all_useful(recording: Recording, have_poses: bool) -> bool:
    """True where the stamps of all lasers are of use, and those of the poses that sweeps do not carry."""
    poses = [] if have_poses else [np.array(recording.odometry.t, np.float64)]
    return all(map(are_useful, (*map(_stamps, recording.by_laser().values()), *poses)))


def _stamps(sweeps: list[Sweep]) -> Array:
    return np.array([sweep.t for sweep in sweeps], np.float64)


def listed(recording: Recording) -> str:
    """What has been counted so far, in words."""
    return ", ".join(f"{n} {what}" for what, n in (+recording.counts).items()) or "nothing else is in it"


def are_useful(stamps: Array) -> bool:
    """True unless too many of the stamps (n,) are equal, impossible or out of order."""
    if len(stamps) < 3:
        return not len(stamps) or (bool((abs(stamps) < LATEST_S).all()) and len(np.unique(stamps)) == len(stamps))
    kept = stamps[ascending_rows(stamps, equal=True)]
    return len(kept) >= USEFUL_SHARE * len(stamps) and len(np.unique(kept)) > max(1.0, DISTINCT_SHARE * len(stamps))


def ascending_rows(t: Array, equal: bool = False) -> Ints:
    """Rows of the longest ascending subsequence of t (n,): one wrong stamp costs one row, wherever it points.

    With `equal` it does not descend.
    """
    ends: list[float] = []  # of the best subsequence of each length, the last stamp
    last: list[int] = []  # and its row
    before, find = np.full(len(t), -1), bisect_right if equal else bisect_left
    for row in np.flatnonzero(abs(t) < LATEST_S).tolist():
        length = find(ends, t[row])
        before[row] = last[length - 1] if length else -1
        ends[length : length + 1], last[length : length + 1] = [float(t[row])], [row]
    rows = [last[-1]] if last else []
    while rows and before[rows[-1]] >= 0:
        rows.append(int(before[rows[-1]]))
    return np.array(rows[::-1], np.int64)


def _take_seconds(recording: Recording) -> None:
    """Take stamps that cannot be in s for ms, us or ns, or for days."""
    unit = _unit(recording)
    if unit == 1.0:
        return
    recording.notes.append("stamps are taken in " + (f"units of {unit:.0e} s" if unit < 1.0 else "days"))
    recording.sweeps = [replace(sweep, t=unit * sweep.t) for sweep in recording.sweeps]
    for track in (recording.odometry, recording.reference):
        track.t = [unit * t for t in track.t]
    recording.relations = recording.relations * (unit, unit, 1.0, 1.0, 1.0)


def _unit(recording: Recording) -> float:
    """Days, or s, ms, us or ns: the largest in which stamps are not too late, nor scans too far apart in time."""
    stamps = _stamps(recording.sweeps)
    stamps = stamps[np.isfinite(stamps)]
    middle = float(np.median(abs(stamps))) if len(stamps) else 0.0
    usual = _usual_step(recording, lambda sweep: sweep.t)
    received = _usual_step(recording, lambda sweep: sweep.order)
    if usual < SHORTEST_S and DATES[0] < middle < DATES[1]:
        return DAY_S
    of_stamps, of_steps = _largest(middle, LATEST_S), _largest(usual, SLOWEST_S)
    possible = usual > 2.0 * received and _usual_speed(recording) <= FASTEST_M_S * of_steps
    return min(of_stamps, of_steps) if possible else of_stamps


def _largest(time: float, most_s: float) -> float:
    """The largest unit in which a time is at most so long."""
    unit = 1.0
    while time * unit > most_s and unit > LEAST_UNIT_S:
        unit *= 1e-3
    return unit


def _usual_step(recording: Recording, stamp: Callable[[Sweep], float]) -> float:
    """The usual time between two different stamps of a laser that are possible, in whatever order they are."""
    lasers = (np.array([stamp(sweep) for sweep in sweeps]) for sweeps in recording.by_laser().values())
    return min((_spacing(np.unique(t[abs(t) < LATEST_S / LEAST_UNIT_S])) for t in lasers), default=1.0)


def _usual_speed(recording: Recording) -> float:
    """m per unit of the stamps while the robot moves; 0 where it never does."""
    track = recording.odometry if recording.odometry.moves else carried(recording.sweeps)
    if len(track.t) < 2:
        return 0.0
    steps = np.hypot(*np.diff(np.array(track.poses)[:, :2], axis=0).T)
    times = np.diff(np.array(track.t, np.float64))
    moves = (steps > 0.0) & (times > 0.0) & np.isfinite(steps)
    return float(np.median(steps[moves] / times[moves])) if moves.any() else 0.0


def carried(sweeps: list[Sweep]) -> Track:
    """The poses of the sweeps that carry one."""
    found = [(sweep.t, sweep.T_odom_robot) for sweep in sweeps if sweep.T_odom_robot is not None]
    return Track([t for t, _ in found], [pose for _, pose in found])


def _take_order(recording: Recording) -> None:
    """Put the order of the file in place of all stamps."""
    recording.sweeps = [replace(sweep, t=sweep.order) for sweep in recording.sweeps]
    for track in (recording.odometry, recording.reference):
        track.t = list(track.order)


def _sorted_out(sweeps: list[Sweep], have_poses: bool, counts: Counter[str]) -> list[Sweep]:
    """Sweeps with ascending stamps: one that carries its pose keeps its place in the file, others out of order go."""
    stamps = _stamps(sweeps)
    rows = ascending_rows(stamps, equal=True)
    out = len(stamps) - len(rows)
    counts[OUT_OF_ORDER + (", placed by their lines" if have_poses else "")] += out
    if have_poses and len(rows):
        stamps, rows = _filled(stamps, rows), np.arange(len(stamps))
    sound = len(rows)
    rows = rows[~_repeats(sweeps, stamps, rows)]
    counts["scans that repeat the one before"] += sound - len(rows)
    counts["scans with the stamp of another"] += len(rows) - len(np.unique(stamps[rows]))
    t = _spread(stamps[rows])
    kept = np.diff(t, prepend=-np.inf) > 0.0
    return [replace(sweeps[row], t=at) for row, at in zip(rows[kept].tolist(), t[kept].tolist(), strict=True)]


def _filled(stamps: Array, rows: Ints) -> Array:
    """Stamps (n,) with those outside `rows` between their neighbours, or behind the last and before the first."""
    step = _spacing(stamps[rows])
    place = np.arange(len(stamps), dtype=np.float64)
    found = np.interp(place, rows, stamps[rows])
    found += step * (np.minimum(place - rows[0], 0.0) + np.maximum(place - rows[-1], 0.0))
    found[rows] = stamps[rows]
    return found


def _spacing(stamps: Array) -> float:
    """The usual time between two of them; 1 where there is none."""
    steps = np.diff(stamps)
    return float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0


def _repeats(sweeps: list[Sweep], stamps: Array, rows: Ints) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """True for each of the rows whose stamp and readings are those of the row before."""
    same = np.zeros(len(rows), np.bool_)
    for k in np.flatnonzero(np.diff(stamps[rows]) == 0.0).tolist():
        a, b = sweeps[rows[k]], sweeps[rows[k + 1]]
        same[k + 1] = np.array_equal(_numbers(a), _numbers(b), equal_nan=True)
    return same


def _numbers(sweep: Sweep) -> Array:
    """(k,) readings and poses; all sweeps of a laser carry the same poses."""
    poses = (pose for pose in (sweep.T_odom_robot, sweep.T_odom_laser) if pose is not None)
    return np.concatenate([sweep.ranges, *poses])


def _spread(stamps: Array) -> Array:
    """Stamps (n,) that do not descend, with equal ones spread evenly up to the next."""
    if not len(stamps):
        return stamps
    values, first, count = np.unique(stamps, return_index=True, return_counts=True)
    ends = np.append(values[1:], values[-1] + _spacing(values))
    place = np.arange(len(stamps)) - np.repeat(first, count)
    spread: Array = stamps + np.repeat((ends - values) / count, count) * place
    return np.maximum.accumulate(spread)
