"""What a reader finds in a file, as it is there: sweeps and stamped poses. What the file may make, and the options."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.settings import Settings

BASE_BYTES, FACTOR = 40 * 2**20, 16  # what may be made of a file: so much, and so many times its size
SWEEP_BYTES, POSE_BYTES = 800, 300  # of a sweep without its readings, and of a pose
MOST_BEAMS, FEWEST_BEAMS = 20_000, 8
UNEVEN = 0.25  # of a step, by which an angle may be off


class ReadOptions(Settings):
    """What a log does not say, or says wrongly."""

    scan_topic: str | tuple[str, ...] | None = None  # of a bag, several for several lasers that are merged; or the
    # laser message of a CARMEN log; None: the only one
    scan_frame: str | None = None  # of a bag whose scans have several frames: the one to read; None: all, merged
    odometry_topic: str | None = None  # of a bag; None: the only one
    max_range_m: float | None = Field(None, gt=0.0, le=1000.0)  # readings from here on are no return; None: by the log
    field_of_view_deg: float | None = Field(None, ge=10.0, le=360.0)  # beams outside are left out; FLASER lines have
    # no angles: their beams are spread over it
    mirror: bool = False  # the laser turns clockwise, or hangs upside down
    laser_yaw_deg: float = Field(0.0, ge=-180.0, le=180.0)  # added to the heading of the laser on the robot
    clock: Literal["message", "received"] = "message"  # or received: the order of the file, in a bag the times when
    # messages were received
    use_odometry: bool = True  # False: that of the log is left out

    @property
    def scan_topics(self) -> tuple[str, ...]:
        """All topics that are asked for."""
        return (self.scan_topic,) if isinstance(self.scan_topic, str) else self.scan_topic or ()


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


@dataclass(slots=True, eq=False)
class Sweep:
    """One sweep as the file has it; poses only where the sweep carries them."""

    t: float  # s
    ranges: Array  # (B,) m
    geometry: Geometry
    T_odom_robot: Array | None = None  # (3,)
    T_odom_laser: Array | None = None  # (3,)
    order: float = 0.0  # place in the file: number of the line or row, or the time in s when a bag received it
    laser: int = 0  # which of several lasers: a place in `Recording.mounts`

    def mirror(self) -> None:
        """Take the laser for one that hangs upside down."""
        start, step = -self.geometry.start_rad, -self.geometry.step_rad
        self.geometry = self.geometry._replace(start_rad=start, step_rad=step)


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
    size: int = 0  # bytes of the file
    made: int = 0  # bytes that are made of it
    sweeps: list[Sweep] = field(default_factory=list)
    odometry: Track = field(default_factory=Track)
    reference: Track = field(default_factory=Track)
    relations: Array = field(default_factory=lambda: np.empty((0, 5)))
    T_robot_laser: Array | None = None  # (3,), None: the file does not say
    view_assumed: bool = False  # the file does not say the field of view, and no option does
    mounts: list[Array] = field(default_factory=list)  # (3,) of each of several lasers, which are one scanner
    counts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)  # what a user should know of how the file was read

    @property
    def most(self) -> int:
        """The bytes that may be made of the file: a small one that unpacks to gigabytes is refused."""
        return BASE_BYTES + FACTOR * self.size

    def take(self, size: int) -> None:
        """Spend some of them. Raises `LogError` where they are used up."""
        self.made += size
        if self.made > self.most:
            mib = self.most // 2**20
            raise LogError(f"it makes more than {mib} MiB unpacked, too much for its size; save it without packing")

    def add(self, sweep: Sweep) -> None:
        """Take in one sweep. Raises `LogError` where the file makes too much."""
        self.take(SWEEP_BYTES + 2 * sweep.ranges.nbytes)
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

    def carried(self) -> Track:
        """The poses of the sweeps that carry one."""
        found = [(sweep.t, sweep.T_odom_robot) for sweep in self.sweeps if sweep.T_odom_robot is not None]
        return Track([t for t, _ in found], [pose for _, pose in found])

    def counted(self) -> str:
        """What has been counted so far, in words."""
        return ", ".join(f"{n} {what}" for what, n in (+self.counts).items()) or "nothing else is in it"
