"""Records: a replay gives the figures of the drive itself, to the bit; a wrong file is one error and stays as it is."""

import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import association, common, kidnap, noise, record
from benchmarks.common import Options
from benchmarks.drives import Drive, replay
from benchmarks.records import HEADER, Course, RecordError, Records, load_record, read_drive, save_record

SHORT = Course("two_rooms", 3, {"estimator": "truth", "max_steps": 12})


@pytest.fixture(scope="module")
def drive() -> Drive:
    return SHORT.drive()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("records")
    Records(folder).drive(SHORT)
    return folder / SHORT.file


@pytest.fixture
def path(made: Path, tmp_path: Path) -> Path:
    copy = tmp_path / made.name
    copy.write_bytes(made.read_bytes())
    return copy


def test_a_replay_of_a_record_is_that_of_the_drive_to_the_bit(drive: Drive, made: Path, tmp_path: Path) -> None:
    again = read_drive(made, SHORT)
    Records(tmp_path).drive(SHORT)
    assert (tmp_path / made.name).read_bytes() == made.read_bytes()
    assert again.slam == drive.slam
    assert len(again.scans) == len(drive.scans) == len(again.odometry) == len(again.T_world_robot)
    for old, new in zip(drive.scans, again.scans, strict=True):
        for name in ("ranges", "bearings", "hit", "max_range_m"):
            np.testing.assert_array_equal(getattr(new, name), getattr(old, name), strict=True)
        assert new.ranges.flags.writeable
        assert new.ranges.flags.c_contiguous
    assert [odometry is None for odometry in again.odometry] == [odometry is None for odometry in drive.odometry]
    np.testing.assert_array_equal(again.truth.outline.segments, drive.truth.outline.segments)
    replays = [replay(one, one.slam) for one in (drive, again)]
    figures = [json.dumps(one.counts | {"associate_ms": 0.0}) for one in replays]
    assert figures[0] == figures[1]
    for name in ("error_m", "nees"):
        np.testing.assert_array_equal(getattr(replays[0], name), getattr(replays[1], name), strict=True)


@pytest.mark.parametrize(
    "course",
    [
        Course("two_rooms", 1, {"max_steps": 6, "laser": {"field_of_view_deg": 180.0, "x_m": 0.1, "max_range_m": 4.0}}),
        Course("easy:3", 1, {"max_steps": 6, "robot": {"arcs": 2, "substeps": 8}, "odometry": {"scale": 4.0}}),
    ],
    ids=["half a view", "generated"],
)
def test_sensors_and_buildings_of_every_kind_come_back(course: Course, tmp_path: Path) -> None:
    drive, again = course.drive(), Records(tmp_path).drive(course)
    results = [replay(one, one.slam) for one in (drive, again)]
    np.testing.assert_array_equal(results[0].nees, results[1].nees, strict=True)
    assert again.truth.T_robot_laser.tolist() == drive.truth.T_robot_laser.tolist()
    assert again.truth.sees_all_around == drive.truth.sees_all_around
    assert results[0].log.rows[: results[0].log.used].tolist() == results[1].log.rows[: results[1].log.used].tolist()


