"""The readings of one laser on its beams, with nan for all that measure nothing.

What a reader finds in a file, before it is put in order.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LogError
from mecp_env.core.se2 import wrapped

BASE_BYTES, FACTOR = 40 * 2**20, 16  # what may be made of a file: so much, and so many times its size
SWEEP_BYTES, POSE_BYTES = 800, 300  # of a sweep without its readings, and of a pose
UNEVEN = 0.25  # of a step, by which an angle may be off


@dataclass(slots=True, eq=False)
class Budget:
    """The bytes that may be made of a file: a small one that unpacks to gigabytes is refused."""

    most: int
    used: int = 0

    @classmethod
    def of(cls, size: int) -> Budget:
        """That of a file of so many bytes."""
        return cls(BASE_BYTES + FACTOR * size)

    def take(self, size: int) -> None:
        """Spend some of it. Raises `LogError` where it is used up."""
        self.used += size
        if self.used > self.most:
            mib = self.most // 2**20
            raise LogError(f"it makes more than {mib} MiB unpacked, too much for its size; save it without packing")


class Geometry(NamedTuple):
    """The beams of a sweep: beam i looks towards start + i * step."""

    beams: int
    start_rad: float
    step_rad: float  # below 0 where the laser turns clockwise
    min_range_m: float = 0.0
    max_range_m: float = np.inf  # inf: the log does not say

    @property
    def angles(self) -> Array:
        """(B,) rad, in the order of the readings."""
        return self.start_rad + self.step_rad * np.arange(self.beams, dtype=np.float64)

    @classmethod
    def even(cls, angles: Array, fault: str, unit_rad: float = 1.0, max_range_m: float = math.inf) -> Geometry:
        """That of angles (B,) in some unit, which may jump by a turn of rad or degrees.

        Raises `LogError` that says `fault` where they are not evenly spaced.
        """
        for turn in (math.inf, 2.0 * math.pi, 360.0):
            straight = angles if math.isinf(turn) else np.unwrap(angles, period=turn)
            even = np.linspace(straight[0], straight[-1], len(straight))
            if abs(straight - even).max() <= UNEVEN * abs(even[1] - even[0]):
                start, step = unit_rad * even[0], unit_rad * (even[1] - even[0])
                return cls(len(angles), float(start), float(step), 0.0, max_range_m)
        raise LogError(fault)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One sweep as the file has it; poses only where the sweep carries them."""

    t: float  # s
    ranges: Array  # (B,) m
    geometry: Geometry
    T_odom_robot: Array | None = None  # (3,)
    T_odom_laser: Array | None = None  # (3,)
    order: float = 0.0  # place in the file: number of the line or row, or the time in s when a bag received it
    laser: int = 0  # which of several lasers: a place in `Recording.mounts`

    def mirrored(self) -> Sweep:
        """The same readings of a laser that hangs upside down."""
        beams = self.geometry._replace(start_rad=-self.geometry.start_rad, step_rad=-self.geometry.step_rad)
        return replace(self, geometry=beams)

    def scaled(self, factor: float, middle: float) -> Sweep:
        """The sweep with readings times a factor, and limits, too, unless the largest is below the `middle` reading."""
        beams = self.geometry
        if middle <= beams.max_range_m:
            beams = beams._replace(min_range_m=factor * beams.min_range_m, max_range_m=factor * beams.max_range_m)
        return replace(self, ranges=factor * self.ranges, geometry=beams)


@dataclass(slots=True, eq=False)
class Track:
    """Stamped poses, in the order of the file."""

    t: list[float] = field(default_factory=list)  # s
    poses: list[Array] = field(default_factory=list)  # (3,) each
    order: list[float] = field(default_factory=list)  # as `Sweep.order`

    def add(self, t: float, pose: Array, order: float) -> None:
        """Take in one pose."""
        self.t.append(t)
        self.poses.append(pose)
        self.order.append(order)

    @property
    def moves(self) -> bool:
        """True where the poses are not all the same."""
        return len(self.poses) > 1 and bool(np.ptp(np.array(self.poses), axis=0).any())


