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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.core.settings import guess
from mecp_env.logs.readings import POSE_BYTES, SWEEP_BYTES, Budget, Geometry, Recording, Sweep, Track

MOST_BYTES = 2**30
PACKED, PIECE, LONGEST_LINE = ".gz", 2**14, 2**20
MAGIC = b"\x1f\x8b"  # of a packed file, whatever its name: browsers unpack files and keep the name
BASE_BYTES, FACTOR = 40 * 2**20, 12  # a packed file may unpack to so much, and so many times its size
MOST_BEAMS = 20_000
NAMED = 5  # kinds of other lines that an error names
MOST_LINES = 10**6  # and one more for each byte of the file
OTHER_LASERS = {"RLASER", "LASER3", "LASER4", *(f"{kind}LASER{n}" for kind in ("RAW", "ROBOT") for n in "2345")}
MOUNT = ("robot_frontlaser_offset", "robot_frontlaser_side_offset", "robot_frontlaser_angular_offset")
WIDE_DEG = {541: 270.0, 1081: 270.0, 682: 239.77, 683: 240.0}  # an FLASER line has no angles: these are no SICK LMS
OLD_TAIL, NEW_TAIL = 10, 11  # values behind the readings of a ROBOTLASER1 line: before and since remissions


@dataclass(slots=True, eq=False)
class CarmenLog:
    """What the lines so far have said."""

    recording: Recording  # but for its sweeps
    field_of_view_deg: float | None  # of FLASER lines; None: by the number of beams
    sweeps: dict[str, list[Sweep]] = field(default_factory=lambda: {"ROBOTLASER1": [], "FLASER": [], "RAWLASER1": []})
    mount: dict[str, float] = field(default_factory=dict)
    line: int = 0
    cut: bool = False  # this line has no end
    others: dict[str, None] = field(default_factory=dict)  # the first kinds of lines that are not read

    @property
    def counts(self) -> Counter[str]:
        return self.recording.counts

    def read(self, words: list[str]) -> None:
        """Take in one line that is neither empty nor a comment, or count it as damaged."""
        try:
            if words[0] in READERS:
                READERS[words[0]](self, words)
            else:
                self.counts["lines of another laser" if words[0] in OTHER_LASERS else "lines of other messages"] += 1
                self.others |= {words[0][:20]: None} if len(self.others) < NAMED else {}
        except LogError:
            raise
        except (ValueError, IndexError):
            self.recording.damaged("line", self.line, words)

    def param(self, words: list[str]) -> None:
        """A parameter of the robot; those of no use here may have any value."""
        if len(words) > 2 and words[1] in MOUNT:
            self.mount[words[1]] = _number(words[2])

    def odom(self, words: list[str]) -> None:
        """The robot's pose by its wheels."""
        self.pose(self.recording.odometry, words)

    def truepos(self, words: list[str]) -> None:
        """The robot's true pose."""
        self.pose(self.recording.reference, words)

    def pose(self, track: Track, words: list[str]) -> None:
        """A pose of a track."""
        self.recording.budget.take(POSE_BYTES)
        track.add(self.stamp(words, 7), _pose(words, 1), float(self.line))

    def stamp(self, words: list[str], at: int) -> float:
        """s; nan for a line without one, whose place in the file counts."""
        try:
            return _number(words[at])
        except (IndexError, ValueError):
            if self.cut and not self.counts["lines without a stamp"]:
                raise  # only the last line lacks one: it is cut short
            self.counts["lines without a stamp"] += 1
            return math.nan

    def sweep(self, kind: str, t: float, ranges: Array, geometry: Geometry, poses: Sequence[Array] = ()) -> None:
        """Keep a sweep; the poses are those of laser and robot. One without has the place of the odometry before it."""
        if len(ranges) < 2:
            raise ValueError
        self.recording.budget.take(SWEEP_BYTES + 2 * ranges.nbytes)
        laser, robot = poses or (None, None)
        before = self.recording.odometry.order
        order = float(self.line) if poses or not before else before[-1]
        self.sweeps[kind].append(Sweep(t, ranges, geometry, robot, laser, order=order))

    def flaser(self, words: list[str]) -> None:
        """A sweep with the poses of laser and robot."""
        ranges, tail = _readings(words, 1)
        geometry = _plain_geometry(len(ranges), self.field_of_view_deg)
        if len(tail) > 9:
            raise ValueError
        poses = _pose(tail, 0), _pose(tail, 3)
        self.sweep("FLASER", self.stamp(tail, 6), ranges, geometry, poses)

    def rawlaser(self, words: list[str]) -> None:
        """A sweep without a pose."""
        ranges, tail = _readings(words, 8)
        tail = tail[1 + _count(tail[0]) :]
        if len(tail) > 3:
            raise ValueError
        self.sweep("RAWLASER1", self.stamp(tail, 0), ranges, _geometry(words, len(ranges)))

    def robotlaser(self, words: list[str]) -> None:
        """A sweep with the poses of laser and robot, in the old or the new form."""
        ranges, tail = _readings(words, 8)
        values = OLD_TAIL
        if len(tail) not in (OLD_TAIL, OLD_TAIL + 3):
            tail, values = tail[1 + _count(tail[0]) :], NEW_TAIL
        if not values <= len(tail) <= values + 3:
            raise ValueError
        poses = _pose(tail, 0), _pose(tail, 3)
        self.sweep("ROBOTLASER1", self.stamp(tail, values), ranges, _geometry(words, len(ranges)), poses)


