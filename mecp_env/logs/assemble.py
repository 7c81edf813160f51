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
from mecp_env.core.se2 import between
from mecp_env.logs.clock import set_stamps
from mecp_env.logs.lasers import one_scanner
from mecp_env.logs.log import Log
from mecp_env.logs.poses import FARTHEST_M, headings_in_radians, poses_at, sound, without_jumps
from mecp_env.logs.readings import Readings, clean, take_metres, take_radians
from mecp_env.logs.recording import ReadOptions, Recording, Track
from mecp_env.logs.registration import bridged, with_ends

GAP = 5.0  # medians between two scans
FIXED_M, FIXED_RAD = 0.02, 0.02  # by which a pose varies at most that is taken as fixed
FEW_SHARE = 0.5  # of the scans have odometry, at least; else the clocks may differ; and differ from the one before
BLIND_SHARE = 0.8  # of the readings measure nothing: more may have a wrong limit
REACH_M = 2.0  # no laser is mounted farther from the robot's centre
CENTRED = "the file has no mounting pose of the laser: it is calibrated, or else taken as centred (--config.sensor.x-m)"
WAY_OUT = "--clock received takes the order of the file in place of the stamps (in a bag, the times of receipt)"


def assemble(recording: Recording, options: ReadOptions) -> Log:
    """The log. Raises `LogError` where nothing is left."""
    counts, found = recording.counts, len(recording.sweeps)
    _prepare(recording, options)
    readings = _readings(recording, options)
    mount, reference = _mount(recording)
    mount[2] = math.remainder(mount[2] + math.radians(options.laser_yaw_deg), 2.0 * math.pi)
    t = np.array([sweep.t for sweep in recording.sweeps])
    odometry = _odometry(recording) if options.use_odometry else Track()
    T_odom, T_ref = poses_at(t, odometry, "odometry", counts), poses_at(t, reference, "reference pose", counts)
    kept = np.ones(len(t), bool) if T_odom is None else _with_odometry(recording, t, odometry, T_odom)
    if T_odom is not None:
        kept = kept & ~_hanging(recording, readings.ranges, T_odom)
    _note_blind(recording, readings)
    counts["gaps in time"] += _gaps(t[kept])
    log = Log(
        name=recording.name,
        t=t[kept],
        ranges=readings.ranges[slice(None) if kept.all() else kept],
        bearings=readings.bearings,
        max_range_m=readings.limit_m,
        T_robot_laser=mount,
        T_odom_robot=None if T_odom is None else without_jumps(t[kept], T_odom[kept], counts),
        T_ref_robot=None if T_ref is None else T_ref[kept],
        relations=recording.relations,
        counts=+counts,
        merged=bool(recording.mounts),
        view_assumed=recording.view_assumed,
        notes=tuple(recording.notes),
        found=found,
    )
    return bridged(log, sound(odometry)[0])


def _prepare(recording: Recording, options: ReadOptions) -> None:
    """Let the recording be as the options say, and its stamps, readings and angles in s, m and rad. Raises `LogError`.

    Poses of the sweeps that are all the same are left out where those between them move.
    """
    for sweep in recording.sweeps if options.mirror else ():
        sweep.mirror()
    if not options.use_odometry:
        recording.odometry = Track()
    if recording.odometry.moves and not recording.carried().moves:
        for sweep in recording.sweeps:
            sweep.T_odom_robot = sweep.T_odom_laser = None
    set_stamps(recording, options.clock)
    take_metres(recording)
    take_radians(recording)


def _readings(recording: Recording, options: ReadOptions) -> Readings:
    """Those of the only laser, or of several, whose sweeps then become those of one scanner. Raises `LogError`."""
    most, view = options.max_range_m, options.field_of_view_deg
    if not recording.mounts:
        return clean(recording, recording.sweeps, most, view)
    lasers = [
        (sweeps, clean(recording, sweeps, most, None), recording.mounts[laser])
        for laser, sweeps in recording.by_laser().items()
    ]
    recording.sweeps = one_scanner(lasers, recording.odometry, recording.counts)
    farthest = max(readings.limit_m + float(np.hypot(*mount[:2])) for _, readings, mount in lasers)
    uncounted = replace(recording, counts=Counter())  # beams that no laser covers are no readings without a return
    return clean(uncounted, recording.sweeps, farthest, view)


