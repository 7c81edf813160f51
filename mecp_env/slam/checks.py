"""Validation of scans, odometry and matches: a damaged log raises an error before it reaches the map.

Compiled functions do not check array bounds: untrusted input is checked here.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import MecpError
from mecp_env.core.errors import SensorError as SensorError
from mecp_env.core.jit import compiled
from mecp_env.core.sensors import MOST_RANGE_M, Odometry, Scan
from mecp_env.core.settings import shown
from mecp_env.core.snapshot_check import FAR
from mecp_env.slam.messages import NO_ID, Decision, Match

FLOATS = np.dtype(np.float64)
KINDS = {"ranges": FLOATS, "bearings": FLOATS, "hit": np.dtype(np.bool_)}
COLUMNS = {name: np.dtype(np.int64) for name in ("ids", "decision", "reason")} | {"nis": FLOATS}
ROUNDING = math.sqrt(np.finfo(np.float64).eps)  # of a product of variances, by which a covariance may be off
DECISIONS = frozenset(map(int, Decision))
WITH_ID = frozenset((int(Decision.LANDMARK), int(Decision.PROVISIONAL)))


class Fault(Enum):
    """What may be wrong with a scan, as a message says it."""

    NOT_FINITE = "scan.ranges, scan.bearings: every value must be finite"
    OUT_OF_RANGE = "scan.ranges: {low:g} to {high:g} m is not within 0 to max_range_m = {most:g} m"
    OUT_OF_ORDER = "scan.bearings: not ascending in (-pi, pi] in every sweep"


class MatchError(MecpError):
    """The match of an associator has columns of the wrong length or type, or an id that does not exist."""


def check_scan(scan: Scan, field_of_view_rad: float = 2.0 * math.pi) -> None:
    """Raise `SensorError` unless the scan is K sweeps of B beams, finite, within range and view, in order of bearing.

    Ranges and bearings are arrays of float64, hits of bool: the reader of a log converts other types.
    """
    _require_kind(scan, Scan, "scan: {}, a Scan expected")
    shape = _shape_of(scan.ranges, (1, 1))
    if len(shape) != 2 or 0 in shape:
        raise SensorError(f"scan.ranges: shape {shape} is not (K, B) with K, B >= 1")
    require_arrays(scan, KINDS, shape, "scan", SensorError)
    _check_range(scan.max_range_m)
    fault = find_fault(scan.ranges, scan.bearings, float(scan.max_range_m))
    if fault is not None:
        low, high = float(np.min(scan.ranges)), float(np.max(scan.ranges))
        raise SensorError(fault.value.format(low=low, high=high, most=scan.max_range_m))
    if field_of_view_rad < 2.0 * math.pi:
        _check_view(scan.bearings, 0.5 * field_of_view_rad)


def _require_kind(given: object, kind: type, said: str) -> None:
    """Raise `SensorError`, which says what was given, for anything but an object of that kind."""
    if not isinstance(given, kind):
        raise SensorError(said.format(type(given).__name__))


def _check_range(most: Any) -> None:
    """Raise `SensorError` for a range of the laser (m) that no laser has."""
    if not (isinstance(most, int | float | np.number) and 0.0 < most <= MOST_RANGE_M):
        raise SensorError(f"scan.max_range_m: {shown(most)}, above 0 and at most {MOST_RANGE_M:g} m expected")


def _check_view(bearings: Array, most: float) -> None:
    """Raise `SensorError` for bearings (K,B) farther than `most` (rad) from straight ahead."""
    widest = float(max(-bearings[:, 0].min(), bearings[:, -1].max()))
    if widest > most and not math.isclose(widest, most):
        given, bound = math.degrees(widest), math.degrees(most)
        raise SensorError(f"scan.bearings: up to {given:g} deg, at most {bound:g}, half of sensor.field_of_view_deg")


def find_fault(ranges: Array, bearings: Array, max_range: float) -> Fault | None:
    """The first fault of ranges and bearings (K,B) in the order of the beams, if there is one."""
    if is_sound(ranges, bearings, max_range):
        return None
    previous = np.column_stack((np.full(len(bearings), -math.inf), bearings[:, :-1]))
    faulty = {
        Fault.NOT_FINITE: ~(np.isfinite(ranges) & np.isfinite(bearings)),
        Fault.OUT_OF_RANGE: (ranges < 0.0) | (ranges > max_range),
        Fault.OUT_OF_ORDER: (bearings <= previous) | (abs(bearings) > math.pi),
    }
    first = {fault: int(beams.argmax()) for fault, beams in faulty.items() if beams.any()}
    return min(first, key=first.__getitem__, default=None)


@compiled
def is_sound(ranges: Array, bearings: Array, max_range: float) -> bool:
    """True when nothing is wrong with ranges and bearings (K,B); false, too, for an infinite range.

    The inner loops count without a branch, so that the compiler takes several beams at a time.
    """
    unsound = 0
    for k in range(ranges.shape[0]):
        sweep, before, after = ranges[k], bearings[k, :-1], bearings[k, 1:]
        for b in range(sweep.shape[0]):
            unsound += not ((sweep[b] >= 0.0) & (sweep[b] <= max_range))
        for b in range(before.shape[0]):
            unsound += not before[b] < after[b]
        unsound += not (bearings[k, 0] >= -math.pi and bearings[k, -1] <= math.pi)
    return unsound == 0 and max_range < math.inf


def check_odometry(odometry: Odometry) -> None:
    """Raise `SensorError` unless the reading is M increments with finite, symmetric, non-negative covariances.

    Increments and covariances are arrays of float64.
    """
    _require_kind(odometry, Odometry, "odometry: {}, an Odometry expected")
    shape = _shape_of(odometry.increments, (0, 2))
    if len(shape) != 2 or shape[1] != 2:
        raise SensorError(f"odometry.increments: shape {shape} is not (M, 2)")
    require_arrays(odometry, {"increments": FLOATS}, shape, "odometry", SensorError)
    require_arrays(odometry, {"cov": FLOATS}, (shape[0], 2, 2), "odometry", SensorError)
    if not isinstance(odometry.bumper, bool | np.bool_):
        raise SensorError(f"odometry.bumper: {shown(odometry.bumper)}, True or False expected")
    finite, largest, least, sound = look_over(odometry.increments, odometry.cov)
    if not finite:
        raise SensorError("odometry.increments, odometry.cov: every value must be finite")
    if largest >= FAR:
        raise SensorError(f"odometry.increments: {largest:g}, below {FAR} (m, rad) expected")
    if least < 0.0:
        raise SensorError(f"odometry.cov: variance {least:g} is below 0")
    if not sound:
        raise SensorError("odometry.cov: not symmetric, or not positive (a correlation of distance and turn beyond 1)")


@compiled
def look_over(increments: Array, cov: Array) -> tuple[bool, float, float, bool]:
    """Of increments (M,2) and covariances (M,2,2): are all finite, the largest and the least number, are all sound.

    A sound covariance is symmetric with a correlation of at most 1, up to rounding. The largest number is that of the
    increments, without its sign; the least is that of the variances, at most 0.
    """
    finite, largest, least, sound = True, 0.0, 0.0, True
    for m in range(cov.shape[0]):
        for i in range(2):
            finite &= math.isfinite(increments[m, i]) & math.isfinite(cov[m, i, 0]) & math.isfinite(cov[m, i, 1])
            largest, least = max(largest, abs(increments[m, i])), min(least, cov[m, i, i])
        size, upper, lower = cov[m, 0, 0] * cov[m, 1, 1], cov[m, 0, 1], cov[m, 1, 0]
        sound &= (upper - lower) ** 2 <= ROUNDING * size and upper * lower <= (1.0 + ROUNDING) * size
    return finite, largest, least, sound


def check_match(match: Match, corners: int, features: int) -> Match:
    """`match` itself. Raises `MatchError` unless it has a sound decision for each of so many corners.

    A corner that is LANDMARK or PROVISIONAL has an id below `features`, the number of ids that were given out; the
    others have none.
    """
    if not isinstance(match, Match):
        raise MatchError(f"match: {type(match).__name__}, a Match expected")
    require_arrays(match, COLUMNS, (corners,), "match", MatchError)
    for corner, (id_, decision) in enumerate(zip(match.ids.tolist(), match.decision.tolist(), strict=True)):
        if decision not in DECISIONS:
            raise MatchError(
                f"match.decision[{corner}]: {decision} is not a Decision, {min(DECISIONS)} to {max(DECISIONS)}"
            )
        if decision in WITH_ID and not 0 <= id_ < features:
            raise MatchError(f"match.ids[{corner}]: {id_}, one of the {features} ids given out expected, from 0")
        if decision not in WITH_ID and id_ != NO_ID:
            raise MatchError(
                f"match.ids[{corner}]: {id_}, {NO_ID} expected of a corner that is {Decision(decision).name}"
            )
    return match


def _shape_of(given: Any, otherwise: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of an array; for anything else, which `require_arrays` then refuses, one that is right."""
    return given.shape if isinstance(given, np.ndarray) else otherwise


def require_arrays(
    carrier: object, kinds: dict[str, np.dtype[Any]], shape: tuple[int, ...], what: str, error: type[MecpError]
) -> None:
    """Raise `error` unless the fields of `kinds` are arrays of that type and `shape`."""
    for name, kind in kinds.items():
        given = getattr(carrier, name)
        if not isinstance(given, np.ndarray):
            raise error(f"{what}.{name}: {type(given).__name__}, an array of {kind} expected")
        if given.dtype != kind:
            raise error(f"{what}.{name}: an array of {given.dtype}, one of {kind} expected")
        if given.shape != shape:
            raise error(f"{what}.{name}: shape {given.shape}, {shape} expected")
