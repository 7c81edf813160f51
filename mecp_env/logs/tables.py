"""Plain tables as logs: `.csv` or `.txt` with named columns, and the columns of BreezySLAM's `.dat` (docs/logs.md)."""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import islice
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.logs.beam_rows import BeamColumns, read_beam_rows
from mecp_env.logs.carmen import MOST_BYTES, PACKED, unpacked
from mecp_env.logs.clock import DAY_S
from mecp_env.logs.columns import JOIN, Place, Row, columns_of, flat, numbers, rows_of
from mecp_env.logs.recording import Geometry, Recording, Sweep

TABLES = (".csv", ".tsv", ".txt", ".dat")
HEAD, SAMPLED = 10, 200  # rows that may tell the names, and where lists are
START = 2**12  # bytes of a table before which it says what it is of
RPLIDAR = re.compile(rb"rplidar|slamtec|angule|theta:\s*[\d.]+\s+dist:", re.IGNORECASE)  # as its tools write it
CELLS = "expected are numbers, and dates as 2024-03-01T12:00:00"
TICKS, WHEEL_M, AXLE_M = 2000, 0.077, 0.330  # of BreezySLAM's `Rover`: ticks of half a turn, wheel radius, wheels apart
MOST_TICKS = 1e18  # of a counter, and microseconds of a stamp
FIRST_RANGE, DAT_VIEW_DEG, DAT_AHEAD_M, DAT_LIMIT_M = 24, 240.0, 0.145, 5.6  # of its URG-04LX


def read_table(path: Path, field_of_view_deg: float | None = None) -> Recording:
    """What is in a table. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, len(data))
    data = b"".join(unpacked(data, recording.counts))
    is_dat = path.name.lower().removesuffix(PACKED).endswith(".dat")
    (_read_dat if is_dat else _read_csv)(data, recording, field_of_view_deg)
    if not recording.sweeps:
        found = f"no row that can be read ({recording.counts['damaged rows']} damaged rows)"
        raise LogError("; ".join((found, *recording.notes, CELLS)))
    return recording


def _read_csv(data: bytes, recording: Recording, view_deg: float | None) -> None:
    """All rows behind the names."""
    head = list(islice(rows_of(data, comments=True), HEAD))
    _check_lists(head)
    header = header_of(head)
    behind = (row for row in rows_of(data) if row.number > header.number)
    of_beams = BeamColumns.of(header.cells)
    if of_beams is not None:
        read_beam_rows(behind, of_beams, recording)
        _turn_over(data, recording)
        return
    columns = columns_of(header.cells, _sample(data, header), view_deg, recording.notes)
    for number, cells, _ in behind:
        words = flat(cells)
        try:
            columns.take(words, number, recording)
        except (ValueError, IndexError):
            recording.damaged("row", number, words)
    _count_days(recording)


def _sample(data: bytes, header: Row) -> list[str]:
    """The cells of the row with the longest lists among the first ones behind the names; none where none fits these."""
    rows = (row.cells for row in islice(rows_of(data), SAMPLED) if row.number > header.number)
    fitting = (cells for cells in rows if len(cells) == len(header.cells))
    return max(fitting, key=lambda cells: sum(cell.count(JOIN) for cell in cells), default=[])


def _count_days(recording: Recording) -> None:
    """Go on where stamps that are times of the day begin again at midnight: half a day earlier than the one before."""
    both = [np.array([sweep.t for sweep in recording.sweeps]), np.array(recording.odometry.t)]
    if not all(((t >= 0.0) & (t <= DAY_S)).all() for t in both):
        return
    scans, odometry = ((t + DAY_S * np.cumsum(np.diff(t, prepend=t[:1]) < -0.5 * DAY_S)).tolist() for t in both)
    recording.odometry.t = odometry
    for sweep, t in zip(recording.sweeps, scans, strict=True):
        sweep.t = t


def _check_lists(head: list[Row]) -> None:
    """Raise `LogError` where a list is not whole."""
    if any("..." in cell or "[" in cell for row in head for cell in row.cells):
        raise LogError("a list has '...' or line ends in it, as NumPy prints it: write plain numbers, or save an .npz")


def _turn_over(data: bytes, recording: Recording) -> None:
    """Turn the bearings of an RPLIDAR round, which count clockwise."""
    if RPLIDAR.search(data[:START]):
        for sweep in recording.sweeps:
            sweep.mirror()
        recording.notes.append("rows of an RPLIDAR, whose bearings count clockwise: they are turned round")


def header_of(head: list[Row]) -> Row:
    """The first row of names that has as many cells as most rows, or the first; names before each cell count as one."""
    before_cells = (Row(row.number - 1, list(row.names)) for row in head if row.names)
    if found := next(filter(has_names, before_cells), None):
        return found
    named = [row for row in head if has_names(row)]
    usual = Counter(len(row.cells) for row in head).most_common(1)
    fitting = [row for row in named if len(row.cells) == usual[0][0]]
    return next(iter(fitting or named or head), Row(0, []))


def has_names(row: Row) -> bool:
    """True where the cells of a row name a stamp and more, a pose, or a bearing and a range."""
    place = Place.of(row.cells)
    return len(row.cells) > 1 and (
        place.stamp is not None or bool(place.position) or BeamColumns.of(row.cells) is not None
    )


def _read_dat(data: bytes, recording: Recording, view_deg: float | None) -> None:
    """Stamp in us, a number, ticks of the left and right wheel, 20 numbers, ranges in mm (0: no return), a number."""
    view, before, pose = math.radians(view_deg or DAT_VIEW_DEG), None, np.zeros(3)
    recording.T_robot_laser = np.array([DAT_AHEAD_M, 0.0, 0.0])
    for number, words, _ in rows_of(data):
        row = numbers(words[:-1])
        if row is None or len(row) < FIRST_RANGE + 2 or not (np.abs(row[:4]) < MOST_TICKS).all():
            recording.damaged("row", number, words)
            continue
        wheels = row[2:4] * math.pi * WHEEL_M / TICKS
        pose, before = pose if before is None else _driven(pose, *(wheels - before)), wheels
        beams = len(row) - FIRST_RANGE
        geometry = Geometry(beams, -0.5 * view, view / (beams - 1), 0.0, DAT_LIMIT_M)
        recording.add(Sweep(1e-6 * row[0], 1e-3 * row[FIRST_RANGE:], geometry, pose, order=float(number)))


def _driven(pose: Array, left: float, right: float) -> Array:
    """(3,) the pose after the wheels went on by so many m."""
    distance, turn = 0.5 * (left + right), (right - left) / AXLE_M
    towards = pose[2] + 0.5 * turn
    after: Array = pose + np.array([distance * math.cos(towards), distance * math.sin(towards), turn])
    return after
