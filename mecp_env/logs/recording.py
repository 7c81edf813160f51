"""What a reader finds in a file, before it is put in order."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mecp_env.core.array_types import Array


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


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One sweep as the file has it; poses only where the sweep carries them."""

    t: float  # s
    ranges: Array  # (B,) m
    geometry: Geometry
    T_odom_robot: Array | None = None  # (3,)
    T_odom_laser: Array | None = None  # (3,)

    def mirrored(self) -> Sweep:
        """The same readings of a laser that hangs upside down."""
        beams = self.geometry._replace(start_rad=-self.geometry.start_rad, step_rad=-self.geometry.step_rad)
        return replace(self, geometry=beams)


@dataclass(slots=True, eq=False)
class Track:
    """Stamped poses, in the order of the file."""

    t: list[float] = field(default_factory=list)  # s
    poses: list[Array] = field(default_factory=list)  # (3,) each

    def add(self, t: float, pose: Array) -> None:
        """Take in one pose."""
        self.t.append(t)
        self.poses.append(pose)


@dataclass(slots=True, eq=False)
class Recording:
    """Everything of use in a file."""

    name: str
    sweeps: list[Sweep] = field(default_factory=list)
    odometry: Track = field(default_factory=Track)
    reference: Track = field(default_factory=Track)
    relations: Array = field(default_factory=lambda: np.empty((0, 5)))
    T_robot_laser: Array | None = None  # (3,), None: the file does not say
    counts: Counter[str] = field(default_factory=Counter)