def _with_odometry(recording: Recording, t: Array, odometry: Track, T_odom: Array) -> Bools:
    """(n,) true for the scans that have odometry; a note where they are few. Raises `LogError` where none has."""
    kept = np.isfinite(T_odom[:, 0])
    if kept.mean() >= FEW_SHARE:
        return with_ends(t, T_odom, kept)
    if not (abs(np.array(odometry.poses)) < FARTHEST_M).all(axis=1).any():
        raise LogError(
            f"odometry: none of its {len(odometry.poses)} poses is finite and below {FARTHEST_M:g} m: "
            "--odometry none does without"
        )
    stamps = np.array([stamp for stamp in odometry.t if math.isfinite(stamp)] or [math.nan])
    spans = (
        f"{kept.sum()} of {len(t)} scans have odometry: scans from {t[0]:.3f} s to {t[-1]:.3f} s, "
        f"odometry from {stamps.min():.3f} s to {stamps.max():.3f} s; {WAY_OUT}, --odometry none does without"
    )
    if not kept.any():
        raise LogError(f"no scan with odometry: {spans} ({recording.counted()})")
    recording.notes.append(spans)
    return with_ends(t, T_odom, kept)


def _hanging(recording: Recording, ranges: Array, T_odom: Array) -> Bools:
    """(n,) the scans to leave out because the laser hung; where it did most of the time, a warning and none."""
    hanging = repeated(ranges, T_odom)
    count = int(hanging.sum())
    if count > FEW_SHARE * len(hanging):
        recording.notes.append(f"warning: {count} of {len(hanging)} scans equal the one before, though the robot moved")
        return np.zeros_like(hanging)
    recording.counts["scans that repeat the one before, though the robot moved, left out"] += count
    return hanging


def repeated(ranges: Array, T_odom: Array) -> Bools:
    """(n,) true for scans (n,B), two or more, that equal the one before, though the robot moved: the laser hangs."""
    equal = (ranges[1:] == ranges[:-1]) | (np.isnan(ranges[1:]) & np.isnan(ranges[:-1]))
    same = np.append(False, equal.all(axis=1))
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))
    x, y, heading = np.abs(between(T_odom[first], T_odom)).T
    moved: Bools = (np.hypot(x, y) > FIXED_M) | (heading > FIXED_RAD)
    return same & moved & (np.bincount(first)[first] > 2)


def _note_blind(recording: Recording, readings: Readings) -> None:
    """Note where nearly no reading measures anything: limits that the log states may be wrong."""
    blind = 1.0 - float(np.isfinite(readings.ranges).mean())
    if blind > BLIND_SHARE and not recording.mounts:
        least = recording.sweeps[0].geometry.min_range_m
        recording.notes.append(
            f"warning: {blind:.0%} of the readings measure nothing from {least:g} to {readings.limit_m:g} m: "
            "--max-range-m gives another limit than the log"
        )


def _odometry(recording: Recording) -> Track:
    """The poses that the sweeps carry, or those between them."""
    poses = recording.carried()
    track = poses if len(poses.t) == len(recording.sweeps) else recording.odometry
    return headings_in_radians(track, recording.notes)


def _mount(recording: Recording) -> tuple[Array, Track]:
    """The mounting pose (3,) of the laser, and the reference path.

    Where the poses of laser and robot differ by a constant, that is the mounting pose; otherwise the first has been
    corrected by another program, and serves as reference where the log has no other. Else the log states the mounting
    pose, or it is zero, with a note unless each of several lasers has one.
    """
    poses = [(s.T_odom_robot, s.T_odom_laser) for s in recording.sweeps if s.T_odom_laser is not None]
    stated, reference = recording.T_robot_laser, recording.reference
    if poses:
        T_robot, T_laser = np.moveaxis(np.array(poses, np.float64), 1, 0)
        middle, fixed = _middle(between(T_robot, T_laser))
        if fixed:
            stated = middle
        elif not reference.t:
            reference = Track(recording.carried().t, list(T_laser))
    elif stated is None and not recording.mounts:
        recording.notes.append(CENTRED)
    return np.zeros(3) if stated is None else _near(stated, recording.notes), reference


def _middle(offsets: Array) -> tuple[Array, bool]:
    """The median (3,) of poses (n,3), and whether most of them are there."""
    middle = np.median(offsets, axis=0)
    off = between(middle, offsets)
    fixed = (np.hypot(off[:, 0], off[:, 1]) < FIXED_M) & (abs(off[:, 2]) < FIXED_RAD)
    return middle, bool(2 * fixed.sum() > len(fixed))


def _near(T_robot_laser: Array, notes: list[str]) -> Array:
    """The mounting pose; zero, with a note, for one that is none."""
    x, y, heading = T_robot_laser.tolist()
    if (abs(T_robot_laser) <= (REACH_M, REACH_M, 2.0 * math.pi)).all():
        return np.array([x, y, math.remainder(heading, 2.0 * math.pi)])
    notes.append(
        f"warning: mounting pose {x:g} m, {y:g} m, {heading:g} rad: at most {REACH_M:g} m from the robot's centre and "
        "a turn expected; the laser is taken as centred (--config.sensor.x-m gives another)"
    )
    return np.zeros(3)


def _gaps(t: Array) -> int:
    """How many intervals of the stamps t (n,) are much longer than most."""
    steps = np.diff(t)
    return int((steps > GAP * np.median(steps)).sum()) if len(steps) else 0
