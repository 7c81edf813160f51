"""Plain tables as logs: `.csv` or `.txt` with named columns, and the columns of BreezySLAM's `.dat` (docs/logs.md).

Tables with a row per beam have a bearing and a range in each, often of any number and spacing; they are put together as
sweeps.
"""

from __future__ import annotations

import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LogError
from mecp_env.core.files import read_bytes
from mecp_env.logs.carmen import MOST_BYTES, PACKED, lines_of
from mecp_env.logs.clock import DAY_S
from mecp_env.logs.columns import JOIN, UNITS, Place, Row, columns_of, flat, number, numbers, parsed, rows_of
from mecp_env.logs.recording import FEWEST_BEAMS, MOST_BEAMS, POSE_BYTES, Geometry, Recording, Sweep

TABLES = (".csv", ".tsv", ".txt", ".dat")
HEAD, SAMPLED = 10, 200  # rows that may tell the names, and where lists are
START = 2**12  # bytes of a table before which it says what it is of
RPLIDAR = re.compile(rb"rplidar|slamtec|angule|theta:\s*[\d.]+\s+dist:", re.IGNORECASE)  # as its tools write it
CELLS = "expected are numbers, and dates as 2024-03-01T12:00:00"
TICKS, WHEEL_M, AXLE_M = 2000, 0.077, 0.330  # of BreezySLAM's `Rover`: ticks of half a turn, wheel radius, wheels apart
MOST_TICKS = 1e18  # of a counter, and microseconds of a stamp
FIRST_RANGE, DAT_VIEW_DEG, DAT_AHEAD_M, DAT_LIMIT_M = 24, 240.0, 0.145, 5.6  # of its URG-04LX
BEARINGS = ("angle", "angule", "bearing", "azimuth", "beam angle", "scan angle", "theta")  # the first of them counts;
# RoboStudio writes `Angule`
RANGES = ("range", "distance", "dist", "rho", "r", "d", "depth")
SCANS = ("scan", "scan id", "scan number", "scan index", "sweep", "sweep id", "revolution", "seq", "frame")
ROW_BYTES = 32  # of a row, without its pose
TURN = 2.0 * math.pi
ABOUT_A_TURN = 1.05 * TURN
LEAST_SHARE = 0.75  # of the usual number of beams: a sweep with fewer is cut off
NEAR_STEPS = 1.5  # of the usual spacing, within which a beam stands for the bearing beside it,
EVEN_STEPS, EVEN_SHARE = 0.1, 0.95  # unless so many bearings are so near to whole spacings: then rows may be missing
LEAST_GAP = math.radians(20.0)  # a wider one is not seen: bearings count from it, whatever they count from in the table
CLOSED_STEPS = 3.0  # by which a view may miss a whole turn


