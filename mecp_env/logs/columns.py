"""The rows of a table as cells, whatever separates them, and the numbers, missing values and dates in the cells.

Which column has what, by its name: stamp, pose, readings, and what the table says of the laser.
"""

from __future__ import annotations

import codecs
import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.logs.carmen import LONGEST_LINE
from mecp_env.logs.recording import FEWEST_BEAMS, MOST_BEAMS, Geometry, Recording, Sweep

COMMENTS = ("#", "%")
SEPARATORS = (";", "\t", "|", ",")
LIST, JOIN = re.compile(r"[\[({]([^\[\](){}]*)[\])}]"), "\x1f"
ARRAY = re.compile(r"array\('\w', (\[[^\[\]]*+\])\)")  # as Python prints a list of a ROS 2 message
FEWEST_LISTED = 8  # numbers in a cell with spaces between them that are a list without brackets
COMPACT_DATE = re.compile(r"((?:19|20)\d{6})[-_ T](\d{6})((?:[.,]\d+)?(?:Z|[-+]\d\d:?\d\d)?)\Z")
PAIR = re.compile(r"(?<![A-Za-z])([A-Za-z]++)\s*+[:=]\s*+([^\s,;]++)")  # a name with its value, as `theta: 12.5`
MISSING = {"", "-", "--", "?", "na", "n/a", "#n/a", "<na>", "null", "nil", "none", "nat", "missing"}
NOT_FINITE = ("1.#inf", "-1.#inf", "1.#qnan", "-1.#ind")  # as old C libraries of Windows write them
STAMPS = {"t", "time", "stamp", "timestamp", "sec", "secs", "seconds", "datetime", "epoch"}
STAMPS |= {"date time", "ros time", "unix time"}
HEADINGS = {"heading", "theta", "yaw", "th", "phi", "psi", "orientation", "rotation"}
ROTATIONS = ("orientation", "rotation", "quaternion", "quat", "q")
QUATERNION = tuple({f"{word} {axis}" for word in ROTATIONS} | {f"q{axis}"} for axis in "xyzw")
PREFIXES = {"odom", "odometry", "pose", "pos", "position", "robot", "field", "header"}  # words of names without meaning
WHOLE, NANOSECONDS = {"sec", "secs"}, {"nsec", "nsecs", "nanosec", "nanosecs"}  # the two columns of a stamp of ROS
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
UNITS = LENGTHS | {"rad": 1.0, "deg": math.radians(1.0), "degrees": math.radians(1.0)}
UNITS |= {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9} | dict.fromkeys(WHOLE, 1.0) | dict.fromkeys(NANOSECONDS, 1e-9)
LASER = {f"angle {what}" for what in ("min", "max", "increment")} | {"range min", "range max"}  # of ROS; rad and m
EXPECTED = "expected a first row of names: t,x,y,heading, then one bearing in degrees per beam"
NO_RANGES = re.compile("intens|remission|reflect|rssi|quality|amplitude", re.IGNORECASE)  # beside readings, as many
ANGLES = re.compile("angle|bearing|azimuth", re.IGNORECASE)  # beside readings, as many: their bearings
LONGEST_NAME = 80  # more of a name says nothing, and takes long to search
NUMBERED = re.compile(r"\d+(?:[ _]*(?:mm|cm|m))?\W*$")  # the end of a name of readings, perhaps with its unit
IN_DEGREES = re.compile(r"\A\D*?([-+]?\d+(?:\.\d*)?)[ _]*(?:°|degrees|deg)\W*\Z")  # a bearing that names its unit
TURN_DEG, TURN_RAD = 360.0, 6.3
LEAST_SHARE = 0.5  # of the readings are in a row that is shorter than the names, at least


class Row(NamedTuple):
    """A line of a table."""

    number: int  # from 1
    cells: list[str]
    names: tuple[str, ...] = ()  # of the cells, where each has its own before it


def rows_of(data: bytes, comments: bool = False) -> Iterator[Row]:
    """The rows, with comments (without their mark) where they are asked for; empty lines are left out.

    Where no comma separates cells, one in a number is its decimal point. A list in brackets is one cell, with `JOIN`
    in it.
    """
    data = data.removeprefix(codecs.BOM_UTF8)
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    for number, line in enumerate(iter(partial(io.BytesIO(data).readline, LONGEST_LINE), b""), start=1):
        text = line.decode("utf-8", "replace").replace('"', "").strip(" \r\n")
        if text.startswith(COMMENTS) and not comments:
            continue
        text = text.lstrip("#% ")
        if text:
            yield _row(number, text)