@dataclass(slots=True, eq=False)
class Recording:
    """Everything of use in a file."""

    name: str
    sweeps: list[Sweep] = field(default_factory=list)
    odometry: Track = field(default_factory=Track)
    reference: Track = field(default_factory=Track)
    relations: Array = field(default_factory=lambda: np.empty((0, 5)))
    T_robot_laser: Array | None = None  # (3,), None: the file does not say
    view_assumed: bool = False  # the file does not say the field of view, and no option does
    mounts: list[Array] = field(default_factory=list)  # (3,) of each of several lasers, which are one scanner
    counts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)  # what a user should know of how the file was read
    budget: Budget = field(default_factory=lambda: Budget.of(0))

    def add(self, sweep: Sweep) -> None:
        """Take in one sweep. Raises `LogError` where the file makes too much."""
        self.budget.take(SWEEP_BYTES + 2 * sweep.ranges.nbytes)
        self.sweeps.append(sweep)

    def damaged(self, what: str, number: int, words: list[str]) -> None:
        """Count a line or row that cannot be read, and note the first."""
        if not self.counts[f"damaged {what}s"]:
            self.notes.append(f"{what} {number} is the first that is damaged: {' '.join(words[:4]):.60} ...")
        self.counts[f"damaged {what}s"] += 1

    def by_laser(self) -> dict[int, list[Sweep]]:
        """The sweeps of each laser that has any."""
        lasers = sorted({sweep.laser for sweep in self.sweeps})
        return {laser: [sweep for sweep in self.sweeps if sweep.laser == laser] for laser in lasers}


LONGEST_M = 1000.0  # no laser measures farther
NEAREST_M = 0.02  # nor nearer: such readings are codes of errors, as of Hokuyo lasers
LIMITS_M = (8.191, 16.0, 30.0, 32.0, 50.0, 80.0, 81.91)  # common readings of lasers where nothing returns
BELOW_LIMIT = 0.99  # of the largest range: from here on a reading is no return
FEWEST_BEAMS, NARROWEST_DEG, MOST_TURNS = 8, 10.0, 3.0
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
    recording.sweeps = [sweep.scaled(factor, middle) for sweep in recording.sweeps]


def clean(
    sweeps: list[Sweep], counts: Counter[str], budget: Budget, max_range_m: float | None, view_deg: float | None
) -> Readings:
    """The readings within a field of view; from `max_range_m` on they are no returns. Raises `LogError`."""
    geometry = _most_common(sweeps)
    order, bearings = _ascending(geometry, view_deg)
    if sum(sweep.ranges.size for sweep in sweeps) < len(sweeps) * len(order):  # many sweeps have fewer beams
        budget.take(8 * len(sweeps) * len(order))
    ranges = _on_beams(sweeps, geometry, order, counts)
    limit = max_range_m or _limit(ranges, geometry.max_range_m)
    _blank(ranges, limit, max(geometry.min_range_m, NEAREST_M), counts)
    _check_distances(ranges, limit, geometry.min_range_m)
    return Readings(ranges, bearings, limit)


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
    turns = beams * step / (2.0 * math.pi)
    if turns > MOST_TURNS:
        raise LogError(f"laser: {beams} beams {step:g} rad apart are {turns:.1f} turns, angles in rad expected")
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


def _on_beams(sweeps: list[Sweep], geometry: Geometry, order: Ints, counts: Counter[str]) -> Array:
    """(n,B) m of all sweeps: those of another geometry give each beam the nearest of theirs."""
    ranges, usual = np.empty((len(sweeps), len(order))), _rounded(geometry)
    for row, sweep in enumerate(sweeps):
        if _rounded(sweep.geometry) == usual:
            ranges[row] = sweep.ranges[order]
        else:
            counts["scans with other beams, resampled"] += 1
            ranges[row] = _resampled(sweep, geometry)[order]
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
    least = math.inf
    for place in range(len(values) - 1, max(len(values) - 1 - CODES, BELOW), -1):
        usual = float(np.median(times[place - BELOW : place]))
        if times[place] >= max(FEWEST_CODES, TIMES * usual):
            least = float(values[place])
    return least


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
