"""The readings of one laser on its beams: in m and rad, with nan for all that measure nothing."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LogError
from mecp_env.core.se2 import wrapped
from mecp_env.logs.recording import FEWEST_BEAMS, Geometry, Recording, Sweep

NARROWEST_DEG, MOST_TURNS = 10.0, 3.0
TURN_RAD, TURN_DEG = 2.0 * math.pi, 360.0
MOST_START_RAD = 2.0 * TURN_RAD  # of the first bearing
LONGEST_M = 1000.0  # no laser measures farther
NEAREST_M = 0.02  # nor nearer: such readings are codes of errors, as of Hokuyo lasers
LIMITS_M = (8.191, 16.0, 30.0, 32.0, 50.0, 80.0, 81.91)  # common readings of lasers where nothing returns
BELOW_LIMIT = 0.99  # of the largest range: from here on a reading is no return
USUAL_M = 100.0  # half of the readings that differ are nearer: farther ones are in mm or cm,
FARTHEST_CM, NEARLY_ALL = 2000.0, 0.95  # in cm where nearly all of them are within a building
MOST_ASKED = 1000  # sweeps that tell the unit of their readings
SAMPLE = 2_000_000  # readings that are searched for codes, at most
CODES, BELOW = 16, 20  # distinct readings at the top that may be codes, each compared with so many below
FEWEST_CODES, TIMES = 5, 5.0  # a code comes at least so often, and so many times as often as readings below


class Readings(NamedTuple):
    """What the sweeps of a laser measure."""

    ranges: Array  # (n,B) m, nan: no return
    bearings: Array  # (B,) rad, ascending in (-pi, pi]
    limit_m: float  # all readings are below


def take_metres(recording: Recording) -> None:
    """Take readings that no laser has in m for mm or cm, with the limits of the laser that are as large.

    Readings that differ count once each, so that a code for no return, however often it comes, does not decide.
    """
    asked = recording.sweeps[:: 1 + len(recording.sweeps) // MOST_ASKED]
    values = np.unique(np.concatenate([sweep.ranges for sweep in asked] or [np.zeros(0)]))
    values = values[np.isfinite(values) & (values > 0.0)]
    middle, most = np.quantile(values, (0.5, NEARLY_ALL)).tolist() if len(values) else (0.0, 0.0)
    if middle <= USUAL_M:
        return
    unit, factor = ("cm", 1e-2) if most < FARTHEST_CM else ("mm", 1e-3)
    recording.notes.append(f"readings are taken for {unit}: half of them are above {middle:.0f}")
    for sweep in recording.sweeps:
        beams, sweep.ranges = sweep.geometry, factor * sweep.ranges
        if middle <= beams.max_range_m:  # else the limits are in m
            least, most = factor * beams.min_range_m, factor * beams.max_range_m
            sweep.geometry = beams._replace(min_range_m=least, max_range_m=most)


def take_radians(recording: Recording) -> None:
    """Take angles of the laser that are too large for rad as degrees, with a note."""
    fits = {geometry: _in_radians(geometry) for geometry in dict.fromkeys(s.geometry for s in recording.sweeps)}
    if first := next((geometry for geometry, fit in fits.items() if fit != geometry), None):
        recording.notes.append(
            f"warning: the angles of the laser are taken as degrees: {first.beams} beams {first.step_rad:g} apart from "
            f"{first.start_rad:g} on are not within {MOST_TURNS:g} turns in rad"
        )
    for sweep in recording.sweeps:
        sweep.geometry = fits[sweep.geometry]


def _in_radians(geometry: Geometry) -> Geometry:
    """The geometry with the degrees of its first bearing, or of that and the spacing, made rad; itself without any."""
    start, step = geometry.start_rad, geometry.step_rad
    view = geometry.beams * abs(step)
    if view / TURN_RAD > MOST_TURNS and view <= MOST_TURNS * TURN_DEG:
        return geometry._replace(start_rad=math.radians(start), step_rad=math.radians(step))
    if view / TURN_RAD <= MOST_TURNS and MOST_START_RAD < abs(start) <= TURN_DEG:
        return geometry._replace(start_rad=math.radians(start))
    return geometry


def clean(recording: Recording, sweeps: list[Sweep], max_range_m: float | None, view_deg: float | None) -> Readings:
    """The readings within a field of view; from `max_range_m` on they are no returns. Raises `LogError`."""
    rounded = [_rounded(sweep.geometry) for sweep in sweeps]
    usual = Counter(rounded).most_common(1)[0][0]
    geometry = sweeps[rounded.index(usual)].geometry
    order, bearings = _ascending(geometry, view_deg)
    if sum(sweep.ranges.size for sweep in sweeps) < len(sweeps) * len(order):  # many sweeps have fewer beams
        recording.take(8 * len(sweeps) * len(order))
    ranges = np.empty((len(sweeps), len(order)))
    for row, sweep in enumerate(sweeps):
        ranges[row] = (sweep.ranges if rounded[row] == usual else _resampled(sweep, geometry))[order]
    recording.counts["scans with other beams, resampled"] += len(sweeps) - rounded.count(usual)
    limit = max_range_m or _limit(ranges, geometry.max_range_m)
    _blank(ranges, limit, max(geometry.min_range_m, NEAREST_M), recording.counts)
    _check_distances(ranges, limit, geometry.min_range_m)
    return Readings(ranges, bearings, limit)


def _rounded(geometry: Geometry) -> Geometry:
    """The same for all sweeps of a laser, whatever the last digits are."""
    return geometry._replace(start_rad=round(geometry.start_rad, 4), step_rad=round(geometry.step_rad, 6))


def _ascending(geometry: Geometry, field_of_view_deg: float | None) -> tuple[Ints, Array]:
    """The readings that are used (B,), and their bearings (B,) rad, ascending. Raises `LogError`."""
    beams, step = geometry.beams, abs(geometry.step_rad)
    if not 0.0 < beams * step < math.inf:
        raise LogError(f"laser: {beams} beams {geometry.step_rad:g} rad apart")
    turns = beams * step / TURN_RAD
    if turns > MOST_TURNS:
        raise LogError(f"laser: {beams} beams {step:g} rad apart are {turns:.1f} turns, angles in rad expected")
    once = wrapped(geometry.angles[: round(TURN_RAD / step)])  # the last beam of a circle may repeat the first
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


def _resampled(sweep: Sweep, geometry: Geometry) -> Array:
    """(B,) m at the bearings of a geometry, the nearest of a sweep with another; nan where it has none in a step."""
    step = sweep.geometry.step_rad or math.inf
    place = wrapped(geometry.angles - sweep.geometry.start_rad) / step
    place = np.where(place < -0.5, place + TURN_RAD / abs(step), place)  # behind the first beam: the other way
    beam = np.rint(place).clip(-1, sweep.geometry.beams).astype(np.int64)
    there = (beam >= 0) & (beam < sweep.geometry.beams)
    return np.where(there, sweep.ranges[np.where(there, beam, 0)], np.nan)


def _limit(ranges: Array, stated: float) -> float:
    """m from which on a reading is no return: a code, or by the log, a common limit, or the largest reading."""
    values, times = np.unique(_sample(ranges), return_counts=True)
    if not len(values):
        raise LogError(f"laser: no reading above 0 and up to {LONGEST_M:g} m")
    code, top = _least_code(values, times), float(values[-1])
    if 0.0 < stated <= LONGEST_M:
        return min(code, BELOW_LIMIT * stated)
    near = [limit for limit in LIMITS_M if BELOW_LIMIT * limit <= top <= 1.001 * limit]
    return min(code, BELOW_LIMIT * near[0] if near else float(np.nextafter(top, math.inf)))


def _sample(ranges: Array) -> Array:
    """(m,) some of the readings that measure something: all, or those of every so many sweeps."""
    some = ranges[:: 1 + ranges.size // SAMPLE]
    return some[(some > 0.0) & (some <= LONGEST_M)]


def _least_code(values: Array, times: Ints) -> float:
    """The least of the readings at the top that repeat exactly, as a device reports where nothing returns.

    `values` (v,) ascend, `times` (v,) is how often each comes; infinity where there is no code.
    """
    for place in range(max(len(values) - 1 - CODES, BELOW) + 1, len(values)):
        if times[place] >= max(FEWEST_CODES, TIMES * float(np.median(times[place - BELOW : place]))):
            return float(values[place])
    return math.inf


def _blank(ranges: Array, limit: float, least: float, counts: Counter[str]) -> None:
    """Put nan for all readings (n,B) that measure nothing."""
    near = (ranges <= 0.0) | (ranges < least)
    far = ~near & ~(ranges < limit)
    counts["readings below the least range"] += int(near.sum())
    counts["readings without a return"] += int(far.sum())
    ranges[near | far] = np.nan


def _check_distances(ranges: Array, limit: float, least: float) -> None:
    """Raise `LogError` where no reading (n,B) measures anything, or where readings are not in m."""
    some = _sample(ranges)
    if not len(some):
        raise LogError(f"laser: no reading from {least:g} to {limit:g} m, ranges and their limits in m expected")
    middle = float(np.median(some))
    if middle > USUAL_M:
        raise LogError(f"laser: half of the readings are beyond {middle:.0f} m, at most {USUAL_M:g} m expected")
