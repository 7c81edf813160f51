"""Plain tables as logs: `.csv` with named columns, and the columns of BreezySLAM's `.dat` (docs/logs.md)."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.logs.carmen import MOST_BEAMS, MOST_BYTES
from mecp_env.logs.readings import Budget, Geometry, Recording, Sweep

TABLES = (".csv", ".dat")
STAMPS = ("t", "time", "stamp", "timestamp")
DEGREES = ("heading_deg", "theta_deg", "yaw_deg")
HEADINGS = ("heading", "theta", "yaw", "heading_rad", "theta_rad", "yaw_rad", "odom_theta", *DEGREES)
POSES = (("x", "x_m", "odom_x"), ("y", "y_m", "odom_y"), HEADINGS)
EXPECTED = "expected a first row of names: t,x,y,heading, then one bearing in degrees per beam"
LONGEST_LINE = 2**20
TICKS, WHEEL_M, AXLE_M = 2000, 0.077, 0.330  # of BreezySLAM's `Rover`: ticks of half a turn, wheel radius, wheels apart
MOST_TICKS = 1e18  # of a counter, and microseconds of a stamp
FIRST_RANGE, DAT_VIEW_DEG, DAT_AHEAD_M, DAT_LIMIT_M = 24, 240.0, 0.145, 5.6  # of its URG-04LX


@dataclass(frozen=True, slots=True)
class Columns:
    """Where a row has what; `pose` is empty without odometry, `stamp` None without stamps."""

    stamp: int | None
    pose: tuple[int, ...]
    first: int  # of the readings, up to the last column
    geometry: Geometry
    heading_unit_rad: float = 1.0

    def sweep(self, row: Array, order: int) -> Sweep:
        """That of a row of numbers."""
        t = math.nan if self.stamp is None else float(row[self.stamp])
        pose = row[list(self.pose)] * (1.0, 1.0, self.heading_unit_rad) if self.pose else None
        return Sweep(t, row[self.first :].copy(), self.geometry, pose, order=float(order))


def read_table(path: Path, field_of_view_deg: float | None = None) -> Recording:
    """What is in a table. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, budget=Budget.of(len(data)))
    (_read_csv if path.suffix.lower() == ".csv" else _read_dat)(data, recording, field_of_view_deg)
    if not recording.sweeps:
        raise LogError(f"no row that can be read ({recording.counts['damaged rows']} damaged rows)")
    return recording


def _read_csv(data: bytes, recording: Recording, view_deg: float | None) -> None:
    """All rows behind the names."""
    rows = _rows(data)
    _, names = next(rows, (0, []))
    columns = _columns([name.strip("\"' ").lower() for name in names], view_deg)
    for number, words in rows:
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
    """The number and the words of each row, with whatever separates them; comments are left out."""
    for number, line in enumerate(iter(partial(io.BytesIO(data).readline, LONGEST_LINE), b""), start=1):
        text = line.decode("utf-8-sig", "replace").strip()
        separator = next((mark for mark in (";", ",", "\t") if mark in text), None)
        if text and not text.startswith("#"):
            yield number, text.rstrip(separator).split(separator)


def _numbers(words: list[str]) -> Array | None:
    """(k,) the numbers of a row, nan for an empty word; None where one is no number."""
    try:
        return np.fromiter((float(word.strip() or "nan") for word in words), np.float64, len(words))
    except ValueError:
        return None


def _columns(names: list[str], view_deg: float | None) -> Columns:
    """Where a table with these names has what. Raises `LogError`."""
    stamp, *places = (next((names.index(name) for name in known if name in names), None) for known in (STAMPS, *POSES))
    pose = tuple(place for place in places if place is not None)
    first = 1 + max((place for place in (stamp, *pose) if place is not None), default=-1)
    if len(pose) not in (0, len(POSES)) or first != len(pose) + (stamp is not None) or not first:
        raise LogError(f"first row {', '.join(names[:6])!r:.80}: {EXPECTED}")
    if not 2 <= len(names) - first <= MOST_BEAMS:
        raise LogError(f"first row has {len(names) - first} readings, 2 to {MOST_BEAMS} needed; {EXPECTED}")
    return Columns(stamp, pose, first, _geometry(names[first:], view_deg), _heading_unit(names[:first]))


def _heading_unit(names: list[str]) -> float:
    """rad of the unit that the column of headings has by its name."""
    return math.radians(1.0) if set(DEGREES) & set(names) else 1.0


def _geometry(names: list[str], view_deg: float | None) -> Geometry:
    """That of bearings in degrees, or of names that are none, whose beams are spread over the field of view."""
    degrees = _numbers(names)
    if degrees is None or not np.isfinite(degrees).all():
        view = math.radians(view_deg or 0.0)
        if not view:
            raise LogError("names of readings are no bearings in degrees: --field-of-view-deg is needed")
        return Geometry(len(names), -0.5 * view, view / (len(names) - 1))
    fault = "columns of readings: bearings that are not evenly spaced"
    return Geometry.even(degrees, fault, unit_rad=math.radians(1.0))