def _row(number: int, text: str) -> Row:
    """The cells of a line."""
    pairs = PAIR.findall(text)
    if len(pairs) > 1:
        names, values = zip(*pairs, strict=True)
        return Row(number, list(values), names)
    text = LIST.sub(_joined, ARRAY.sub(r"\1", text))
    separator = next((mark for mark in SEPARATORS if mark in text), None)
    text = text if separator in (",", None) else text.replace(",", ".")
    cells = text.removesuffix(separator or "").split(separator)
    return Row(number, cells if separator is None else [_listed(cell) for cell in cells])


def _listed(cell: str) -> str:
    """A cell, with `JOIN` between the numbers of a list that has no brackets."""
    words = cell.split() if cell.count(" ") >= FEWEST_LISTED - 1 else ()
    return JOIN.join(words) if len(words) >= FEWEST_LISTED and numbers(words) is not None else cell


def _joined(found: re.Match[str]) -> str:
    """The numbers of a list as one cell; the unit of a name, as in `x[m]`, behind it."""
    words = re.split(r"[\s,;|]+", found[1].strip(" \t,;|"))
    return f"_{words[0]}" if len(words) == 1 and numbers(words) is None else JOIN.join(words)


def flat(cells: Sequence[str]) -> list[str]:
    """The words of all cells: those of a list one by one."""
    return [word for cell in cells for word in cell.split(JOIN)]


def one_each(names: list[str], cells: list[str]) -> list[str]:
    """A name for each word of a row: those of a list are numbered."""
    if len(names) != len(cells):
        return names
    pairs = zip(names, cells, strict=True)
    return [f"{name}{k}" if JOIN in cell else name for name, cell in pairs for k in range(cell.count(JOIN) + 1)]


def number(word: str) -> float:
    """A number; nan where a word says that there is none. Raises `ValueError`."""
    if not word:
        return math.nan
    try:
        if "_" in word:  # in Python, one may be within a number
            raise ValueError
        return float(word)
    except ValueError:
        if word.strip().lower() in MISSING or word.strip().lower().startswith(NOT_FINITE):
            return math.nan
        raise


def numbers(words: Sequence[str]) -> Array | None:
    """(k,) the numbers of words; None where one is none."""
    try:
        return np.fromiter(map(number, words), np.float64, len(words))
    except ValueError:
        return None


def seconds(word: str, unit_s: float) -> float:
    """s of a stamp: a number of some unit, a date (UTC unless it names a zone), or a time of the day.

    Raises `ValueError`.
    """
    compact = COMPACT_DATE.match(word.strip())
    if compact is not None:
        return _since_1970(f"{compact[1]}T{compact[2]}{compact[3]}")
    try:
        return unit_s * number(word)
    except ValueError:
        date = word.strip().replace("/", "-")
        return _since_1970(date if "-" in date else f"1970-01-01T{date}")


def _since_1970(date: str) -> float:
    """s of a date in a form of ISO 8601. Raises `ValueError`."""
    moment = datetime.fromisoformat(date)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


class Parsed(NamedTuple):
    """What a name says without words such as `odom`, and its unit in m, rad or s."""

    word: str
    unit: float
    unit_name: str  # empty where it names none


def parsed(name: str) -> Parsed:
    """What a name says."""
    words = re.findall("[a-z]+", name.lower())
    unit = words.pop() if len(words) > 1 and words[-1] in UNITS else ""
    return Parsed(" ".join(word for word in words if word not in PREFIXES), UNITS.get(unit, 1.0), unit)