def remade(changes: dict[str, Any], **arrays: Any) -> Callable[[bytes], bytes]:
    """A record with other fields of its header and other arrays, or without those that are None."""

    def make(data: bytes) -> bytes:
        with np.load(io.BytesIO(data)) as archive:
            parts = {**archive}
        text = json.dumps(json.loads(parts[HEADER].tobytes()) | changes)
        parts |= {HEADER: np.frombuffer(text.encode(), np.uint8), **arrays}
        buffer = io.BytesIO()
        np.savez(buffer, **{name: part for name, part in parts.items() if part is not None})
        return buffer.getvalue()

    return make


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda data: data[:-500], "damaged"),
        (lambda data: data[:4000] + b"\0" * 400 + data[4400:], "damaged"),
        (remade({"format": "mecp_env map"}), "format: 'mecp_env map', expected 'mecp_env record'"),
        (remade({"version": 2, "package": "0.9"}), r"version: 2 \(of mecp_env 0.9\), this .* reads version 1"),
        (remade({"secret": 1}), "damaged: its content hash is that of another content"),
        (remade({}, hit=np.empty((15, 4, 720), object)), "damaged"),
        (remade({}, T_world_robot=None), "damaged"),
    ],
)
def test_a_wrong_record_is_one_error_that_names_it_and_stays_as_it_is(
    damage: Callable[[bytes], bytes], named: str, path: Path
) -> None:
    wrong = damage(path.read_bytes())
    path.write_bytes(wrong)
    with pytest.raises(RecordError, match=named) as raised:
        Records(path.parent).drive(SHORT)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)
    assert path.read_bytes() == wrong


def test_a_record_is_made_once_and_contents_that_do_not_fit_are_named(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Course, "drive", None)
    assert len(Records(path.parent).drive(SHORT).scans) == 15
    header, arrays = load_record(path)
    for changes, moved, named in (
        ({"slam": {"filter": {"kindd": "ekf"}}}, 0, "kindd: no such field"),
        ({"layout": {"name": "x"}}, 0, "walls|rooms|starts"),
        ({"laser": {"x_m": 900.0}}, 0, "x_m"),
        ({}, 1, "arcs do not add up to 48 readings"),
    ):
        save_record(path, header | changes, arrays | {"arcs": arrays["arcs"] + moved})
        with pytest.raises(RecordError, match=named):
            read_drive(path)
    other = dataclasses.replace(SHORT, seed=4)
    save_record(tmp_path / other.file, header, arrays)
    with pytest.raises(RecordError, match=r"the record of .*'seed': 3.*, expected that of .*'seed': 4"):
        Records(tmp_path).drive(other)
    monkeypatch.undo()
    with pytest.raises(RecordError, match=r"two_rooms.*/records/.*: cannot be written"):
        Records(path / "records").drive(SHORT)


def test_the_command_record_makes_each_drive_once_in_shards_or_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    courses = [dataclasses.replace(SHORT, seed=seed) for seed in range(3)]
    monkeypatch.setattr(record, "COURSES", {"a": lambda most: courses[:most], "b": lambda most: courses[1:]})
    monkeypatch.setattr(common, "UNITS", tmp_path / "units")
    monkeypatch.setattr(common, "calibration_ms", lambda: 5.0)
    folder = tmp_path / "records"
    for number in (1, 2):
        assert command.main(["record", "--records", str(folder), "--shard", f"{number}/2"]) == 0
    written = {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert set(written) == {course.file for course in courses}
    assert command.main(["record", "--records", str(folder)]) == 0
    page = capsys.readouterr().out
    assert command.main(["record", "--records", str(folder)]) == 0
    assert capsys.readouterr().out == page[page.index("# Benchmark") :]
    assert {file.name: file.stat().st_mtime_ns for file in folder.iterdir()} == written
    assert not (tmp_path / "units" / "record").exists()
    assert "| a | 3 | 45 |" in page
    assert "| b | 2 | 30 |" in page


def test_every_experiment_on_drives_can_be_recorded() -> None:
    numbers = {name: len(of(record.ALL)) for name, of in record.COURSES.items()}
    assert numbers["association"] == sum(association.SETS.values())
    assert numbers["kidnap"] == 2 * sum(kidnap.SETS.values())
    assert numbers["noise"] == len(noise.RECORDED) * noise.SETS[noise.BASE]
    assert set(record.COURSES) < set(command.ON_RECORDS)
    shared = {course.file for course in record.COURSES["loop"](record.ALL)}
    assert {course.file for course in record.COURSES["clutter"](record.ALL)} <= shared
    assert all(len(of(1)) <= len(of(2)) for of in record.COURSES.values())
    assert Options().records is None
