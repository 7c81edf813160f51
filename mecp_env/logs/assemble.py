"""From what a reader found to a log: one geometry, ascending stamps, sound readings, a pose for each scan.

Whatever is skipped or repaired is counted; a few wrong stamps or readings are no reason to refuse a log.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between, chained, composed, interpolated
from mecp_env.logs.angles import FARTHEST_M, headings_in_radians, take_radians
from mecp_env.logs.clock import FASTEST_M_S, Clock, ascending_rows, carried, listed, set_stamps
from mecp_env.logs.lasers import one_scanner
from mecp_env.logs.log import Log
from mecp_env.logs.readings import Readings, Recording, Sweep, Track, clean, take_metres
from mecp_env.logs.registration import bridged, with_ends

GAP = 5.0  # medians between two scans
SLACK_M = 0.5  # a motion that is longer, and faster than a robot, is a jump of the odometry;
SPIKE, MOST_SPIKES = 5, 0.1  # samples that jump away and back again, at most, and their share of all;
USUAL = 0.95  # of the motions are shorter than those of which a robot is back
JUMPS = 3  # of them, and half of all motions: more are no odometry in m
FIXED_M, FIXED_RAD = 0.02, 0.02  # by which the pose of a laser that is fixed on the robot varies at most
FEW_SHARE = 0.5  # of the scans have odometry, at least; else the clocks may differ
BLIND_SHARE = 0.8  # of the readings measure nothing: more may have a wrong limit
REACH_M = 2.0  # no laser is mounted farther from the robot's centre
CENTRED = "the laser is taken as centred on the robot: the file has no mounting pose (--config.sensor.x-m gives one)"
WAY_OUT = "--clock received takes the order of the file in place of the stamps (in a bag, the times of receipt)"


def assemble(
    recording: Recording,
    max_range_m: float | None = None,
    field_of_view_deg: float | None = None,
    clock: Clock = "message",
    laser_yaw_deg: float = 0.0,
    use_odometry: bool = True,
) -> Log:
    """The log. Readings from `max_range_m` on are no returns; beams outside the field of view are left out.

    `clock`: whose stamps count; `laser_yaw_deg` is added to the heading of the laser on the robot. Odometry that is not
    used still tells the mounting pose from that of the laser.

    Raises `LogError` where nothing is left.
    """
    counts, found = recording.counts, len(recording.sweeps)
    _leave_out_still(recording)
    set_stamps(recording, clock)
    take_metres(recording)
    take_radians(recording)
    readings = _readings(recording, max_range_m, field_of_view_deg)
    sweeps = recording.sweeps
    mount, reference = _mount(recording, sweeps)
    mount[2] = math.remainder(mount[2] + math.radians(laser_yaw_deg), 2.0 * math.pi)
    t = np.array([sweep.t for sweep in sweeps])
    odometry = headings_in_radians(_odometry(recording, sweeps), recording.notes) if use_odometry else Track()
    T_odom, T_ref = _at(t, odometry, "odometry", counts), _at(t, reference, "reference pose", counts)
    kept = np.ones(len(t), bool) if T_odom is None else np.isfinite(T_odom[:, 0])
    _check_clocks(recording, t, odometry, kept)
    kept = kept if T_odom is None else with_ends(t, T_odom, kept)
    _note_blind(recording, readings)
    counts["gaps in time"] += _gaps(t[kept])
    ranges = readings.ranges if kept.all() else readings.ranges[kept]
    log = Log(
        *(recording.name, t[kept], ranges, readings.bearings, readings.limit_m, mount),
        *(
            None if T_odom is None else _without_jumps(t[kept], T_odom[kept], counts),
            None if T_ref is None else T_ref[kept],
        ),
        relations=recording.relations,
        counts=+counts,
        merged=bool(recording.mounts),
        view_assumed=recording.view_assumed,
        notes=tuple(recording.notes),
        found=found,
    )
    return bridged(log, _sound(odometry)[0])


def _readings(recording: Recording, max_range_m: float | None, view_deg: float | None) -> Readings:
    """Those of the only laser, or of several, whose sweeps then become those of one scanner. Raises `LogError`."""
    counts, budget = recording.counts, recording.budget
    if not recording.mounts:
        return clean(recording.sweeps, counts, budget, max_range_m, view_deg)
    groups = recording.by_laser()
    lasers = [(sweeps, clean(sweeps, counts, budget, max_range_m, None)) for sweeps in groups.values()]
    mounts = [recording.mounts[laser] for laser in groups]
    recording.sweeps = one_scanner(lasers, mounts, recording.odometry, counts)
    farthest = max(
        readings.limit_m + float(np.hypot(*mount[:2])) for (_, readings), mount in zip(lasers, mounts, strict=True)
    )
    unused = Counter[str]()  # beams that no laser covers are no readings without a return
    return clean(recording.sweeps, unused, budget, farthest, view_deg)


def _check_clocks(recording: Recording, t: Array, odometry: Track, kept: Bools) -> None:
    """Note where few scans have odometry, whose span of time is another. Raises `LogError` where none has."""
    if kept.mean() >= FEW_SHARE:
        return
    if not (abs(np.array(odometry.poses)) < FARTHEST_M).all(axis=1).any():
        raise LogError(
            f"odometry: none of its {len(odometry.poses)} poses is finite and below {FARTHEST_M:g} m: "
            "--odometry none does without"
        )
    sound = np.array([stamp for stamp in odometry.t if math.isfinite(stamp)] or [math.nan])
    spans = (
        f"{kept.sum()} of {len(t)} scans have odometry: scans from {t[0]:.3f} s to {t[-1]:.3f} s, "
        f"odometry from {sound.min():.3f} s to {sound.max():.3f} s; {WAY_OUT}, --odometry none does without"
    )
    if not kept.any():
        raise LogError(f"no scan with odometry: {spans} ({listed(recording)})")
    recording.notes.append(spans)


def _note_blind(recording: Recording, readings: Readings) -> None:
    """Note where nearly no reading measures anything: limits that the log states may be wrong."""
    blind = 1.0 - float(np.isfinite(readings.ranges).mean())
    if blind > BLIND_SHARE and not recording.mounts:
        least = recording.sweeps[0].geometry.min_range_m
        recording.notes.append(
            f"warning: {blind:.0%} of the readings measure nothing from {least:g} to {readings.limit_m:g} m: "
            "--max-range-m gives another limit than the log"
        )


def _leave_out_still(recording: Recording) -> None:
    """Leave out poses of the sweeps that are all the same, where those between them move."""
    if recording.odometry.moves and not carried(recording.sweeps).moves:
        recording.sweeps = [replace(sweep, T_odom_robot=None, T_odom_laser=None) for sweep in recording.sweeps]


def _odometry(recording: Recording, sweeps: list[Sweep]) -> Track:
    """The poses that the sweeps carry, or those between them."""
    poses = carried(sweeps)
    return poses if len(poses.t) == len(sweeps) else recording.odometry


def _mount(recording: Recording, sweeps: list[Sweep]) -> tuple[Array, Track]:
    """The mounting pose (3,) of the laser, and the reference path.

    Where the poses of laser and robot differ by a constant, that is the mounting pose; otherwise the first has been
    corrected by another program, and serves as reference where the log has no other.
    """
    pairs = [(s.T_odom_robot, s.T_odom_laser) for s in sweeps if s.T_odom_laser is not None]
    if not pairs:
        return _stated(recording, CENTRED), recording.reference
    T_robot, T_laser = (np.array(poses, np.float64) for poses in zip(*pairs, strict=True))
    middle, fixed = _middle(between(T_robot, T_laser))
    if fixed:
        return _near(middle, recording), recording.reference
    corrected = Track([sweep.t for sweep in sweeps], list(T_laser))
    return _stated(recording), recording.reference if recording.reference.t else corrected


def _stated(recording: Recording, *notes: str) -> Array:
    """The mounting pose (3,) that the log states; zero where it states none, with notes unless each laser has one."""
    if recording.T_robot_laser is not None:
        return _near(recording.T_robot_laser, recording)
    recording.notes += () if recording.mounts else notes
    return np.zeros(3)


def _middle(offsets: Array) -> tuple[Array, bool]:
    """The median (3,) of poses (n,3), and whether most of them are there."""
    middle = np.median(offsets, axis=0)
    off = between(middle, offsets)
    fixed = (np.hypot(off[:, 0], off[:, 1]) < FIXED_M) & (abs(off[:, 2]) < FIXED_RAD)
    return middle, bool(2 * fixed.sum() > len(fixed))


def _near(T_robot_laser: Array, recording: Recording) -> Array:
    """The mounting pose; zero, with a note, for one that is none."""
    if (abs(T_robot_laser) <= (REACH_M, REACH_M, 2.0 * math.pi)).all():
        return np.array([*T_robot_laser[:2], math.remainder(float(T_robot_laser[2]), 2.0 * math.pi)])
    x, y, heading = T_robot_laser.tolist()
    recording.notes.append(
        f"warning: mounting pose {x:g} m, {y:g} m, {heading:g} rad: at most {REACH_M:g} m from the robot's centre and "
        "a turn expected; the laser is taken as centred (--config.sensor.x-m gives another)"
    )
    return np.zeros(3)


def _at(t: Array, track: Track, what: str, counts: Counter[str]) -> Array | None:
    """(n,3) the poses of a track at the stamps t (n,), nan where it has none; None for an empty track."""
    if not track.t:
        return None
    stamps, poses = _sound(track)
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


def _sound(track: Track) -> tuple[Array, Array]:
    """The stamps (m,) and poses (m,3) of the samples that are finite and in order."""
    stamps, poses = np.array(track.t, np.float64), np.array(track.poses, np.float64).reshape(-1, 3)
    rows = np.flatnonzero((abs(poses) < FARTHEST_M).all(axis=1))
    rows = rows[ascending_rows(stamps[rows])]
    return stamps[rows], poses[rows]


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
            away[row + 1 : _back(poses, row, usual_m)] = True
    return away if away.sum() <= MOST_SPIKES * len(away) else np.zeros_like(away)


def _back(poses: Array, row: int, usual_m: float) -> int:
    """The first pose soon after the next one that is near that of a row; the next one where there is none."""
    for after in range(row + 2, min(row + SPIKE + 2, len(poses))):
        if math.dist(poses[row, :2], poses[after, :2]) < SLACK_M + usual_m * (after - row):
            return after
    return row + 1


def _lengths(poses: Array) -> Array:
    """(m-1,) m from each of the poses (m,3) to the next."""
    lengths: Array = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    return lengths


def _are_jumps(stamps: Array, poses: Array) -> Bools:
    """(m-1,) true where a robot would be too fast from one of the poses (m,3) to the next."""
    jumps: Bools = _lengths(poses) > SLACK_M + FASTEST_M_S * np.diff(stamps)
    return jumps


def _without_jumps(t: Array, T_odom_robot: Array, counts: Counter[str]) -> Array:
    """The poses (n,3) without jumps: a robot whose odometry was set to another pose has not moved.

    Raises `LogError` where half of the motions are jumps.
    """
    steps = between(T_odom_robot[:-1], T_odom_robot[1:])
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    jumps, moves = _are_jumps(t, T_odom_robot), int((lengths > FIXED_M).sum())
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


def _gaps(t: Array) -> int:
    """How many intervals of the stamps t (n,) are much longer than most."""
    steps = np.diff(t)
    return int((steps > GAP * np.median(steps)).sum()) if len(steps) else 0
