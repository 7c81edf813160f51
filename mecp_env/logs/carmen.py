"""CARMEN logs: one message a line (carmen.sourceforge.net/logger_playback.html), and what is read of each.

    PARAM name value
    ODOM x y theta tv rv accel, FLASER n [ranges] x y theta odom_x odom_y odom_theta
    RAWLASER1 type start fov resolution max_range accuracy remission_mode n [ranges] n [remissions]
    ROBOTLASER1 as RAWLASER1, then laser x y theta, robot x y theta, tv rv and two or three safety values
    TRUEPOS x y theta odom_x odom_y odom_theta

All but PARAM end with the stamp of the message, the host, and the stamp of the logger (which old logs leave out).
"""

from __future__ import annotations

import codecs
import gzip
import io
import math
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.core.settings import guess
from mecp_env.logs.recording import MOST_BEAMS, POSE_BYTES, Geometry, Recording, Sweep

MOST_BYTES = 2**30
PACKED, LONGEST_LINE = ".gz", 2**20
MAGIC = b"\x1f\x8b"  # of a packed file, whatever its name: browsers unpack files and keep the name
BASE_BYTES, FACTOR = 40 * 2**20, 12  # a packed file may unpack to so much, and so many times its size
NAMED = 5  # kinds of other lines that an error names
MOST_LINES = 10**6  # and one more for each byte of the file
OTHER_LASERS = {"RLASER", "LASER3", "LASER4", *(f"{kind}LASER{n}" for kind in ("RAW", "ROBOT") for n in "2345")}
LASERS = ("ROBOTLASER1", "FLASER", "RAWLASER1")  # the first are preferred
MOUNT = ("robot_frontlaser_offset", "robot_frontlaser_side_offset", "robot_frontlaser_angular_offset")
WIDE_DEG = {541: 270.0, 1081: 270.0, 682: 239.77, 683: 240.0}  # an FLASER line has no angles: these are no SICK LMS
OLD_TAIL, NEW_TAIL = 10, 11  # values behind the readings of a ROBOTLASER1 line: before and since remissions


@dataclass(slots=True, eq=False)
class CarmenLog:
    """What the lines so far have said."""

    recording: Recording
    field_of_view_deg: float | None  # of FLASER lines; None: by the number of beams
    kinds: list[str] = field(default_factory=list)  # of the sweeps
    mount: dict[str, float] = field(default_factory=dict)
    line: int = 0
    cut: bool = False  # this line has no end
    others: dict[str, None] = field(default_factory=dict)  # the first kinds of lines that are not read

    def read(self, number: int, line: bytes) -> None:
        """Take in one line, unless it is empty or a comment, or count it as damaged."""
        words = line.removeprefix(codecs.BOM_UTF8).decode("latin-1").split()
        if not words or words[0].startswith("#"):
            return
        self.line, self.cut = number, not line.endswith(b"\n")
        kind, counts = words[0], self.recording.counts
        try:
            if kind in READERS:
                READERS[kind](self, words)
            else:
                counts["lines of another laser" if kind in OTHER_LASERS else "lines of other messages"] += 1
                self.others |= {kind[:20]: None} if len(self.others) < NAMED else {}
        except LogError:
            raise
        except (ValueError, IndexError):
            self.recording.damaged("line", self.line, words)

    def param(self, words: list[str]) -> None:
        """A parameter of the robot; those of no use here may have any value."""
        if len(words) > 2 and words[1] in MOUNT:
            self.mount[words[1]] = _number(words[2])

    def pose(self, words: list[str]) -> None:
        """The robot's pose by its wheels, or the true one."""
        track = self.recording.odometry if words[0] == "ODOM" else self.recording.reference
        self.recording.take(POSE_BYTES)
        track.add(self.stamp(words, 7), _pose(words, 1), float(self.line))

    def stamp(self, words: list[str], at: int) -> float:
        """s; nan for a line without one, whose place in the file counts."""
        counts = self.recording.counts
        try:
            return _number(words[at])
        except (IndexError, ValueError):
            if self.cut and not counts["lines without a stamp"]:
                raise  # only the last line lacks one: it is cut short
            counts["lines without a stamp"] += 1
            return math.nan

    def laser(self, words: list[str]) -> None:
        """A sweep, but for RAWLASER1 with the poses of laser and robot; else with the place of the odometry before."""
        before, (ranges, tail, values) = self.recording.odometry.order, _parts(words)
        laser, robot = (_pose(tail, 0), _pose(tail, 3)) if values else (None, None)
        stamp = self.stamp(tail, values)
        geometry = self.spread(len(ranges)) if words[0] == "FLASER" else _geometry(words, len(ranges))
        order = float(self.line) if values or not before else before[-1]
        self.recording.add(Sweep(stamp, ranges, geometry, robot, laser, order=order))
        self.kinds.append(words[0])

    def spread(self, beams: int) -> Geometry:
        """That of an FLASER line: an odd number of beams reaches both ends of the view, an even one the first."""
        view = math.radians(self.field_of_view_deg or WIDE_DEG.get(beams, 180.0))
        return Geometry(beams, -0.5 * view, view / max(beams - beams % 2, 1))

    def found(self) -> str:
        """What there is, in words."""
        others = [f"the first of others: {', '.join(map(repr, self.others))}"] if self.others else []
        return ", ".join((f"{self.line} lines", *(f"{n} {what}" for what, n in self.recording.counts.items()), *others))