@dataclass(frozen=True, slots=True)
class Place:
    """The columns of stamp and pose."""

    stamp: int | None  # None without stamps
    nanoseconds: int | None  # beside a stamp in whole seconds
    position: tuple[int, ...]  # x and y, empty without odometry
    heading: tuple[int, ...]  # a heading, or the quaternion x, y, z, w; or z, w
    units: Array  # of all columns: m, rad or s

    @classmethod
    def of(cls, names: Sequence[str]) -> Place:
        """Those among columns of these names; odometry is complete, or there is none of it."""
        words = [parsed(name) for name in names]
        stamp = _first(words, STAMPS)
        nanoseconds = None
        if stamp is not None and WHOLE & {words[stamp].word, words[stamp].unit_name}:
            nanoseconds = next((at for at, one in enumerate(words) if NANOSECONDS & {one.word, one.unit_name}), None)
        position = tuple(at for axis in "xy" if (at := _first(words, {axis, f"p{axis}"})) is not None)
        units = np.array([one.unit for one in words])
        return cls(stamp, nanoseconds, position, _heading(words), units)

    @property
    def complete(self) -> bool:
        """True where x, y and heading are all there, or none is."""
        return len(self.position) == (2 if self.heading else 0)

    @property
    def used(self) -> set[int]:
        """All columns."""
        return {at for at in (self.stamp, self.nanoseconds) if at is not None} | {*self.position, *self.heading}

    def time(self, words: Sequence[str]) -> float:
        """s of a row; nan without stamps. Raises `ValueError`."""
        if self.stamp is None:
            return math.nan
        t = seconds(words[self.stamp], float(self.units[self.stamp]))
        return t if self.nanoseconds is None else t + 1e-9 * number(words[self.nanoseconds])

    def pose(self, words: Sequence[str]) -> Array | None:
        """(3,) m, m, rad of a row; None without odometry, or where its cells are empty. Raises `ValueError`."""
        if not any(words[at].strip() for at in (*self.position, *self.heading)):
            return None
        x, y = (number(words[at]) * self.units[at] for at in self.position)
        turn = [number(words[at]) * self.units[at] for at in self.heading]
        return np.array([x, y, turn[0] if len(turn) == 1 else _heading_of(*turn)])


def _first(words: Sequence[Parsed], known: set[str]) -> int | None:
    """The first column whose name is known."""
    return next((at for at, one in enumerate(words) if one.word in known), None)


def _heading(words: Sequence[Parsed]) -> tuple[int, ...]:
    """The column of the heading, or those of a quaternion."""
    heading = _first(words, HEADINGS)
    if heading is not None:
        return (heading,)
    axes = [_first(words, axis) for axis in QUATERNION]
    found = tuple(at for at in axes if at is not None)
    return found if None not in axes[2:] and len(found) != 3 else ()


def _heading_of(*quaternion: float) -> float:
    """rad of a quaternion x, y, z, w of whatever length, or of z, w; nan for zeros."""
    x, y, z, w = quaternion if len(quaternion) == 4 else (0.0, 0.0, *quaternion)
    if not (x or y or z or w):
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


@dataclass(frozen=True, slots=True)
class Columns:
    """Which column has what in a table with a row per sweep."""

    names: list[str]
    place: Place
    readings: list[int]
    scale: Array  # (B,) m per unit of the readings
    geometry: Geometry

    def take(self, words: list[str], order: int, recording: Recording) -> None:
        """Take in the pose and the sweep of a row; one of them where the cells of the other are empty.

        Raises `ValueError`.
        """
        if len(words) > len(self.names):
            raise ValueError
        there = [words[at] for at in self.readings if at < len(words)]
        t, pose = self.place.time(words), self.place.pose(words)
        if any(word.strip() for word in there):
            recording.add(Sweep(t, self._ranges(there), self.geometry, pose, order=float(order)))
            recording.counts["rows that end early"] += len(words) < len(self.names)
        elif pose is None:
            raise ValueError
        if pose is not None:
            recording.odometry.add(t, pose, float(order))

    def _ranges(self, there: list[str]) -> Array:
        """(B,) m of the readings of a row, of which the last may be missing. Raises `ValueError`."""
        missing = len(self.readings) - len(there)
        if len(there) < LEAST_SHARE * len(self.readings):
            raise ValueError
        return np.array([*map(number, there), *[math.nan] * missing], np.float64) * self.scale


def columns_of(names: list[str], sample: list[str], view_deg: float | None, notes: list[str]) -> Columns:
    """Where a table with these names has what; what it says of the laser is taken from the cells of one row of it.

    Notes say what is not read. Raises `LogError`.
    """
    names, words = [name[:LONGEST_NAME] for name in one_each(names, sample)], flat(sample)
    place = Place.of(names)
    _check_names(names, place)
    names = [IN_DEGREES.sub(r"\1", name) for name in names]
    readings, said = _readings(names, place.used), _said(names, words)
    bearings = _bearings(names, readings)
    _note_left(names, {*place.used, *readings, *bearings}, said, notes)
    scale = np.array([LENGTHS.get(parsed(names[at]).unit_name, 1.0) for at in readings])
    of_beams = [words[at] for at in bearings if at < len(words)] or [names[at] for at in readings]
    return Columns(names, place, readings, scale, _geometry(of_beams, view_deg, said, notes))


