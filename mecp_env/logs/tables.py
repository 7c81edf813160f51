"""Plain tables as logs: `.csv` with named columns, and the columns of BreezySLAM's `.dat` (docs/logs.md)."""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.logs.carmen import MAGIC, MOST_BEAMS, MOST_BYTES, PACKED, unpacked
from mecp_env.logs.readings import USUAL_M, Budget, Geometry, Recording, Sweep

TABLES = (".csv", ".tsv", ".dat")
STAMPS = {"t", "time", "stamp", "timestamp"}
HEADINGS = {"heading", "theta", "yaw", "th"}
POSES = ({"x"}, {"y"}, HEADINGS)
PREFIXES = {"odom", "odometry", "pose", "pos", "position", "robot", "field", "header"}  # words of names without meaning
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "rad": 1.0, "deg": math.radians(1.0), "degrees": math.radians(1.0)}
UNITS |= {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LASER = ("angle min", "angle increment", "range min", "range max")  # columns of a table of ROS messages; rad and m
HEAD, MOST_ASKED = 10, 1000  # rows that may tell where lists are, and sweeps the unit of their readings
FARTHEST_CM = 800.0  # half of the readings of a room are nearer
LIST, JOIN = re.compile(r"[\[(]([^\[\]()]*)[\])]"), "\x1f"
EXPECTED = "expected a first row of names: t,x,y,heading, then one bearing in degrees per beam"
LONGEST_LINE = 2**20
TICKS, WHEEL_M, AXLE_M = 2000, 0.077, 0.330  # of BreezySLAM's `Rover`: ticks of half a turn, wheel radius, wheels apart
TURN_DEG = 360.0
MOST_TICKS = 1e18  # of a counter, and microseconds of a stamp
FIRST_RANGE, DAT_VIEW_DEG, DAT_AHEAD_M, DAT_LIMIT_M = 24, 240.0, 0.145, 5.6  # of its URG-04LX


@dataclass(frozen=True, slots=True)
class Columns:
    """Which column has what, and in which unit; `pose` is empty without odometry, `stamp` None without stamps."""

    stamp: int | None
    pose: tuple[int, ...]
    readings: list[int]
    units: Array  # of all columns: m, rad or s
    geometry: Geometry

    def sweep(self, row: Array, order: int) -> Sweep:
        """That of a row of numbers."""
        row = row * self.units
        t = math.nan if self.stamp is None else float(row[self.stamp])
        pose = row[list(self.pose)] if self.pose else None
        return Sweep(t, row[self.readings], self.geometry, pose, order=float(order))


def read_table(path: Path, field_of_view_deg: float | None = None) -> Recording:
    """What is in a table. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, budget=Budget.of(len(data)))
    if data.startswith(MAGIC):
        data = b"".join(unpacked(data, recording.counts))
    is_dat = path.name.lower().removesuffix(PACKED).endswith(".dat")
    (_read_dat if is_dat else _read_csv)(data, recording, field_of_view_deg)
    if not recording.sweeps:
        found = f"no row that can be read ({recording.counts['damaged rows']} damaged rows)"
        raise LogError("; ".join((found, *recording.notes)))
    _to_metres(recording)
    return recording


def _to_metres(recording: Recording) -> None:
    """Take readings that no laser has in m for mm or cm: half of them are farther than `USUAL_M`."""
    ranges = np.concatenate([sweep.ranges for sweep in recording.sweeps[:: 1 + len(recording.sweeps) // MOST_ASKED]])
    seen = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    middle = float(np.median(seen)) if len(seen) else 0.0
    if middle <= USUAL_M:
        return
    unit = "mm" if middle > FARTHEST_CM else "cm"
    recording.notes.append(f"readings are taken for {unit}: half of them are above {middle:.0f}")
    recording.sweeps[:] = [replace(sweep, ranges=UNITS[unit] * sweep.ranges) for sweep in recording.sweeps]


def _read_csv(data: bytes, recording: Recording, view_deg: float | None) -> None:
    """All rows behind the names."""
    rows = _rows(data)
    _, names = next(rows, (0, []))
    head = list(islice(rows, HEAD))
    sample = next((cells for _, cells in head if len(cells) == len(names)), [])  # the first may be damaged
    names = _one_each(names, sample)
    columns = _columns(names, _numbers(_flat(sample)), view_deg, recording.notes)
    for number, cells in chain(head, rows):
        words = _flat(cells)
        row = _numbers(words)
        if row is None or len(row) != len(names):
            recording.damaged("row", number, words)
        else:
            recording.add(columns.sweep(row, number))


def _read_dat(data: bytes, recording: Recording, view_deg: float | None) -> None:
    """Stamp in us, a number, ticks of the left and right wheel, 20 numbers, ranges in mm (0: no return), a number."""
    wheels = list[Array]()
    recording.T_robot_laser = np.array([DAT_AHEAD_M, 0.0, 0.0])
    for number, words in _rows(data):
        row = _numbers(words[:-1])
        if row is None or len(row) < FIRST_RANGE + 2 or not (np.abs(row[:4]) < MOST_TICKS).all():
            recording.damaged("row", number, words)
            continue
        wheels.append(row[2:4] * math.pi * WHEEL_M / TICKS)
        pose = _driven(recording.sweeps[-1].T_odom_robot if recording.sweeps else None, wheels[-2:])
        view = math.radians(view_deg or DAT_VIEW_DEG)
        beams = len(row) - FIRST_RANGE
        geometry = Geometry(beams, -0.5 * view, view / (beams - 1), 0.0, DAT_LIMIT_M)
        recording.add(Sweep(1e-6 * row[0], 1e-3 * row[FIRST_RANGE:], geometry, pose, order=float(number)))


def _driven(before: Array | None, wheels: list[Array]) -> Array:
    """(3,) the pose after the wheels went on from the first to the last of their two positions (2,) m."""
    if before is None:
        return np.zeros(3)
    left, right = wheels[-1] - wheels[0]
    distance, turn = 0.5 * (left + right), (right - left) / AXLE_M
    towards = before[2] + 0.5 * turn
    after: Array = before + np.array([distance * math.cos(towards), distance * math.sin(towards), turn])
    return after


def _rows(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """The number and the cells of each row, with whatever separates them; comments are left out.

    Where no comma does, one in a number is its decimal point. A list in brackets is one cell, with `JOIN` in it.
    """
    for number, line in enumerate(iter(partial(io.BytesIO(data).readline, LONGEST_LINE), b""), start=1):
        text = line.decode("utf-8-sig", "replace").replace('"', "").strip(" \r\n")
        text = LIST.sub(lambda found: JOIN.join(found[1].replace(",", " ").split()), text)
        separator = next((mark for mark in (";", "\t", ",") if mark in text), None)
        if text and not text.startswith("#"):
            text = text if separator in (",", None) else text.replace(",", ".")
            yield number, text.removesuffix(separator or "").split(separator)


def _flat(cells: list[str]) -> list[str]:
    """The words of all cells: those of a list one by one."""
    return [word for cell in cells for word in cell.split(JOIN)]


def _one_each(names: list[str], cells: list[str]) -> list[str]:
    """A name for each word of a row: those of a list are numbered."""
    if len(names) != len(cells):
        return names
    pairs = zip(names, cells, strict=True)
    return [f"{name}{k}" if JOIN in cell else name for name, cell in pairs for k in range(cell.count(JOIN) + 1)]


def _numbers(words: list[str]) -> Array | None:
    """(k,) the numbers of a row, nan for an empty word; None where one is no number."""
    try:
        return np.fromiter((float(word.strip() or "nan") for word in words), np.float64, len(words))
    except ValueError:
        return None


def _columns(names: list[str], row: Array | None, view_deg: float | None, notes: list[str]) -> Columns:
    """Where a table with these names has what; what it says of the laser is taken from a `row` (k,) of it.

    A note lists the columns that are not read. Raises `LogError`.
    """
    words, units = zip(*map(_parsed, names), strict=True) if names else ((), ())
    stamp, pose = _stamp_and_pose(words)
    if len(pose) not in (0, len(POSES)) or (stamp is None and not pose):
        raise LogError(f"first row {', '.join(names[:6])!r:.80}: {EXPECTED}")
    readings, said = _readings(names, {stamp, *pose}), _said(words, np.array(units), row)
    used = {stamp, *pose, *readings, *map(words.index, said)}
    left = [name for at, name in enumerate(names) if at not in used]
    notes += [f"columns that are not read: {', '.join(left)!r:.200}"] * bool(left)
    geometry = _geometry([names[at] for at in readings], view_deg, said)
    return Columns(stamp, pose, readings, np.array(units), geometry)


def _said(words: tuple[str, ...], units: Array, row: Array | None) -> dict[str, float]:
    """The columns about the laser with their numbers, rad and m, in a row (k,) of all columns."""
    if row is None or len(row) != len(words):
        return {}
    found = {word: float(row[at] * units[at]) for at, word in enumerate(words) if word in LASER}
    return {word: number for word, number in found.items() if math.isfinite(number)}


def _stamp_and_pose(words: tuple[str, ...]) -> tuple[int | None, tuple[int, ...]]:
    """The column of the stamp, and those of x, y and heading that there are."""
    places = [next((at for at, word in enumerate(words) if word in known), None) for known in (STAMPS, *POSES)]
    return places[0], tuple(place for place in places[1:] if place is not None)


def _readings(names: list[str], others: set[int | None]) -> list[int]:
    """The columns of readings: what most names begin with. Raises `LogError`."""
    stem = Counter(map(_stem, names)).most_common(1)[0][0]
    readings = [at for at, name in enumerate(names) if _stem(name) == stem and at not in others]
    if not 2 <= len(readings) <= MOST_BEAMS:
        raise LogError(f"first row has {len(readings)} readings, 2 to {MOST_BEAMS} needed; {EXPECTED}")
    return readings


def _parsed(name: str) -> tuple[str, float]:
    """What a name says without words such as `odom`, and its unit in m, rad or s."""
    words = re.findall("[a-z]+", name.lower())
    unit = UNITS.get(words[-1], 1.0) if len(words) > 1 else 1.0
    words = words[:-1] if len(words) > 1 and words[-1] in UNITS else words
    return " ".join(word for word in words if word not in PREFIXES), unit


def _stem(name: str) -> str:
    """A name without its number; the names of readings have the same."""
    numbered = re.search(r"\d+\W*$", name)
    return "" if name and _numbers([name]) is not None else name[: numbered.start()] if numbered else f"{name} "


def _geometry(names: list[str], view_deg: float | None, said: dict[str, float]) -> Geometry:
    """What columns have `said`; else that of bearings in degrees, or of beams spread over the field of view."""
    if {"angle min", "angle increment"} <= said.keys():
        limits = said.get("range min", 0.0), said.get("range max", math.inf)
        return Geometry(len(names), said["angle min"], said["angle increment"], *limits)
    degrees = _numbers(names)
    if degrees is not None and np.isfinite(degrees).all() and np.ptp(degrees) <= TURN_DEG:
        fault = "columns of readings: bearings that are not evenly spaced"
        return Geometry.even(degrees, fault, unit_rad=math.radians(1.0))
    if view_deg is None:
        raise LogError("names of readings are no bearings in degrees within a turn: --field-of-view-deg is needed")
    view = math.radians(view_deg)
    return Geometry(len(names), -0.5 * view, view / (len(names) - 1))
