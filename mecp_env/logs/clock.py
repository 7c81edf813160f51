"""The stamps of a recording: those of its messages, or the order of the file where they are of no use."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from itertools import chain

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import LogError
from mecp_env.logs.recording import Recording, Sweep

LATEST_S = 1e11  # no stamp is later: the year 5138
LEAST_UNIT_S = 2e-9  # the least unit of a stamp is ns
SLOWEST_S = 5.0  # from one scan to the next, usually; longer times are in ms, us or ns,
FASTEST_M_S = 5.0  # unless the robot were faster in such a unit: no robot is
DAY_S, DATES, SHORTEST_S = 86400.0, (3e4, 8e5), 1e-3  # dates of Excel and MATLAB count days; scans are not nearer
LATE_S = 0.3  # messages are received later than their stamps by times that differ by less
USEFUL_SHARE = 0.75  # of the stamps ascend, and
DISTINCT_SHARE = 0.02  # of them differ, at least; otherwise the order of the file counts
OUT_OF_ORDER, MOST_OUT = "scans with an impossible stamp, or out of order", 0.05  # of the scans, without a warning
OUT = (
    "warning: {} of {} scans are out of order by their stamps and left out: "
    "--clock received takes the order of the file (in a bag, the times of receipt)"
)
NOTES = {  # of a clock, where the order of the file counts
    "message": "stamps of the messages are equal, missing or not ascending: the order of the file counts",
    "received": "--clock received: the order of the file counts (in a bag, the times when messages were received)",
}


def set_stamps(recording: Recording, clock: str) -> None:
    """Give the sweeps of each laser ascending stamps, and poses those of the same clock, which is `message` or not.

    Raises `LogError` without any sweep.
    """
    _take_seconds(recording)
    counts, scans, lasers = recording.counts, len(recording.sweeps), recording.by_laser().values()
    have_poses = len(recording.carried().t) == scans
    useful = all(map(are_useful, map(_stamps, lasers))) and (have_poses or are_useful(np.array(recording.odometry.t)))
    if clock == "received" or not useful:
        _take_order(recording, NOTES[clock])
    counts["scans without a useful stamp, in the order of the file"] += (not useful) * scans
    recording.sweeps = list(chain.from_iterable(_sorted_out(sweeps, have_poses, recording) for sweeps in lasers))
    if not recording.sweeps:
        raise LogError(f"no scan that can be used ({recording.counted()})")
    if counts[OUT_OF_ORDER] > MOST_OUT * scans:
        recording.notes.append(OUT.format(counts[OUT_OF_ORDER], scans))


def note_delay(recording: Recording) -> None:
    """Note where scans and odometry of a bag are stamped by clocks that differ, as their times of receipt show."""
    scans, odometry = (np.array([(s.t, s.order) for s in recording.sweeps]).reshape(-1, 2), recording.odometry)
    both = [scans, np.column_stack((odometry.t, odometry.order))]
    if not all(len(times) and are_useful(times[:, 0]) for times in both):
        return
    late = [float(np.median(times[:, 1] - times[:, 0])) for times in both]
    if abs(late[1] - late[0]) > LATE_S:
        recording.notes.append(
            f"warning: by the times of receipt, the clocks of scans and odometry differ by {late[1] - late[0]:.2f} s: "
            "--clock received takes those times"
        )


def _stamps(sweeps: list[Sweep]) -> Array:
    return np.array([sweep.t for sweep in sweeps], np.float64)


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
    for sweep in recording.sweeps:
        sweep.t *= unit
    for track in (recording.odometry, recording.reference):
        track.t = [unit * t for t in track.t]
    recording.relations = recording.relations * (unit, unit, 1.0, 1.0, 1.0)


def _unit(recording: Recording) -> float:
    """Days, or s, ms, us or ns: the largest in which stamps are not too late, nor scans too far apart in time."""
    stamps = _stamps(recording.sweeps)
    stamps = stamps[np.isfinite(stamps)]
    middle = float(np.median(abs(stamps))) if len(stamps) else 0.0
    lasers = recording.by_laser().values()
    usual = _usual_step(map(_stamps, lasers))
    received = _usual_step(np.array([sweep.order for sweep in sweeps]) for sweeps in lasers)
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


def _usual_step(lasers: Iterable[Array]) -> float:
    """The usual time between two different stamps (n,) of a laser that are possible, in whatever order they are."""
    return min((_spacing(np.unique(t[abs(t) < LATEST_S / LEAST_UNIT_S])) for t in lasers), default=1.0)


def _usual_speed(recording: Recording) -> float:
    """m per unit of the stamps while the robot moves; 0 where it never does."""
    track = recording.odometry if recording.odometry.moves else recording.carried()
    if len(track.t) < 2:
        return 0.0
    steps = np.hypot(*np.diff(np.array(track.poses)[:, :2], axis=0).T)
    times = np.diff(np.array(track.t, np.float64))
    moves = (steps > 0.0) & (times > 0.0) & np.isfinite(steps)
    return float(np.median(steps[moves] / times[moves])) if moves.any() else 0.0


def _take_order(recording: Recording, note: str) -> None:
    """Put the order of the file in place of all stamps."""
    recording.notes.append(note)
    for sweep in recording.sweeps:
        sweep.t = sweep.order
    for track in (recording.odometry, recording.reference):
        track.t = list(track.order)


def _sorted_out(sweeps: list[Sweep], have_poses: bool, recording: Recording) -> list[Sweep]:
    """Sweeps with ascending stamps: one that carries its pose keeps its place in the file, others out of order go."""
    counts, stamps = recording.counts, _stamps(sweeps)
    rows = ascending_rows(stamps, equal=True)
    counts[OUT_OF_ORDER + (", placed by their lines" if have_poses else "")] += len(stamps) - len(rows)
    if have_poses:
        stamps, rows = _filled(stamps, rows), np.arange(len(stamps))
    repeats = _repeats(sweeps, stamps, rows)
    counts["scans that repeat the one before"] += int(repeats.sum())
    rows = rows[~repeats]
    counts["scans with the stamp of another"] += len(rows) - len(np.unique(stamps[rows]))
    t = _spread(stamps[rows])
    kept = np.diff(t, prepend=-np.inf) > 0.0
    found = [sweeps[row] for row in rows[kept].tolist()]
    for sweep, at in zip(found, t[kept].tolist(), strict=True):
        sweep.t = at
    return found


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


def _repeats(sweeps: list[Sweep], stamps: Array, rows: Ints) -> Bools:
    """True for each of the rows whose stamp, readings and poses are those of the row before."""
    same = np.zeros(len(rows), np.bool_)
    for k in np.flatnonzero(np.diff(stamps[rows]) == 0.0).tolist():
        a, b = (
            np.concatenate([s.ranges, *(pose for pose in (s.T_odom_robot, s.T_odom_laser) if pose is not None)])
            for s in (sweeps[rows[k]], sweeps[rows[k + 1]])
        )
        same[k + 1] = np.array_equal(a, b, equal_nan=True)
    return same


def _spread(stamps: Array) -> Array:
    """Stamps (n,) that do not descend, with equal ones spread evenly up to the next."""
    values, first, count = np.unique(stamps, return_index=True, return_counts=True)
    ends = np.append(values[1:], values[-1] + _spacing(values))
    place = np.arange(len(stamps)) - np.repeat(first, count)
    spread: Array = stamps + np.repeat((ends - values) / count, count) * place
    return np.maximum.accumulate(spread)