def _note_left(names: list[str], used: set[int], said: dict[str, float], notes: list[str]) -> None:
    """Note the names of columns that are not read."""
    left = [name for at, name in enumerate(names) if name and at not in used and parsed(name).word not in said]
    if left:
        notes.append(f"columns that are not read: {', '.join(left)!r:.200}")


def _bearings(names: list[str], readings: list[int]) -> list[int]:
    """The columns beside the readings that have their bearings; none where they are not as many."""
    found = [at for at, name in enumerate(names) if ANGLES.search(_stem(name)) and at not in readings]
    return found if len(found) == len(readings) else []


def _check_names(names: list[str], place: Place) -> None:
    """Raise `LogError` where the names are not those of a table with a row per sweep."""
    first = f"first row {', '.join(names[:6])!r:.80}"
    if not place.complete:
        there = "x and y without a heading (or the other way round), and without bearing and range of each beam"
        raise LogError(f"{first} has {there}; {EXPECTED}")
    if place.stamp is None and not place.position:
        raise LogError(f"{first} names neither a stamp nor a pose; {EXPECTED}")


def _said(names: list[str], words: list[str]) -> dict[str, float]:
    """The columns about the laser with their numbers, rad and m, in a row."""
    pairs = zip(map(parsed, names), words, strict=True) if len(names) == len(words) else ()
    values = {name.word: (name.unit, numbers([word])) for name, word in pairs if name.word in LASER}
    return {
        what: unit * float(value[0])
        for what, (unit, value) in values.items()
        if value is not None and np.isfinite(value).all()
    }


def _readings(names: list[str], others: set[int]) -> list[int]:
    """The columns of readings: what most names begin with, but for those of intensities. Raises `LogError`."""
    stems = Counter(stem for name in names if not NO_RANGES.search(stem := _stem(name)))
    most = [stem for stem, count in stems.most_common() if count >= FEWEST_BEAMS]
    stem = next((stem for stem in most if not ANGLES.search(stem)), next(iter(most), ""))
    readings = [at for at, name in enumerate(names) if _stem(name) == stem and at not in others]
    if not FEWEST_BEAMS <= len(readings) <= MOST_BEAMS:
        raise LogError(f"first row has {len(readings)} readings, {FEWEST_BEAMS} to {MOST_BEAMS} needed; {EXPECTED}")
    return readings


def _stem(name: str) -> str:
    """A name without its number; the names of readings have the same."""
    numbered = NUMBERED.search(name)
    return "" if name and numbers([name]) is not None else name[: numbered.start()] if numbered else f"{name} "


def _geometry(names: list[str], view_deg: float | None, said: dict[str, float], notes: list[str]) -> Geometry:
    """What columns have `said`; else that of bearings, or of beams spread over the field of view."""
    first, last = said.get("angle min", math.nan), said.get("angle max", math.nan)
    step = said.get("angle increment") or (last - first) / max(len(names) - 1, 1)
    if math.isfinite(first) and math.isfinite(step):
        return Geometry(len(names), first, step, said.get("range min", 0.0), said.get("range max", math.inf))
    bearings = numbers(names)
    if bearings is not None and np.isfinite(bearings).all() and np.ptp(bearings) <= TURN_DEG:
        in_radians = bool(np.ptp(bearings) <= TURN_RAD)  # too narrow for degrees
        notes += ["names of readings are taken for bearings in rad: all are within a turn"] * in_radians
        fault = "columns of readings: bearings that are not evenly spaced"
        return Geometry.even(bearings, fault, unit_rad=1.0 if in_radians else math.radians(1.0))
    if view_deg is None:
        said_so = f"names of readings, {names[0]!r:.40} to {names[-1]!r:.40}, are no bearings in degrees within a turn"
        raise LogError(f"{said_so}: --field-of-view-deg is needed")
    view = math.radians(view_deg)
    return Geometry(len(names), -0.5 * view, view / (len(names) - 1))
