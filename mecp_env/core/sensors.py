"""What the sensors measure in one control step, the input of the estimator; and the laser that measures it.

Lengths are in metres, angles in radians counter-clockwise in (-pi, pi], float64. A laser that sweeps while the robot
drives gives one sweep per pose: `sweeps` is 1 but for the burst of the paper. Lasers that exist are fields of
`LaserConfig` and, in part, of `SensorModel` by name (sources: docs/sensors.md).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field

from mecp_env.core.carriers import Array, Bools, carrier
from mecp_env.core.errors import SensorError
from mecp_env.core.se2 import as_bearings, compose, inverse
from mecp_env.core.settings import Settings

SEEN_NEAR_M = 0.3  # even a weak laser sees what is as near
WIDEST_RAD = 3.0 * math.pi  # bearings of a turn are nearer to each other, whatever they count from
FARTHEST_M = 100.0  # half of the ranges of a scan are nearer
MOST_RANGE_M = 1000.0  # of a laser


class LaserView(Settings):
    """Field of view and mounting pose of a laser: physical data, not for tuning."""

    field_of_view_deg: float = Field(360.0, ge=10.0, le=360.0)  # centred on the laser's heading
    x_m: float = Field(0.0, ge=-2.0, le=2.0)  # of the laser in the robot's frame: ahead of its centre
    y_m: float = Field(0.0, ge=-2.0, le=2.0)  # to the left of it
    heading_deg: float = Field(0.0, ge=-180.0, le=180.0)  # counter-clockwise from straight ahead

    @cached_property
    def field_of_view_rad(self) -> float:
        """The field of view, in radians."""
        return math.radians(self.field_of_view_deg)

    @cached_property
    def is_centred(self) -> bool:
        """True when the laser's frame is the robot's."""
        return self.x_m == 0.0 and self.y_m == 0.0 and self.heading_deg == 0.0

    @property
    def T_robot_laser(self) -> Array:
        """(3,) m, rad: the pose of the laser in the robot's frame."""
        return np.array([self.x_m, self.y_m, math.radians(self.heading_deg)])


class LaserNoise(LaserView):
    """Also the noise of one beam (IV: sigma_r = 0.05 m, sigma_theta = 0.3 deg), and which beams do not return."""

    range_sigma_m: float = Field(0.05, ge=0.0, le=1.0)  # of a range, or
    range_sigma_share: float = Field(0.0, ge=0.0, le=0.5)  # this share of it, whichever is larger
    bearing_sigma_deg: float = Field(0.3, ge=0.0, le=5.0)
    grazing_deg: float = Field(90.0, gt=45.0, le=90.0)  # incidence (from the normal) beyond which nothing returns
    no_return: Literal["free", "unknown"] = "free"
    """What a beam without a return says: nothing is within the range, or (a weak laser) a wall may be there unseen."""
    dark_dropout: float = Field(0.0, ge=0.0, lt=1.0)  # share of the beams that does not return from a dark surface

    @property
    def free_without_return_m(self) -> float:
        """How far the floor is free along a beam that does not return, within the range of the laser."""
        return math.inf if self.no_return == "free" else SEEN_NEAR_M

    @property
    def bearing_sigma_rad(self) -> float:
        """The standard deviation of a bearing, in radians."""
        return math.radians(self.bearing_sigma_deg)


LASERS: dict[str, dict[str, Any]] = {
    "paper": {},  # IV: the defaults of the fields
    "ideal": {"range_sigma_m": 0.0, "bearing_sigma_deg": 0.0},
    "lms200": {  # SICK LMS 200, 80 m mode (cm), every 0.5 deg
        "field_of_view_deg": 180.0,
        "beams": 360,
        "sweeps": 1,
        "max_range_m": 80.0,
        "range_sigma_m": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 85.0,
        "x_m": 0.15,
    },
    "urg04lx": {  # Hokuyo URG-04LX
        "field_of_view_deg": 239.77,
        "beams": 682,
        "sweeps": 1,
        "max_range_m": 5.6,
        "range_sigma_m": 0.01,
        "range_sigma_share": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 80.0,
        "dark_share": 0.1,
        "dark_dropout": 0.2,
        "x_m": 0.15,
    },
    "utm30lx": {  # Hokuyo UTM-30LX
        "field_of_view_deg": 270.25,
        "beams": 1081,
        "sweeps": 1,
        "max_range_m": 30.0,
        "range_sigma_m": 0.01,
        "range_sigma_share": 0.001,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 85.0,
        "x_m": 0.15,
    },
    "rplidar_a1": {  # Slamtec RPLIDAR A1M8
        "beams": 360,
        "sweeps": 1,
        "max_range_m": 12.0,
        "range_sigma_m": 0.002,
        "range_sigma_share": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 80.0,
        "dark_share": 0.1,
        "dark_dropout": 0.2,
    },
}


