"""A recorded log: scans on one clock, with odometry, reference path and relations where the file has them.

Logs as NumPy archives: t, ranges, angles, and ref, odo, rel, max_range_m, mount where there are any.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, overload

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.core.sensors import Scan
from mecp_env.logs.lasers import no_return_of, swallowed_of
from mecp_env.logs.recording import Geometry, Recording, Sweep, Track


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
    merged: bool = False  # of several lasers: beams that none of them covers have no return, and tell nothing
    view_assumed: bool = False  # neither the file nor an option says the field of view
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
        meaning = "unknown" if self.merged else no_return_of(self.ranges, self.step_rad, self.max_range_m)
        lost = {"no_return": meaning, "dark_dropout": swallowed_of(self.ranges, self.step_rad)}
        return {"field_of_view_deg": self.field_of_view_deg, **lost, **mount}


MOST_BYTES = 2**31  # of the file, and unpacked
SHAPES = {  # n scans of B beams
    "t": ("n",),
    "ranges": ("n", "B"),
    "angles": ("B",),
    "ref": ("n", 3),
    "odo": ("n", 3),
    "rel": ("k", 5),
    "max_range_m": (),
    "mount": (3,),
}
NEEDED = ("t", "ranges", "angles")
NO_NUMBERS = "cV"  # complex numbers and records


def read_archive(path: Path) -> Recording:
    """What is in an archive. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, len(data))
    arrays = _arrays(data, recording)
    _check_shapes(arrays)
    angles = arrays["angles"]
    if len(angles) < 2 or not np.isfinite(angles).all():
        raise LogError(f"angles: {len(angles)} finite numbers, at least 2 expected")
    limit = float(arrays.get("max_range_m", np.array(np.inf)))
    geometry = Geometry.even(angles, "angles: not evenly spaced", max_range_m=limit)
    stamps, rows = arrays["t"].tolist(), np.arange(len(arrays["t"]), dtype=np.float64).tolist()
    poses = list(arrays.get("odo", ())) or [None] * len(rows)
    for t, sweep, pose, row in zip(stamps, arrays["ranges"], poses, rows, strict=True):
        recording.add(Sweep(t, sweep, geometry, pose, order=row))
    if "ref" in arrays:
        recording.reference = Track(stamps, list(arrays["ref"]), rows)
    relations = arrays.get("rel", recording.relations)
    recording.relations = relations[np.isfinite(relations).all(axis=1)]
    recording.counts["damaged relations"] += len(relations) - len(recording.relations)
    recording.T_robot_laser = arrays.get("mount")
    return recording


def _arrays(data: bytes, recording: Recording) -> dict[str, Array]:
    """The arrays of known names, as numbers. Raises `LogError`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for member in archive.infolist():
                if member.filename.removesuffix(".npy") in SHAPES:
                    _check_size(archive, member, recording)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            _check_names(list(archive))
            return {name: np.array(archive[name], np.float64) for name in SHAPES if name in archive}
    except LogError:
        raise
    except Exception as error:  # damaged bytes may raise anything
        raise LogError(f"no NumPy archive, or damaged ({type(error).__name__}: {error!s:.80})") from None


def _check_names(names: list[str]) -> None:
    """Raise `LogError` where an array is missing."""
    if missing := [name for name in NEEDED if name not in names]:
        there = f"{', '.join(names):.120}" or "nothing"
        raise LogError(f"no {', '.join(missing)} in the archive, only {there} (expected: {', '.join(SHAPES)})")


def _check_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo, recording: Recording) -> None:
    """Spend what an array takes as it is and as numbers. Raises `LogError` before it is unpacked."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, kind = read(file)
    if kind.hasobject or kind.kind in NO_NUMBERS:
        raise LogError(f"{member.filename}: damaged, or of the type {kind!s:.40}, not numbers")
    counted_again = 8 if member.filename == "ranges.npy" else 0  # with the sweeps
    recording.take(math.prod(shape) * (max(kind.itemsize, 8) - counted_again))


def _check_shapes(arrays: dict[str, Array]) -> None:
    """Raise `LogError` for arrays of other shapes than `SHAPES`, whose letters stand for one length each."""
    lengths: dict[str, int] = {}
    for name, values in arrays.items():
        expected = SHAPES[name]
        fits = values.ndim == len(expected) and all(
            size == (lengths.setdefault(length, size) if isinstance(length, str) else length)
            for size, length in zip(values.shape, expected, strict=True)
        )
        if not fits:
            where = ", ".join(f"{letter} = {length}" for letter, length in lengths.items())
            shape = f"({', '.join(map(str, expected))})"
            raise LogError(f"{name}: shape {values.shape}, {shape} expected" + (f" with {where}" if where else ""))
