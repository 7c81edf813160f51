"""What a reader finds in a file, before it is put in order."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.errors import LogError

BASE_BYTES, FACTOR = 40 * 2**20, 16  # what may be made of a file: so much, and so many times its size
SWEEP_BYTES, POSE_BYTES = 800, 300  # of a sweep without its readings, and of a pose


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


@dataclass(slots=True, eq=False)
class Recording:
    """Everything of use in a file."""

    name: str
    sweeps: list[Sweep] = field(default_factory=list)
    odometry: Track = field(default_factory=Track)
    reference: Track = field(default_factory=Track)
    relations: Array = field(default_factory=lambda: np.empty((0, 5)))
    T_robot_laser: Array | None = None  # (3,), None: the file does not say
    mounts: list[Array] = field(default_factory=list)  # (3,) of each of several lasers, which are one scanner
    counts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)  # what a user should know of how the file was read
    budget: Budget = field(default_factory=lambda: Budget.of(0))

    def add(self, sweep: Sweep) -> None:
        """Take in one sweep. Raises `LogError` where the file makes too much."""
        self.budget.take(SWEEP_BYTES + 2 * sweep.ranges.nbytes)
        self.sweeps.append(sweep)