SIDEWAYS_M = 1e-3  # a motion further from an arc than that is a turn, a drive and a turn


@carrier
class Scan:
    """A burst of K sweeps of B beams, all taken at the pose that ends the step (IV; dense scan of III-A.1)."""

    ranges: Array  # (K,B) m; max_range_m where nothing was hit
    bearings: Array  # (K,B) rad, robot frame, nominal, ascending in each sweep in (-pi, pi]
    hit: Bools  # (K,B)
    max_range_m: float

    @classmethod
    def of(cls, ranges: Any, bearings: Any, max_range_m: float, *, clockwise: bool = False) -> Self:
        """One sweep of ranges (B,) m at bearings (B,) rad in the laser's frame, of any order and any turn.

        Bearings may ascend or descend, and count from 0 to 2 pi; `clockwise` ones grow to the right. A range that is
        not finite, not positive, or not below `max_range_m` is no hit. Of beams at one bearing the first is kept.
        Raises `SensorError`.
        """
        r, given = np.asarray(ranges, np.float64), np.asarray(bearings, np.float64)
        if r.ndim != 1 or r.shape != given.shape or not len(r):
            raise SensorError(f"ranges, bearings: shapes {r.shape} and {given.shape}, both (B,) with B >= 1 expected")
        if not np.isfinite(given).all():
            raise SensorError("bearings: every value must be finite")
        if not 0.0 < max_range_m <= MOST_RANGE_M:
            raise SensorError(f"max_range_m: {max_range_m!r:.80}, above 0 and at most {MOST_RANGE_M:g} m expected")
        _check_units(r, given, max_range_m)
        angles, first = np.unique(as_bearings(-given if clockwise else given), return_index=True)
        hit = np.isfinite(r[first]) & (r[first] > 0.0) & (r[first] < max_range_m)
        return cls(np.where(hit, r[first], max_range_m)[None], angles[None], hit[None], float(max_range_m))


def _check_units(ranges: Array, bearings: Array, max_range_m: float) -> None:
    """Raise `SensorError` for bearings that can only be degrees, and for ranges that can only be mm or cm."""
    if np.ptp(bearings) > WIDEST_RAD:
        raise SensorError(f"bearings: from {bearings.min():g} to {bearings.max():g}, within a turn in rad expected")
    seen = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    middle = float(np.median(seen)) if len(seen) else 0.0
    if middle > max(FARTHEST_M, 2.0 * max_range_m):
        raise SensorError(f"ranges: half are above {middle:g}, m expected, up to max_range_m = {max_range_m:g}")


@carrier
class Odometry:
    """The body motion of one control step as measured: M arcs one after the other."""

    increments: Array  # (M,2) m, rad: distance along the mean heading of the arc, turn
    cov: Array  # (M,2,2) covariance of each increment
    bumper: bool  # the robot touched something in this step: it may have slipped sideways

    @classmethod
    def between(cls, T_odom_before: Any, T_odom_after: Any, noise: Any, *, bumper: bool = False) -> Self:
        """The motion between two poses (3,) x, y, heading (m, rad) of the robot in the frame of its odometry.

        `noise` (2,): standard deviations of distance (m) and turn (rad) of this motion. A motion that is no arc, as of
        a robot that moves sideways, becomes a turn, a drive and a turn. Raises `SensorError`.
        """
        before, after, sigmas = (np.asarray(v, np.float64) for v in (T_odom_before, T_odom_after, noise))
        if (before.shape, after.shape, sigmas.shape) != ((3,), (3,), (2,)) or not np.isfinite([*before, *after]).all():
            raise SensorError("T_odom_before, T_odom_after, noise: finite, of shapes (3,), (3,) and (2,), expected")
        if not (np.isfinite(sigmas).all() and (sigmas > 0.0).all()):
            raise SensorError(f"noise: {sigmas.tolist()}, two finite standard deviations above 0 expected")
        increments = _arcs(*compose(inverse(before), after).tolist())
        cov = np.diag(sigmas**2) / len(increments)
        return cls(increments, np.repeat(cov[None], len(increments), axis=0), bumper)


def _arcs(x: float, y: float, turn: float) -> Array:
    """(M,2) distance and turn of the arcs that lead to `x`, `y`, `turn` in the frame of the start."""
    cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
    if abs(cos * y - sin * x) <= SIDEWAYS_M:
        return np.array([(cos * x + sin * y, turn)])
    course = math.atan2(y, x)
    back = math.pi if abs(course) > 0.5 * math.pi else 0.0  # drive backwards rather than turn round
    course = math.remainder(course - back, 2.0 * math.pi)
    distance = math.hypot(x, y) * (-1.0 if back else 1.0)
    return np.array([(0.0, course), (distance, 0.0), (0.0, math.remainder(turn - course, 2.0 * math.pi))])
