"""Drives that are recorded once and replayed by every method: the same bits for all, on every machine.

A benchmark asks for the drive of a `Course`. With `--records FOLDER` it is read from that folder, where it is made if
it is missing, and stays; otherwise it is in the folder of the benchmark's unfinished work. A record that is there
counts, whatever code made it: its header names that code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Options, grouped, in_parallel
from benchmarks.drives import Drive, record_drive
from benchmarks.record_file import Arrays, Header, RecordError, load_record, save_record
from mecp_env.core.errors import MecpError
from mecp_env.core.provenance import checksum, dependencies
from mecp_env.core.sensors import LaserView, Odometry, Scan
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import GeneratorSpec, split_seed
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.schema import Layout


@dataclass(frozen=True, slots=True)
class Course:
    """A breadth-first exploration; equal ones give equal drives on one kind of machine."""

    layout: str  # a shipped name, or PRESET:NUMBER, a generated building of the split `test`
    seed: int  # of start and noise
    fields: dict[str, Any] = field(default_factory=dict)  # of the environment, as JSON has them

    def building(self) -> Layout:
        """The building. Raises `LayoutError`."""
        preset, is_generated, number = self.layout.partition(":")
        if not is_generated:
            return load_layout(preset)
        return load_layout(generate(GeneratorSpec.preset(preset), split_seed("test", int(number))))

    def drive(self) -> Drive:
        """The robot explores."""
        return record_drive(self.building(), self.seed, **self.fields)

    @property
    def file(self) -> str:
        """The name of its record."""
        return f"{re.sub('[^a-z0-9]+', '_', self.layout)}-{self.seed}-{checksum(json.dumps(asdict(self)).encode())}.npz"


@dataclass(frozen=True, slots=True)
class Records:
    """The records in a folder; without one, every drive is made anew and stays in memory."""

    folder: Path | None = None

    def drive(self, course: Course) -> Drive:
        """The drive of a course. Raises `RecordError` for a record that is wrong, or cannot be written."""
        if self.folder is None:
            return course.drive()
        path = self.folder / course.file
        if not path.exists():
            _save(path, *record_of(course, course.drive()))
        return read_drive(path, course)


IN_MEMORY = Records()


def on_records(task: Callable[..., Any], kind: Any, units: Sequence[Any], options: Options) -> dict[Any, list[Any]]:
    """The results of `task` for each unit, on the records of a run, grouped by all but the number of their unit."""
    return grouped(units, in_parallel(partial(task, records=Records(options.records)), kind, units, options))


def _save(path: Path, header: Header, arrays: Arrays) -> None:
    try:
        save_record(path, header, arrays)
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror}") from None


def record_of(course: Course, drive: Drive) -> tuple[Header, Arrays]:
    """What the record of a drive holds."""
    first = drive.scans[0]
    assert all(np.array_equal(scan.bearings, first.bearings) for scan in drive.scans)
    moved = [odometry for odometry in drive.odometry if odometry is not None]
    arrays: Arrays = {
        "ranges": np.array([scan.ranges for scan in drive.scans]),
        "hit": np.array([scan.hit for scan in drive.scans]),
        "bearings": first.bearings,
        "arcs": np.array([-1 if odometry is None else len(odometry.increments) for odometry in drive.odometry]),
        "increments": np.concatenate([np.empty((0, 2)), *(odometry.increments for odometry in moved)]),
        "increment_cov": np.concatenate([np.empty((0, 2, 2)), *(odometry.cov for odometry in moved)]),
        "bumper": np.array([odometry is not None and odometry.bumper for odometry in drive.odometry]),
        "T_world_robot": np.array(drive.T_world_robot),
    }
    scans, sweeps, beams = arrays["ranges"].shape
    header = Header(
        asdict(course),
        course.building().model_dump(mode="json"),
        {name: getattr(drive.truth.view, name) for name in LaserView.model_fields},
        first.max_range_m,
        drive.slam.model_dump(mode="json"),
        dependencies(),
        {"scans": scans, "sweeps": sweeps, "beams": beams, "readings": len(arrays["increments"])},
    )
    return header, arrays


def read_drive(path: Path, course: Course | None = None) -> Drive:
    """The drive in a record, of any course or of the given one. Raises `RecordError`."""
    header, arrays = load_record(path)
    if course is not None and header.course != asdict(course):
        raise RecordError(f"{path}: the record of {header.course!s:.200}, expected that of {asdict(course)!s:.200}")
    try:
        outline, slam = build_outline(load_layout(header.layout)), SlamConfig(**SlamConfig.without_gone(header.slam))
        truth = GroundTruth(outline, header.max_range_m, LaserView(**header.laser))
    except MecpError as error:
        raise RecordError(f"{path}: {error}") from None
    scans = [Scan(*pair, header.max_range_m) for pair in _beams(arrays)]
    return Drive(truth, slam, _odometry(path, arrays), scans, list(arrays["T_world_robot"]))


def _beams(arrays: Arrays) -> list[tuple[Any, Any, Any]]:
    """Ranges, bearings and hits of each scan."""
    return [(ranges, arrays["bearings"], hit) for ranges, hit in zip(arrays["ranges"], arrays["hit"], strict=True)]


def _odometry(path: Path, arrays: Arrays) -> list[Odometry | None]:
    """The odometry before each scan, None at rest at the start. Raises `RecordError`."""
    arcs = arrays["arcs"]
    if arcs.min(initial=0) < -1 or arcs[arcs > 0].sum() != len(arrays["increments"]):
        raise RecordError(f"{path}: damaged: arcs do not add up to {len(arrays['increments'])} readings")
    last = np.cumsum(np.maximum(arcs, 0))
    parts = zip(arcs.tolist(), (last - np.maximum(arcs, 0)).tolist(), arrays["bumper"].tolist(), strict=True)
    return [
        Odometry(arrays["increments"][at : at + n], arrays["increment_cov"][at : at + n], bumper) if n >= 0 else None
        for n, at, bumper in parts
    ]
