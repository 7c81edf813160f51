"""Records: a replay gives the figures of the drive itself, to the bit; a wrong file is one error and stays as it is."""

import dataclasses
import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.drives import RecordingEnv, calibration_error, replay, roc_area
from benchmarks.records import Course, RecordError, Records, read_drive
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam.drives import fed

SHORT = Course("two_rooms", 3, {"estimator": "truth", "max_steps": 12})


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


def test_a_record_is_made_once_and_the_same_again(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Records(tmp_path / "again").drive(SHORT)
    assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()
    monkeypatch.setattr(Course, "drive", None)
    assert len(Records(path.parent).drive(SHORT).scans) == 15


@pytest.mark.parametrize(
    "course",
    [
        SHORT,
        Course("two_rooms", 1, {"max_steps": 6, "laser": {"field_of_view_deg": 180.0, "x_m": 0.1, "max_range_m": 4.0}}),
        Course("easy:3", 1, {"max_steps": 6, "robot": {"arcs": 2, "substeps": 8}, "odometry": {"scale": 4.0}}),
    ],
    ids=["whole", "half a view", "generated"],
)
def test_a_replay_of_a_record_is_that_of_the_drive_to_the_bit(course: Course, tmp_path: Path) -> None:
    drive, again = course.drive(), Records(tmp_path).drive(course)
    assert again.slam == drive.slam
    assert len(again.scans) == len(drive.scans) == len(again.odometry) == len(again.T_world_robot)
    for old, new in zip(drive.scans, again.scans, strict=True):
        for name in ("ranges", "bearings", "hit", "max_range_m"):
            np.testing.assert_array_equal(getattr(new, name), getattr(old, name), strict=True)
        assert new.ranges.flags.writeable
        assert new.ranges.flags.c_contiguous
    assert [odometry is None for odometry in again.odometry] == [odometry is None for odometry in drive.odometry]
    assert again.truth.T_robot_laser.tolist() == drive.truth.T_robot_laser.tolist()
    assert again.truth.sees_all_around == drive.truth.sees_all_around
    results = [replay(one, one.slam) for one in (drive, again)]
    figures = [json.dumps(result.counts | {"associate_ms": 0.0}) for result in results]
    assert figures[0] == figures[1]
    np.testing.assert_array_equal(results[0].nees, results[1].nees, strict=True)
    assert results[0].log.rows[: results[0].log.used].tolist() == results[1].log.rows[: results[1].log.used].tolist()


def remade(changes: dict[str, Any], **arrays: Any) -> Callable[[bytes], bytes]:
    """A record with other fields of its header and other arrays, or without those that are None."""

    def make(data: bytes) -> bytes:
        with np.load(io.BytesIO(data)) as archive:
            parts = {**archive}
        text = json.dumps(json.loads(parts["header"].tobytes()) | changes)
        parts |= {"header": np.frombuffer(text.encode(), np.uint8), **arrays}
        buffer = io.BytesIO()
        np.savez(buffer, **{name: part for name, part in parts.items() if part is not None})
        return buffer.getvalue()

    return make


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda data: data[:-500], "damaged"),
        (remade({"format": "mecp_env map"}), "format: 'mecp_env map', expected 'mecp_env record'"),
        (remade({"version": 2, "package": "0.9"}), r"version: 2 \(of mecp_env 0.9\), this .* reads version 1"),
        (remade({"slam": {"filter": {"kindd": "ekf"}}}), "kindd: no such field"),
        (remade({"layout": {"name": "x"}}), "walls|rooms|starts"),
        (remade({"laser": {"x_m": 900.0}}), "x_m"),
        (remade({}, hit=np.empty((15, 4, 720), object)), "damaged"),
        (remade({}, bumper=np.zeros(3, np.bool_)), "damaged"),
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


def test_a_record_of_another_drive_and_one_that_cannot_be_written_are_named(path: Path, tmp_path: Path) -> None:
    other = dataclasses.replace(SHORT, seed=4)
    path.rename(tmp_path / other.file)
    with pytest.raises(RecordError, match=r"the record of .*'seed': 3.*, expected that of .*'seed': 4"):
        read_drive(tmp_path / other.file, other)
    with pytest.raises(RecordError, match=r"two_rooms.*/records/.*: cannot be written"):
        Records(tmp_path / other.file / "records").drive(SHORT)


def test_a_replay_is_the_run_again_to_the_bit() -> None:
    """Seen: each step was recorded twice, and nearest and mecp looked equally bad."""
    env = RecordingEnv(layout="two_rooms", start="random")
    env.reset(seed=4)
    for step in range(25):
        env.step(np.array([0.5, 0.4 * (step % 3 - 1)], np.float32))
    drive, last = env.drive, env.slam_output
    assert len(drive.scans) == len(drive.odometry) == len(drive.T_world_robot) == last.step == 28
    assert [odometry is None for odometry in drive.odometry] == [True] * 3 + [False] * 25
    *_, output = fed(SlamPipeline(drive.slam), drive)
    assert np.array_equal(output.belief.T_map_robot, last.belief.T_map_robot)
    assert np.array_equal(output.belief.p_map, last.belief.p_map)
    assert np.array_equal(output.grid.label, last.grid.label)
    assert replay(drive, drive.slam).error_m[-1] < 0.05


def test_roc_area_is_the_share_of_pairs_in_the_right_order() -> None:
    confidence, error_m = np.array([0.9, 0.8, 0.3, 0.8, 0.1]), np.array([0.1, 0.1, 0.1, 2.0, 2.0])
    assert roc_area(confidence, error_m) == pytest.approx((2 + 1.5 + 1) / 6)
    assert math.isnan(roc_area(confidence[:3], error_m[:3]))
    sure = np.array([0.95] * 10 + [0.05] * 10)  # the gap between confidence and frequency
    assert calibration_error(sure, np.array([0.1] * 10 + [2.0] * 10)) == pytest.approx(0.05)
    assert calibration_error(sure, np.array([2.0] * 10 + [0.1] * 10)) == pytest.approx(0.95)
