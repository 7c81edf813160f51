"""Every format gives the same log, and what is wrong in a file is one clear error or counted."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.odometry_model import arcs, reading
from mecp_env.world.config import OdometryConfig
from tests.logs.files import (
    BEAMS,
    BEARINGS,
    CARMEN,
    MOUNT,
    drive,
    flaser,
    rawlaser,
    write_archive,
    write_bag,
    write_carmen,
)


def check(log: Log, digits: float = 1e-5) -> None:
    t, poses, ranges = drive()
    np.testing.assert_allclose(log.t, t, atol=1e-6)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=digits)
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=digits)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT, atol=digits)
    known = np.isfinite(log.ranges)
    assert known.sum() >= ranges.size - 1
    np.testing.assert_allclose(log.ranges[known], ranges[known], atol=digits)
    scan = log[3].scan
    assert scan.ranges.shape == scan.bearings.shape == scan.hit.shape == (1, BEAMS)
    assert log.field_of_view_deg == pytest.approx(180.0)


@pytest.mark.parametrize("line", CARMEN)
def test_carmen(tmp_path: Path, line: str) -> None:
    log = read_log(write_carmen(tmp_path / "a.log", CARMEN[line]))
    check(log)
    assert not log.counts


def test_packed(tmp_path: Path) -> None:
    data = gzip.compress(write_carmen(tmp_path / "a.log").read_bytes())
    (tmp_path / "a.log.gz").write_bytes(data)
    check(read_log(tmp_path / "a.log.gz"))
    random = np.random.default_rng(0).integers(0, 256, 10**6).astype(np.uint8).tobytes()  # does not pack
    long = write_carmen(tmp_path / "a.log").read_bytes() + b"\n# " + random.replace(b"\n", b"") + b"\n"
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(long)[:-1000])
    log = read_log(tmp_path / "b.log.gz")
    check(log)
    assert log.counts == {"packed file cut short or damaged": 1}
    for damaged in (b"", data[:5], b"no gzip"):
        (tmp_path / "c.log.gz").write_bytes(damaged)
        with pytest.raises(LogError, match=r"c.log.gz: no"):
            read_log(tmp_path / "c.log.gz")


def test_archive(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz"))
    check(log)
    assert log.counts == {"readings without a return": 1}
    assert not log[2].scan.hit[0, 3]
    assert log[2].scan.ranges[0, 3] == log.max_range_m
    np.testing.assert_array_equal(log.T_ref_robot, log.T_odom_robot)


@pytest.mark.parametrize("suffix", [".bag", "", ".db3", ".mcap"])
def test_bag(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("rosbags")
    check(read_log(write_bag(tmp_path / f"a{suffix}")))


def test_frames_of_a_bag_without_fixed_ones(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    check(read_log(write_bag(tmp_path / "a.bag", frames="/tf")))
    np.testing.assert_array_equal(read_log(write_bag(tmp_path / "b.bag", frames="/other")).T_robot_laser, np.zeros(3))


def test_a_bag_without_its_index_names_the_remedy(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / "a.bag")
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(LogError, match="rosbag reindex"):
        read_log(path)


def test_two_lasers(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / "a.bag", scan_topics=("/front", "/rear"))
    with pytest.raises(LogError, match=r"--scan-topic: 2 topics .* /front, /rear"):
        read_log(path)
    check(read_log(path, ReadOptions(scan_topic="/front")))
    with pytest.raises(LogError, match=r"'/fron'; did you mean '/front'.*/odom"):
        read_log(path, ReadOptions(scan_topic="/fron"))


def test_without_laser_or_odometry(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    with pytest.raises(LogError, match=r"no laser.*/odom"):
        read_log(write_bag(tmp_path / "a.bag", scan_topics=()))
    assert read_log(write_bag(tmp_path / "b.bag", odometry=False)).T_odom_robot is None
    assert read_log(write_archive(tmp_path / "c.npz", odo=None)).T_odom_robot is None
    (tmp_path / "d.log").write_text("ODOM 0 0 0 0 0 0 1.0 host 1.0\n")
    with pytest.raises(LogError, match="no laser"):
        read_log(tmp_path / "d.log")


@pytest.mark.parametrize("name", ["a.log", "a.npz", "a.bag", "a.db3", "a.mcap", "a.txt", "a"])
@pytest.mark.parametrize("content", [b"", b"\x00\xff garbage \n" * 50])
def test_no_log(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=name):
        read_log(tmp_path / name)


def test_folder_and_missing(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="a folder without a bag"):
        read_log(tmp_path)
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "b.log")
    (tmp_path / "c.log").mkdir()
    with pytest.raises(LogError, match="folder"):
        read_log(tmp_path / "c.log")


def lines_of(tmp_path: Path) -> list[str]:
    return write_carmen(tmp_path / "a.log").read_text().splitlines()


def reread(tmp_path: Path, lines: list[str]) -> Log:
    (tmp_path / "a.log").write_text("\n".join(lines))
    return read_log(tmp_path / "a.log")


def test_truncated_in_a_line(tmp_path: Path) -> None:
    text = "\n".join(lines_of(tmp_path))
    log = reread(tmp_path, [text[: len(text) * 2 // 3]])
    assert 6 <= len(log) <= 8
    assert log.counts == {"damaged lines": 1}


def test_stamps(tmp_path: Path) -> None:
    lines = lines_of(tmp_path)
    swapped = [*lines[:5], lines[6], lines[5], *lines[7:], lines[-1]]
    log = reread(tmp_path, swapped)
    assert (np.diff(log.t) > 0.0).all()
    assert log.counts["scans that repeat the one before"] == 1
    assert log.counts["scans with an impossible stamp, or out of order, placed by their lines"] == 1
    assert len(log) == log.found - 1 == 12
    t, poses, ranges = drive()
    t[4], t[7] = 9e9, -5.0
    log = reread(tmp_path, [flaser(*row) for row in zip(t, poses, ranges, strict=True)])
    assert len(log) == 12
    assert (np.diff(log.t) > 0.0).all()
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-5)


def test_other_beams(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    rows = [flaser(*row) for row in zip(t, poses, ranges, strict=True)]
    rows[3] = flaser(t[3], poses[3], ranges[3, ::2])
    log = reread(tmp_path, rows)
    assert log.counts["scans with other beams, resampled"] == 1
    np.testing.assert_allclose(log.ranges[3, ::2], ranges[3, ::2])


def test_readings_that_measure_nothing(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    ranges[1, :5] = np.nan, np.inf, -1.0, 0.0, 81.91
    log = reread(tmp_path, [flaser(*row) for row in zip(t, poses, ranges, strict=True)])
    assert not log[1].scan.hit[0, :5].any()
    assert log[1].scan.hit[0, 5:].all()
    assert log.counts == {"readings below the least range": 2, "readings without a return": 3}
    assert log.max_range_m == pytest.approx(0.99 * 81.91)


def test_jump_of_the_odometry(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    poses[6:, 0] += 50.0
    log = reread(tmp_path, [flaser(*row) for row in zip(t, poses, ranges, strict=True)])
    assert log.counts == {"jumps of the odometry, taken as no motion": 1}
    assert abs(np.diff(log.T_odom_robot[:, 0])).max() < 0.1


def test_corrected_laser_poses_are_a_reference(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    drift = poses * 1.5
    rows = [flaser(*row).split() for row in zip(t, drift, ranges, strict=True)]
    for row, pose in zip(rows, poses, strict=True):
        row[2 + BEAMS : 5 + BEAMS] = [f"{x:.6f}" for x in pose]
    log = reread(tmp_path, [" ".join(row) for row in rows])
    np.testing.assert_allclose(log.T_ref_robot, poses, atol=1e-5)
    np.testing.assert_allclose(log.T_odom_robot, drift, atol=1e-5)


def test_options(tmp_path: Path) -> None:
    path = write_archive(tmp_path / "a.npz")
    narrow = read_log(path, ReadOptions(field_of_view_deg=90.0, max_range_m=3.0))
    assert narrow.field_of_view_deg == pytest.approx(90.0)
    assert len(narrow.bearings) == 19
    assert np.nanmax(narrow.ranges) < 3.0
    wide = read_log(write_carmen(tmp_path / "a.log"), ReadOptions(field_of_view_deg=270.0))
    assert wide.field_of_view_deg == pytest.approx(270.0)


def test_full_circle(tmp_path: Path) -> None:
    angles = np.radians(np.arange(0.0, 361.0, 1.0))  # the last beam repeats the first
    path = write_archive(tmp_path / "a.npz", angles=angles, ranges=np.tile(1.0 + angles, (12, 1)))
    log = read_log(path)
    assert len(log.bearings) == 360
    assert (np.diff(log.bearings) > 0.0).all()
    assert -np.pi < log.bearings[0]
    assert log.bearings[-1] <= np.pi
    np.testing.assert_allclose(log.ranges[0], 1.0 + log.bearings % (2.0 * np.pi))
    assert log.field_of_view_deg == 360.0


@pytest.mark.parametrize("wrong", [{"ref": np.zeros((11, 3))}, {"angles": np.zeros(BEAMS)}, {"t": np.zeros((12, 2))}])
def test_wrong_shapes(tmp_path: Path, wrong: dict[str, np.ndarray]) -> None:
    with pytest.raises(LogError, match=next(iter(wrong)) if "angles" not in wrong else "laser"):
        read_log(write_archive(tmp_path / "a.npz", **wrong))


def test_missing_arrays(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no angles in the archive, only"):
        read_log(write_archive(tmp_path / "a.npz", angles=None))
    np.savez(tmp_path / "b.npz", t=np.array([{}], object), ranges=0.0, angles=0.0)
    with pytest.raises(LogError, match="damaged"):
        read_log(tmp_path / "b.npz")


def test_a_log_is_immutable(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz"))
    for array in (log.t, log.ranges, log.bearings, log.T_odom_robot, log.T_ref_robot, log.relations):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(TypeError):
        log.counts["x"] = 1  # type: ignore[index]
    assert len(log[2:5]) == 3
    assert log[-1].t == log.t[-1]


def test_the_python_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (Path(__file__).parents[2] / "docs/logs.md").read_text()
    own, smoothed, of_a_log, stream = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    rows = [" ".join(f"{x:g}" for x in (t, *pose, *one)) for t, pose, one in zip(*drive(), strict=True)]
    (tmp_path / "robot.txt").write_text("\n".join(rows))
    exec(own, {})
    np.testing.assert_allclose(read_log("robot.npz").T_odom_robot, drive()[1], atol=1e-5)
    write_archive(tmp_path / "drive.npz")
    exec(of_a_log, {})
    assert "12 {'readings without a return': 1} 0.0" in capsys.readouterr().out
    log, poses = read_log("drive.npz"), drive()[1]
    readings = [reading(arcs(T), OdometryConfig()) for T in between(poses[:-1], poses[1:])]
    exec(smoothed, {"stream": zip([None, *readings], map(log.scan, range(len(log))), strict=True)})
    assert capsys.readouterr().out.startswith(f"{poses.shape} (")
    _, poses, ranges = drive()
    exec(stream, {"sensor_stream": lambda: zip(ranges, poses, strict=True), "bearings": BEARINGS})
    said = capsys.readouterr().out
    assert "at least 30 needed" in said  # for a calibration
    x, y, heading = (float(word) for word in re.findall(r"-?\d+\.\d+", said)[-3:])
    assert (x, y, heading) == pytest.approx(poses[-1], abs=0.03)


def test_a_name_says_nothing_of_packing_and_any_case_is_read(tmp_path: Path) -> None:
    data = write_carmen(tmp_path / "a.log").read_bytes()
    (tmp_path / "b.log").write_bytes(gzip.compress(data))
    (tmp_path / "c.log.gz").write_bytes(data)
    (tmp_path / "D.LOG").write_bytes(data)
    (tmp_path / "E.NPZ").write_bytes(write_archive(tmp_path / "e.npz").read_bytes())
    for name in ("b.log", "c.log.gz", "D.LOG", "E.NPZ"):
        check(read_log(tmp_path / name))


def test_lines_that_are_all_damaged_are_shown(tmp_path: Path) -> None:
    lines = [line.replace(f"FLASER {BEAMS}", f"FLASER {BEAMS - 1}") for line in lines_of(tmp_path)]
    with pytest.raises(LogError, match=rf"12 damaged lines\); line 3 is the first that is damaged: FLASER {BEAMS - 1}"):
        reread(tmp_path, lines)


@pytest.mark.parametrize("option", ["scan_topic", "scan_frame", "odometry_topic"])
def test_options_of_bags_are_no_options_of_other_logs(tmp_path: Path, option: str) -> None:
    for path in (write_archive(tmp_path / "a.npz"), write_carmen(tmp_path / "a.log")):
        with pytest.raises(LogError, match=f"--{option.replace('_', '-')}: .*'/x'"):
            read_log(path, ReadOptions(**{option: "/x"}))


@pytest.mark.parametrize("line", CARMEN)
def test_odometry_can_be_left_out(tmp_path: Path, line: str) -> None:
    log = read_log(write_carmen(tmp_path / "a.log", CARMEN[line]), ReadOptions(use_odometry=False))
    assert log.T_odom_robot is None
    assert len(log) == 12
    np.testing.assert_allclose(log.T_robot_laser, MOUNT, atol=1e-5)


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"\n<!DOCTYPE html>\n", "a web page"),
        (b"\xfd7zXZ\x00", "xz: unpack"),
        (b"PK\x03\x04", "zip: unpack"),
        ("t,x,y,heading".encode("utf-16"), "UTF-8"),
    ],
)
@pytest.mark.parametrize("name", ["a.log", "a.csv", "a.bag", "a.zip"])
def test_files_that_are_something_else(tmp_path: Path, name: str, start: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(start + b"x" * 100)
    with pytest.raises(LogError, match=f"{name}: not a log as it is.*{said}"):
        read_log(tmp_path / name)


def test_a_mark_of_the_byte_order_is_no_part_of_the_first_line(tmp_path: Path) -> None:
    lines = [line for line in lines_of(tmp_path) if line.startswith("FLASER")]
    log = reread(tmp_path, ["\ufeff" + lines[0], *lines[1:]])
    assert len(log) == 12
    assert not log.counts


def test_lines_of_other_messages_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"12 lines of another laser, the first of others: 'RLASER'"):
        reread(tmp_path, [line.replace("FLASER", "RLASER") for line in lines_of(tmp_path)])


def test_poses_that_never_change_give_way_to_odometry_that_does(tmp_path: Path) -> None:
    rows = []
    for t, pose, one in zip(*drive(), strict=True):
        rows += [rawlaser(t, pose, one).splitlines()[0], flaser(t, 0.0 * pose, one)]
    log = reread(tmp_path, ["PARAM robot_frontlaser_offset 0.1", *rows])
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=1e-5)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT)


def test_a_laser_without_a_mounting_pose_is_named(tmp_path: Path) -> None:
    assert any("taken as centred" in note for note in read_log(write_archive(tmp_path / "a.npz", mount=None)).notes)
    assert not read_log(write_archive(tmp_path / "b.npz")).notes
