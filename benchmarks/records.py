"""Drives that are recorded once and replayed by every method: the same bits for all, on every machine.

A benchmark asks for the drive of a `Course`. With `--records FOLDER` it is read from that folder, where it is made if
it is missing, and stays; otherwise it is in the folder of the benchmark's unfinished work. A record that is there
counts, whatever code made it: its header names that code.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Figures, Options, grouped, in_parallel, runs_of, shared_data
from benchmarks.drives import Drive, record_drive
from benchmarks.tables import by_row
from mecp_env import __version__
from mecp_env.core.errors import MecpError
from mecp_env.core.files import write_atomic
from mecp_env.core.provenance import checksum, dependencies
from mecp_env.core.sensors import LaserView, Odometry, Scan
from mecp_env.core.snapshot_file import FileKind, check_header
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.floorplans import load_plan
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import GeneratorSpec, split_seed
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.schema import Layout

KIND = FileKind("mecp_env record", 1, __version__)
HARD = "hard"  # the set of drives that are each in a generated building of its own
KTH = "kth"  # the folder of the labelled plans


class RecordError(MecpError):
    """A record is damaged, of another format or version, or of another drive."""


@dataclass(frozen=True, slots=True)
class Course:
    """A breadth-first exploration; equal ones give equal drives on one kind of machine."""

    layout: str  # a shipped name, PRESET:NUMBER or TASK:NUMBER, a building of the split `test`, or kth:NUMBER, a plan
    seed: int  # of start and noise
    fields: dict[str, Any] = field(default_factory=dict)  # of the environment, as JSON has them

    def building(self) -> Layout:
        """The building. Raises `LayoutError`."""
        name, is_one_of_many, number = self.layout.partition(":")
        if not is_one_of_many:
            return load_layout(name)
        if name == KTH:
            return load_plan(kth_plans()[int(number)])
        fields = TASKS.get(name, {"difficulty": name})
        spec = {key: value for key, value in fields.items() if key in ("difficulty", *GeneratorSpec.model_fields)}
        return load_layout(generate(GeneratorSpec.preset(**spec), split_seed("test", int(number))))

    def drive(self) -> Drive:
        """The robot explores."""
        return record_drive(self.building(), self.seed, **self.fields)

    @property
    def file(self) -> str:
        """The name of its record."""
        return f"{re.sub('[^a-z0-9]+', '_', self.layout)}-{self.seed}-{checksum(json.dumps(asdict(self)).encode())}.npz"


@dataclass(frozen=True, slots=True)
class Records:
    """The records in a folder; without one, every drive is driven again and stays in memory."""

    folder: Path | None = None

    def drive(self, course: Course) -> Drive:
        """The drive of a course. Raises `RecordError` for a record that is wrong, or cannot be written."""
        if self.folder is None:
            return course.drive()
        path = self.folder / course.file
        if not path.exists():
            save_record(path, course, course.drive())
        return read_drive(path, course)


IN_MEMORY = Records()


def kth_plans() -> list[Path]:
    """The labelled plans of `shared/data` beside the repository; none elsewhere."""
    folder = shared_data("plans")
    return [] if folder is None else sorted((folder / KTH).glob("*.yaml"))


def place(layout: str, number: int) -> str:
    """The layout of a course: a shipped one, or the generated building of that number."""
    return f"{HARD}:{number}" if layout == HARD else layout


def on_records(task: Callable[..., Any], kind: Any, units: Sequence[Any], options: Options) -> dict[Any, list[Any]]:
    """The results of `task` for each unit, on the records of a run, grouped by all but the number of their unit."""
    return grouped(units, in_parallel(partial(task, records=Records(options.records)), kind, units, options))


def on_drives(
    task: Callable[..., dict[str, Figures]], sets: Mapping[str, int], options: Options
) -> dict[str, dict[str, list[Figures]]]:
    """By set and row, what `task` gives for each drive: figures by row. A part of the time gives a part of each set."""
    drives = sorted(runs_of(options, sets), key=lambda drive: drive[1])
    return {name: by_row(runs) for name, runs in on_records(task, dict[str, Figures], drives, options).items()}


def save_record(path: Path, course: Course, drive: Drive) -> None:
    """Write a record, whole or not at all. Raises `RecordError`."""
    first, moved = drive.scans[0], [odometry for odometry in drive.odometry if odometry is not None]
    assert all(np.array_equal(scan.bearings, first.bearings) for scan in drive.scans)
    header = {
        **KIND._asdict(),
        "course": asdict(course),
        "layout": course.building().model_dump(mode="json"),
        "laser": {name: getattr(drive.truth.view, name) for name in LaserView.model_fields},
        "max_range_m": first.max_range_m,
        "slam": drive.slam.model_dump(mode="json"),  # the estimator during the drive
        "made_by": dependencies(),  # code, libraries and machine
    }
    buffer = io.BytesIO()
    np.savez(
        buffer,
        allow_pickle=False,
        header=np.frombuffer(json.dumps(header).encode(), np.uint8),
        ranges=np.array([scan.ranges for scan in drive.scans]),  # (scans,sweeps,beams) m
        hit=np.array([scan.hit for scan in drive.scans]),  # (scans,sweeps,beams)
        bearings=first.bearings,  # (sweeps,beams) rad, those of every scan
        arcs=np.array([-1 if odometry is None else len(odometry.increments) for odometry in drive.odometry]),
        increments=np.concatenate([np.empty((0, 2)), *(odometry.increments for odometry in moved)]),
        increment_cov=np.concatenate([np.empty((0, 2, 2)), *(odometry.cov for odometry in moved)]),
        bumper=np.array([odometry is not None and odometry.bumper for odometry in drive.odometry]),
        T_world_robot=np.array(drive.T_world_robot),  # (scans,3) m, rad: true pose of each scan
    )
    try:
        write_atomic(path, buffer.getvalue())
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror}") from None


def read_drive(path: Path, course: Course | None = None) -> Drive:
    """The drive in a record, of any course or of the given one. Raises `RecordError` that names the file."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)  # each has a checksum
        header = json.loads(arrays.pop("header").tobytes())
        check_header(header, KIND)
        if course is not None and header["course"] != asdict(course):
            raise RecordError(f"the record of {header['course']!s:.200}, expected that of {asdict(course)!s:.200}")
        return _drive_of(header, arrays)
    except MecpError as error:
        raise RecordError(f"{path}: {error}") from None
    except Exception as error:  # damaged bytes may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise RecordError(f"{path}: damaged ({reason:.120})") from None


def _drive_of(header: dict[str, Any], arrays: dict[str, Any]) -> Drive:
    """The drive of what a record holds."""
    outline, range_m = build_outline(load_layout(header["layout"])), header["max_range_m"]
    slam = SlamConfig(**header["slam"])
    pairs = zip(arrays["ranges"], arrays["hit"], strict=True)
    scans = [Scan(ranges, arrays["bearings"], hit, range_m) for ranges, hit in pairs]
    ends = np.cumsum(np.maximum(arrays["arcs"], 0))[:-1]  # of the readings before each scan; -1: at rest at the start
    parts = (np.split(arrays[name], ends) for name in ("increments", "increment_cov"))
    rows = zip(arrays["arcs"].tolist(), *parts, arrays["bumper"].tolist(), strict=True)
    odometry = [None if arcs < 0 else Odometry(increments, cov, bumper) for arcs, increments, cov, bumper in rows]
    truth = GroundTruth(outline, range_m, LaserView(**header["laser"]))
    return Drive(truth, slam, odometry, scans, list(arrays["T_world_robot"]))