READERS: dict[str, Callable[[CarmenLog, list[str]], None]] = {
    "PARAM": CarmenLog.param,
    **dict.fromkeys(("ODOM", "TRUEPOS"), CarmenLog.pose),
    **dict.fromkeys(LASERS, CarmenLog.laser),
}


def read_carmen(path: Path, message: str | None = None, field_of_view_deg: float | None = None) -> Recording:
    """What is in a CARMEN log; `message` is the laser message to read. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, len(data))
    log = CarmenLog(recording, field_of_view_deg)
    for number, line in enumerate(lines_of(data, recording.counts), start=1):
        if number > MOST_LINES + len(data):
            raise LogError(f"it has more than {MOST_LINES + len(data)} lines, too many for its size; unpack it first")
        log.read(number, line)
    kind = _message(log, message)
    recording.counts["scans of another message"] += len(log.kinds) - log.kinds.count(kind)
    recording.sweeps = [sweep for sweep, its in zip(recording.sweeps, log.kinds, strict=True) if its == kind]
    recording.view_assumed = kind == "FLASER" and field_of_view_deg is None
    recording.T_robot_laser = np.array([log.mount.get(name, 0.0) for name in MOUNT]) if log.mount else None
    return recording


def lines_of(data: bytes, counts: Counter[str]) -> Iterator[bytes]:
    """The lines of a file, unpacked where it is packed; of one that is cut short, what there is. Raises `LogError`.

    A line that is longer than any message comes in pieces.
    """
    is_packed = data.startswith(MAGIC)
    data = data if is_packed or b"\n" in data else data.replace(b"\r", b"\n")
    left = most = BASE_BYTES + FACTOR * len(data)
    try:
        with gzip.open(io.BytesIO(data)) if is_packed else io.BytesIO(data) as file:
            for line in iter(partial(file.readline, LONGEST_LINE), b""):
                left -= len(line)
                if left < 0:
                    raise LogError(f"it has more than {most} bytes unpacked, too much for its size; unpack it first")
                yield line
    except (OSError, EOFError, zlib.error) as error:
        if left == most:
            raise LogError(f"no {PACKED} file, or damaged ({error!s:.80})") from None
        counts["packed file cut short or damaged"] += 1


def _message(log: CarmenLog, asked: str | None) -> str:
    """The laser message to read: as asked, or that with poses, unless it has less than half of the scans."""
    counts = {name: log.kinds.count(name) for name in LASERS}
    if asked is not None:
        if not counts.get(asked):
            there = ", ".join(f"{name} ({n})" for name, n in counts.items() if n) or "none"
            raise LogError(f"--scan-topic: no {asked!r:.40} in the log{guess(asked, counts)}; laser messages: {there}")
        return asked
    if not log.kinds:
        found = f"no laser: no line of {', '.join(counts)} that can be read ({log.found()})"
        raise LogError("; ".join((found, *log.recording.notes)))
    return next(name for name, n in counts.items() if 2 * n >= max(counts.values()))


def _number(word: str) -> float:
    """A finite number."""
    value = float(word)
    if not math.isfinite(value):
        raise ValueError
    return value


def _pose(words: list[str], at: int) -> Array:
    """(3,) x, y, heading from the words `at` and the two behind it."""
    x, y, heading = map(_number, words[at : at + 3])
    return np.array([x, y, heading])


def _count(word: str) -> int:
    """How many readings follow."""
    count = int(word)
    if not 0 <= count <= MOST_BEAMS:
        raise ValueError
    return count


def _parts(words: list[str]) -> tuple[Array, list[str], int]:
    """The readings (B,) of a line, the words behind them, and how many of these are before the stamp.

    A ROBOTLASER1 line has the old form, or the new one with remissions.
    """
    kind, at = words[0], 1 if words[0] == "FLASER" else 8
    count = _count(words[at])
    ranges, tail = np.array(words[at + 1 : at + 1 + count], np.float64), words[at + 1 + count :]
    values = {"FLASER": 6, "RAWLASER1": 0, "ROBOTLASER1": OLD_TAIL}[kind]
    if kind == "RAWLASER1" or (kind == "ROBOTLASER1" and len(tail) not in (OLD_TAIL, OLD_TAIL + 3)):
        tail, values = tail[1 + _count(tail[0]) :], NEW_TAIL if values else 0
    if not 2 <= count == len(ranges) or not values <= len(tail) <= values + 3:
        raise ValueError
    return ranges, tail, values


def _geometry(words: list[str], beams: int) -> Geometry:
    """That of a RAWLASER1 or ROBOTLASER1 line."""
    start, view, step, max_range = map(_number, words[2:6])
    return Geometry(beams, start, step or view / max(beams - 1, 1), 0.0, max_range if max_range > 0.0 else math.inf)
