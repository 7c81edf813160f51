"""A recorded log: scans on one clock, with odometry, reference path and relations where the file has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, overload

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.messages import Scan
from mecp_env.logs.no_return import no_return_of


@dataclass(frozen=True, slots=True, eq=False)
class LogRecord:
    """One scan of a log, and where odometry and reference say that it was taken."""

    t: float  # s
    scan: Scan
    T_odom_robot: Array | None  # (3,) m, rad
    T_ref_robot: Array | None  # (3,) m, rad


@dataclass(frozen=True, slots=True, eq=False)
class Log(Sequence[LogRecord]):
    """An immutable sequence of scans, each with the poses of its stamp."""

    name: str
    t: Array  # (n,) s, ascending, all different
    ranges: Array  # (n,B) m, below `max_range_m`; nan: no return
    bearings: Array  # (B,) rad, laser frame, ascending in (-pi, pi]
    max_range_m: float
    T_robot_laser: Array  # (3,) m, rad: mounting pose
    T_odom_robot: Array | None = None  # (n,3) m, rad
    T_ref_robot: Array | None = None  # (n,3) m, rad
    relations: Array = field(default_factory=lambda: np.empty((0, 5)))
    """(k,5) s, s, m, m, rad: two stamps, and the true pose at the second in the frame of the first."""
    counts: Mapping[str, int] = field(default_factory=dict)  # what was skipped or repaired -> how often
    notes: tuple[str, ...] = ()  # what a user should know of how the file was read
    found: int = 0  # scans in the file, of which this log has those that can be used; 0: not known

    def __post_init__(self) -> None:
        """Make all arrays and the counts read-only."""
        for values in (self.t, self.ranges, self.bearings, self.T_robot_laser, self.relations):
            values.setflags(write=False)
        for poses in (self.T_odom_robot, self.T_ref_robot):
            if poses is not None:
                poses.setflags(write=False)
        object.__setattr__(self, "counts", MappingProxyType(dict(self.counts)))

    def __len__(self) -> int:
        return len(self.t)

    @overload
    def __getitem__(self, index: int) -> LogRecord: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[LogRecord]: ...
    def __getitem__(self, index: int | slice) -> LogRecord | Sequence[LogRecord]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        odometry = None if self.T_odom_robot is None else self.T_odom_robot[index]
        reference = None if self.T_ref_robot is None else self.T_ref_robot[index]
        return LogRecord(float(self.t[index]), self.scan(index), odometry, reference)

    def scan(self, index: int) -> Scan:
        """The sweep of a record, as the estimator takes it."""
        ranges = self.ranges[index][None]
        hit = np.isfinite(ranges)
        return Scan(np.where(hit, ranges, self.max_range_m), self.bearings[None], hit, self.max_range_m)

    @property
    def step_rad(self) -> float:
        """The spacing of the beams."""
        return float(self.bearings[-1] - self.bearings[0]) / (len(self.bearings) - 1)

    @property
    def field_of_view_deg(self) -> float:
        """The field of view, centred on the laser's heading, in which all beams lie."""
        widest = 2.0 * math.degrees(float(abs(self.bearings[[0, -1]]).max()))
        return min(360.0, widest + 1e-9)

    def sensor(self) -> dict[str, Any]:
        """Geometry of the laser and meaning of its beams without a return: fields of the estimator's sensor model."""
        x, y, heading = self.T_robot_laser.tolist()
        mount = {"x_m": x, "y_m": y, "heading_deg": math.degrees(heading)}
        meaning = no_return_of(self.ranges, self.step_rad, self.max_range_m)
        return {"field_of_view_deg": self.field_of_view_deg, "no_return": meaning, **mount}