def read_table(path: Path, field_of_view_deg: float | None = None) -> Recording:
    """What is in a table. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, len(data))
    whole = io.BytesIO()  # a list of short lines would take several times as much
    whole.writelines(lines_of(data, recording.counts))
    data = whole.getvalue()
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
    for at, cells, _ in behind:
        words = flat(cells)
        try:
            columns.take(words, at, recording)
        except (ValueError, IndexError):
            recording.damaged("row", at, words)
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
    for at, words, _ in rows_of(data):
        row = numbers(words[:-1])
        if row is None or len(row) < FIRST_RANGE + 2 or not (np.abs(row[:4]) < MOST_TICKS).all():
            recording.damaged("row", at, words)
            continue
        wheels = row[2:4] * math.pi * WHEEL_M / TICKS
        pose, before = pose if before is None else _driven(pose, *(wheels - before)), wheels
        beams = len(row) - FIRST_RANGE
        geometry = Geometry(beams, -0.5 * view, view / (beams - 1), 0.0, DAT_LIMIT_M)
        recording.add(Sweep(1e-6 * row[0], 1e-3 * row[FIRST_RANGE:], geometry, pose, order=float(at)))


def _driven(pose: Array, left: float, right: float) -> Array:
    """(3,) the pose after the wheels went on by so many m."""
    distance, turn = 0.5 * (left + right), (right - left) / AXLE_M
    towards = pose[2] + 0.5 * turn
    after: Array = pose + np.array([distance * math.cos(towards), distance * math.sin(towards), turn])
    return after


@dataclass(frozen=True, slots=True)
class BeamColumns:
    """Which column has what in a table with a row per beam."""

    place: Place
    bearing: int
    distance: int
    scan: int | None
    unit: str  # of the bearing; empty: the name does not say, and those beyond a turn in rad are degrees

    @classmethod
    def of(cls, names: Sequence[str]) -> BeamColumns | None:
        """Those of columns with these names; None where they are those of another table."""
        words = [parsed(name).word for name in names]
        bearing, distance, scan = (_best(words, known) for known in (BEARINGS, RANGES, SCANS))
        if bearing is None or distance is None:
            return None
        place = Place.of(["" if at == bearing else name for at, name in enumerate(names)])
        if not place.complete:  # x and y of the point
            place = replace(place, position=(), heading=())
        return cls(place, bearing, distance, scan, parsed(names[bearing]).unit_name)

    def read(self, rows: Iterable[Row], recording: Recording) -> tuple[Array, list[Array]]:
        """The rows (n,4) that are not damaged: stamp, bearing, m, which sweep (nan: not known); and a pose (3,) each.

        There are no poses where the rows have none. Damaged rows are counted.
        """
        found, poses = array("d"), list[Array]()
        for at, cells, _ in rows:
            recording.take(ROW_BYTES + POSE_BYTES * bool(self.place.position))
            try:
                values, pose = self._row(cells)
            except (ValueError, IndexError):
                recording.damaged("row", at, cells)
                continue
            found.extend(values)
            poses += [] if pose is None else [pose]
        return np.array(found).reshape(-1, 4), poses

    def _row(self, cells: list[str]) -> tuple[tuple[float, ...], Array | None]:
        """What a row has. Raises `ValueError` and `IndexError` for a damaged one."""
        bearing, distance = number(cells[self.bearing]), number(cells[self.distance])
        t, pose = self.place.time(cells), self.place.pose(cells)
        scan = math.nan if self.scan is None else number(cells[self.scan])
        if not math.isfinite(bearing):
            raise ValueError
        return (t, bearing, distance * self.place.units[self.distance], scan), pose


def read_beam_rows(rows: Iterable[Row], columns: BeamColumns, recording: Recording) -> None:
    """The sweeps of a table with a row per beam. Raises `LogError`."""
    found, poses = columns.read(rows, recording)
    if not len(found):
        return
    t, bearing, distance, scan = found.T
    unit = columns.unit or ("degrees" if abs(bearing).max() > ABOUT_A_TURN else "rad")
    bearing = _behind_gap(UNITS[unit] * bearing)
    whole, usual = _whole(_ends(scan, t, bearing), recording)
    recording.notes.append(f"a row per beam: {len(whole)} scans of about {usual} rows, bearings in {unit}")
    geometry, near_steps = _geometry([bearing[part] for part in whole], usual)
    for place, part in enumerate(whole):
        ranges = _on_grid(bearing[part], distance[part], geometry, near_steps * abs(geometry.step_rad))
        pose = poses[part.start] if poses else None
        recording.add(Sweep(float(t[part.start]), ranges, geometry, pose, order=float(place)))


def _behind_gap(bearing: Array) -> Array:
    """Bearings (n,) rad, which jump by a turn only in a part that the laser does not see, where there is one."""
    if np.ptp(bearing) < TURN - LEAST_GAP:
        return bearing
    ring = np.sort(np.remainder(bearing, TURN))
    gaps = np.diff(ring, append=ring[0] + TURN)
    widest = int(gaps.argmax())
    if gaps[widest] < LEAST_GAP:
        return bearing
    middle = ring[widest] + 0.5 * gaps[widest] - TURN
    found: Array = middle + np.remainder(bearing - middle, TURN)
    return found


def _whole(ends: Ints, recording: Recording) -> tuple[list[slice], int]:
    """The rows of each sweep that is not cut off, and their usual number; `ends` (n+1,). Raises `LogError`."""
    usual = int(np.median(np.diff(ends)))
    if not FEWEST_BEAMS <= usual <= MOST_BEAMS:
        raise LogError(f"a row per beam: {usual} rows per scan, {FEWEST_BEAMS} to {MOST_BEAMS} expected")
    parts = [slice(*both) for both in pairwise(ends.tolist())]
    whole = [part for part in parts if part.stop - part.start >= LEAST_SHARE * usual]
    recording.counts["scans of few rows, left out"] += len(parts) - len(whole)
    return whole, usual


def _best(words: list[str], known: Sequence[str]) -> int | None:
    """The column with the first of some names that one column has; several are those of a row per sweep."""
    return next((words.index(word) for word in known if words.count(word) == 1), None)


def _ends(scan: Array, t: Array, bearing: Array) -> Ints:
    """(n+1,) the rows at which sweeps begin, and the end.

    A sweep ends where its number changes, or its stamp, or where the bearings start again.
    """
    for names in (scan, t):
        begins = np.flatnonzero(np.diff(names) != 0.0) + 1
        if np.isfinite(names).all() and len(begins) and (len(begins) + 1) * FEWEST_BEAMS <= len(names):
            return np.concatenate(([0], begins, [len(names)]))
    steps = np.diff(bearing)
    turns = np.sign(np.median(steps)) * steps if len(steps) else steps
    begins = np.flatnonzero(turns < -0.5 * np.ptp(bearing)) + 1
    return np.concatenate(([0], begins, [len(bearing)]))


def _geometry(sweeps: list[Array], beams: int) -> tuple[Geometry, float]:
    """The bearings that the sweeps have, and how many spacings beside one a beam may be.

    Where spacings are even, all of them, though some rows are missing. Else as many beams as a sweep usually has,
    evenly over what they usually see, and over a turn where that is nearly one.
    """
    first = float(np.median([sweep.min() for sweep in sweeps]))
    last = float(np.median([sweep.max() for sweep in sweeps]))
    if even := _even_beams(sweeps, first, last):
        return Geometry(even, first, (last - first) / (even - 1)), 0.5
    step = (last - first) / (beams - 1)
    step = TURN / beams if last - first > TURN - CLOSED_STEPS * step else step
    return Geometry(beams, first, step), NEAR_STEPS


def _even_beams(sweeps: list[Array], first: float, last: float) -> int | None:
    """How many bearings there are from the first to the last; None where they are not evenly spaced."""
    steps = np.concatenate([np.diff(np.sort(sweep)) for sweep in sweeps])
    steps = steps[steps > 0.0]
    beams = round((last - first) / float(np.median(steps))) + 1 if len(steps) else 0
    if not FEWEST_BEAMS <= beams <= MOST_BEAMS:
        return None
    place = (np.concatenate(sweeps) - first) * (beams - 1) / (last - first)
    even = (abs(place - np.rint(place)) < EVEN_STEPS).mean() >= EVEN_SHARE
    return beams if even else None


def _on_grid(bearing: Array, distance: Array, geometry: Geometry, near_rad: float) -> Array:
    """(B,) m of the beams (n,) nearest to each bearing of a geometry; nan where none is near."""
    order = np.argsort(bearing, kind="stable")
    bearing, distance = bearing[order], distance[order]
    ring = np.concatenate((bearing[-1:] - TURN, bearing, bearing[:1] + TURN))
    around = np.concatenate((distance[-1:], distance, distance[:1]))
    after = np.searchsorted(ring, geometry.angles).clip(1, len(ring) - 1)
    nearest = np.where(geometry.angles - ring[after - 1] <= ring[after] - geometry.angles, after - 1, after)
    near = abs(ring[nearest] - geometry.angles) <= near_rad
    return np.where(near, around[nearest], math.nan)