READERS: dict[str, Callable[[CarmenLog, list[str]], None]] = {
    "PARAM": CarmenLog.param,
    "ODOM": CarmenLog.odom,
    "TRUEPOS": CarmenLog.truepos,
    "FLASER": CarmenLog.flaser,
    "RAWLASER1": CarmenLog.rawlaser,
    "ROBOTLASER1": CarmenLog.robotlaser,
}


def read_carmen(path: Path, message: str | None = None, field_of_view_deg: float | None = None) -> Recording:
    """What is in a CARMEN log; `message` is the laser message to read. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    recording = Recording(path.name, budget=Budget.of(len(data)))
    log = CarmenLog(recording, field_of_view_deg)
    for number, is_cut, words in _lines(data, data.startswith(MAGIC), log.counts):
        if number > MOST_LINES + len(data):
            raise LogError(f"it has more than {MOST_LINES + len(data)} lines, too many for its size; unpack it first")
        log.line, log.cut = number, is_cut
        log.read(words)
    kind = _message(log, message)
    recording.sweeps = log.sweeps.pop(kind)
    recording.view_assumed = kind == "FLASER" and field_of_view_deg is None
    recording.counts["scans of another message"] += sum(map(len, log.sweeps.values()))
    recording.T_robot_laser = np.array([log.mount.get(name, 0.0) for name in MOUNT]) if log.mount else None
    return replace(recording, counts=+recording.counts, budget=Budget.of(0))


def _lines(data: bytes, packed: bool, counts: Counter[str]) -> Iterator[tuple[int, bool, list[str]]]:
    """The number, whether it has no end, and the words of each line that is neither empty nor a comment."""
    number, rest = 0, b""
    for piece in unpacked(data, counts) if packed else _pieces(io.BytesIO(data)):
        *lines, rest = (rest + piece).split(b"\n")
        for place, line in enumerate(lines, start=number + 1) if any(lines) else ():
            if line and (words := _words(line)):
                yield place, False, words
        number, rest = number + len(lines), rest[:LONGEST_LINE]
    if words := _words(rest):
        yield number + 1, True, words


def _words(line: bytes) -> list[str]:
    """Those of a line; none of a comment."""
    words = line.removeprefix(codecs.BOM_UTF8).decode("latin-1").split()
    return [] if words and words[0].startswith("#") else words


def _pieces(file: IO[bytes] | gzip.GzipFile) -> Iterator[bytes]:
    while piece := file.read(PIECE):
        yield piece


def unpacked(data: bytes, counts: Counter[str]) -> Iterator[bytes]:
    """The pieces of a packed file; of one that is cut short, what there is. Raises `LogError`."""
    left = most = BASE_BYTES + FACTOR * len(data)
    try:
        with gzip.open(io.BytesIO(data)) as file:
            for piece in _pieces(file):
                left -= len(piece)
                if left < 0:
                    raise LogError(f"it has more than {most} bytes unpacked, too much for its size; unpack it first")
                yield piece
    except (OSError, EOFError, zlib.error) as error:
        if left == most:
            raise LogError(f"no {PACKED} file, or damaged ({error!s:.80})") from None
        counts["packed file cut short or damaged"] += 1


def _message(log: CarmenLog, asked: str | None) -> str:
    """The laser message to read: as asked, or that with poses, unless it has less than half of the scans."""
    counts = {name: len(found) for name, found in log.sweeps.items()}
    if asked is not None:
        if not counts.get(asked):
            there = ", ".join(f"{name} ({n})" for name, n in counts.items() if n) or "none"
            raise LogError(f"--scan-topic: no {asked!r:.40} in the log{guess(asked, counts)}; laser messages: {there}")
        return asked
    most = max(counts.values())
    if not most:
        found = f"no laser: no line of {', '.join(counts)} that can be read ({_found(log)})"
        raise LogError("; ".join((found, *log.recording.notes)))
    return next(name for name, n in counts.items() if 2 * n >= most)


def _found(log: CarmenLog) -> str:
    others = [f"the first of others: {', '.join(map(repr, log.others))}"] if log.others else []
    return ", ".join((f"{log.line} lines", *(f"{n} {what}" for what, n in log.counts.items()), *others))


def _number(word: str) -> float:
    """A finite number."""
    value = float(word)
    if not math.isfinite(value):
        raise ValueError
    return value


def _count(word: str) -> int:
    """How many readings follow."""
    count = int(word)
    if not 0 <= count <= MOST_BEAMS:
        raise ValueError
    return count


def _pose(words: list[str], at: int) -> Array:
    """(3,) x, y, heading from the words `at` and the two behind it."""
    x, y, heading = map(_number, words[at : at + 3])
    return np.array([x, y, heading])


def _readings(words: list[str], at: int) -> tuple[Array, list[str]]:
    """The readings (B,) whose number is word `at`, and the words behind them."""
    count = _count(words[at])
    ranges = np.array(words[at + 1 : at + 1 + count], np.float64)
    if len(ranges) != count:
        raise ValueError
    return ranges, words[at + 1 + count :]


def _geometry(words: list[str], beams: int) -> Geometry:
    """That of a RAWLASER1 or ROBOTLASER1 line."""
    start, view, step, max_range = map(_number, words[2:6])
    return Geometry(beams, start, step or view / max(beams - 1, 1), 0.0, max_range if max_range > 0.0 else math.inf)


def _plain_geometry(beams: int, view_deg: float | None) -> Geometry:
    """That of an FLASER line: an odd number of beams reaches both ends of the field of view, an even one the first."""
    view = math.radians(view_deg or WIDE_DEG.get(beams, 180.0))
    return Geometry(beams, -0.5 * view, view / max(beams - beams % 2, 1))
