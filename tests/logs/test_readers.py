"""Every format gives the same log, and what is wrong in a file is one clear error or counted."""

import gzip
import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError, LogError
from mecp_env.core.se2 import between
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.odometry_model import arcs, reading
from mecp_env.policies.suites import read_submission
from mecp_env.render.replay_page import ReplayError, read_page
from mecp_env.world.config import OdometryConfig
from tests.logs.files import (
    BEAMS,
    BEARINGS,
    CARMEN,
    MOUNT,
    bag_of,
    check_path,
    drive,
    flaser,
    lines_of,
    rawlaser,
    read_lines,
    write_archive,
    write_bag,
    write_carmen,
)


def check(log: Log) -> None:
    t, _, ranges = drive()
    np.testing.assert_allclose(log.t, t, atol=1e-6)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-5)
    check_path(log)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT, atol=1e-5)
    known = np.isfinite(log.ranges)
    assert known.sum() >= ranges.size - 1
    np.testing.assert_allclose(log.ranges[known], ranges[known], atol=1e-5)
    scan = log[3].scan
    assert scan.ranges.shape == scan.bearings.shape == scan.hit.shape == (1, BEAMS)
    assert log.field_of_view_deg == pytest.approx(180.0)


@pytest.mark.parametrize("line", CARMEN)
def test_carmen(tmp_path: Path, line: str) -> None:
    path = write_carmen(tmp_path / "a.log", CARMEN[line])
    log, without = read_log(path), read_log(path, ReadOptions(use_odometry=False))
    check(log)
    assert not log.counts
    assert without.T_odom_robot is None
    np.testing.assert_allclose(without.T_robot_laser, MOUNT, atol=1e-5)


def test_a_name_says_nothing_of_packing_and_kind_and_any_case_is_read(tmp_path: Path) -> None:
    data, archive = write_carmen(tmp_path / "a").read_bytes(), write_archive(tmp_path / "e.npz").read_bytes()
    packed = gzip.compress(data)
    files = {"a.log.gz": packed, "b.log": packed, "c.log.gz": data, "D.LOG": data, "E.NPZ": archive}
    files |= {"f.csv": data, "g.txt": data.replace(b"\n", b"\r")}  # a log is known by its lines
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        check(read_log(tmp_path / name))


def test_a_packed_file_that_is_cut_short_or_damaged(tmp_path: Path) -> None:
    random = np.random.default_rng(0).integers(0, 256, 10**6).astype(np.uint8).tobytes()  # does not pack
    long = write_carmen(tmp_path / "a").read_bytes() + b"\n# " + random.replace(b"\n", b"") + b"\n"
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(long)[:-1000])
    log = read_log(tmp_path / "b.log.gz")
    check(log)
    assert log.counts == {"packed file cut short or damaged": 1}
    for damaged in (b"", gzip.compress(long)[:5], b"no gzip"):
        (tmp_path / "c.log.gz").write_bytes(damaged)
        with pytest.raises(LogError, match=r"c.log.gz: (no|an empty file)"):
            read_log(tmp_path / "c.log.gz")


def test_archive(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz"))
    check(log)
    assert log.counts == {"readings without a return": 1}
    assert not log[2].scan.hit[0, 3]
    assert log[2].scan.ranges[0, 3] == log.max_range_m
    np.testing.assert_array_equal(log.T_ref_robot, log.T_odom_robot)
    for array in (log.t, log.ranges, log.bearings, log.T_odom_robot, log.T_ref_robot, log.relations):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(TypeError):
        log.counts["x"] = 1  # type: ignore[index]
    assert len(log[2:5]) == 3
    assert log[-1].t == log.t[-1]
    assert not log.notes
    without = read_log(write_archive(tmp_path / "b.npz", mount=None, odo=None))
    assert any("taken as centred" in note for note in without.notes)
    assert without.T_odom_robot is None


@pytest.mark.parametrize("suffix", [".bag", "", ".db3", ".mcap"])
def test_bag(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("rosbags")
    check(read_log(write_bag(tmp_path / f"a{suffix}")))


def test_frames_odometry_and_index_of_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / "a.bag", frames="/tf")
    check(read_log(path))
    np.testing.assert_array_equal(read_log(write_bag(tmp_path / "b.bag", frames="/other")).T_robot_laser, np.zeros(3))
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(LogError, match="rosbag reindex"):
        read_log(path)


def test_which_laser_is_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = write_bag(tmp_path / "a.bag", scan_topics=("/front", "/rear"))
    with pytest.raises(LogError, match=r"--scan-topic: 2 topics .* /front, /rear"):
        read_log(path)
    check(read_log(path, ReadOptions(scan_topic="/front")))
    with pytest.raises(LogError, match=r"'/fron'; did you mean '/front'.*/odom"):
        read_log(path, ReadOptions(scan_topic="/fron"))
    with pytest.raises(LogError, match=r"no laser.*/odom"):
        read_log(write_bag(tmp_path / "b.bag", scan_topics=()))
    with pytest.raises(LogError, match="no laser"):
        read_lines(tmp_path, ["ODOM 0 0 0 0 0 0 1.0 host 1.0"])


GARBAGE = b"\x00\xff garbage \n" * 50
NO_LOGS: list[tuple[str, bytes, str]] = [
    *((name, b"", "an empty file") for name in ("a.log", "a.npz", "a.bag", "a.db3", "a.mcap", "a")),
    *((name, GARBAGE, name) for name in ("a.log", "a.npz", "a")),
    *((name, GARBAGE, "begins as none does") for name in ("a.bag", "a.db3", "a.mcap")),
    *(
        (name, start + b"x" * 100, f"{name}: not a log as it is.*{said}")
        for name in ("a.log", "a.bag")
        for start, said in (
            (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
            (b"\n<!DOCTYPE html>\n", "a web page"),
            (b"\xfd7zXZ\x00", "xz: unpack"),
            (b"PK\x03\x04", "zip: unpack it first, or save a spreadsheet as .csv"),
            (b'{"t": 0.0, "ranges": [1.0, 2.0]}\n', "JSON: write"),
            (b"header:\n  seq: 1\n---\n", "record a bag"),
            ("t,x,y,heading".encode("utf-16"), "UTF-8"),
        )
    ),
    ("a.csv", "t,x\n".encode("utf-16-le"), "UTF-16"),
    ("a.log", b"#ROSBAG V2.0\n", r"\.bag"),
    ("a.bag", b"\x89MCAP0\r\n", r"\.mcap"),
    ("a.csv", b"SQLite format 3\0", r"\.db3"),
    *((name, b"#ROSBAG V2.0\n", r"with \.bag behind its name") for name in ("a.bag.gz", "a.BAG")),
]


@pytest.mark.parametrize(("name", "content", "said"), NO_LOGS)
def test_files_that_are_no_logs_or_not_what_their_name_says(
    tmp_path: Path, name: str, content: bytes, said: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=said):
        read_log(tmp_path / name)


def test_pipes_folders_and_missing_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.log")
    (tmp_path / "c.log").mkdir()
    for name, said in (
        ("", "a folder without a bag"),
        ("a.log", "no plain file"),
        ("b.log", "no such"),
        ("c.log", "fold"),
    ):
        with pytest.raises(LogError, match=said):
            read_log(tmp_path / name)
    for read, error in ((read_page, ReplayError), (read_submission, ConfigError)):
        with pytest.raises(error, match="no plain file"):
            read(tmp_path / "a.log")


def test_lines_that_are_damaged(tmp_path: Path) -> None:
    lines = write_carmen(tmp_path / "a.log").read_text().splitlines()
    text = "\n".join(lines)
    log = read_lines(tmp_path, [text[: len(text) * 2 // 3]])
    assert 6 <= len(log) <= 8
    assert log.counts == {"damaged lines": 1}
    with pytest.raises(LogError, match=rf"12 damaged lines\); line 3 is the first that is damaged: FLASER {BEAMS - 1}"):
        read_lines(tmp_path, [line.replace(f"FLASER {BEAMS}", f"FLASER {BEAMS - 1}") for line in lines])
    with pytest.raises(LogError, match=r"12 lines of another laser, the first of others: 'RLASER'"):
        read_lines(tmp_path, [line.replace("FLASER", "RLASER") for line in lines])
    log = read_lines(tmp_path, ["\ufeff" + lines[2], *lines[3:]])  # the mark of the byte order is no part of the line
    assert (len(log), log.counts) == (12, {})


def test_readings_that_measure_nothing_and_other_beams(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    rows = lines_of(t, poses, ranges)
    rows[3] = flaser(t[3], poses[3], ranges[3, ::2])
    log = read_lines(tmp_path, rows)
    assert log.counts["scans with other beams, resampled"] == 1
    np.testing.assert_allclose(log.ranges[3, ::2], ranges[3, ::2])
    ranges[1, :5] = np.nan, np.inf, -1.0, 0.0, 81.91
    log = read_lines(tmp_path, lines_of(t, poses, ranges))
    assert not log[1].scan.hit[0, :5].any()
    assert log[1].scan.hit[0, 5:].all()
    assert log.counts == {"readings below the least range": 2, "readings without a return": 3}
    assert log.max_range_m == pytest.approx(0.99 * 81.91)


def test_odometry_that_jumps_or_is_far_away(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    jumping = poses + np.outer(np.arange(12) >= 6, [50.0, 0.0, 0.0])
    log = read_lines(tmp_path, lines_of(t, jumping, ranges))
    assert log.counts == {"jumps of the odometry, taken as no motion": 1}
    assert abs(np.diff(log.T_odom_robot[:, 0])).max() < 0.1
    far = poses + np.array([450_000.0, 5_400_000.0, 0.0])  # world coordinates
    check_path(read_lines(tmp_path, lines_of(t, far, ranges)), far)


def test_corrected_laser_poses_are_a_reference(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    drift = poses * 1.5
    rows = [row.split() for row in lines_of(t, drift, ranges)]
    for row, pose in zip(rows, poses, strict=True):
        row[2 + BEAMS : 5 + BEAMS] = [f"{x:.6f}" for x in pose]
    log = read_lines(tmp_path, [" ".join(row) for row in rows])
    np.testing.assert_allclose(log.T_ref_robot, poses, atol=1e-5)
    check_path(log, drift)


def test_poses_that_never_change_give_way_to_odometry_that_does(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    odometry = [line.splitlines()[0] for line in lines_of(t, poses, ranges, rawlaser)]
    rows = [line for pair in zip(odometry, lines_of(t, 0.0 * poses, ranges), strict=True) for line in pair]
    log = read_lines(tmp_path, ["PARAM robot_frontlaser_offset 0.1", *rows])
    check_path(log)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT)


def test_options(tmp_path: Path) -> None:
    archive, carmen = write_archive(tmp_path / "a.npz"), write_carmen(tmp_path / "a.log")
    narrow = read_log(archive, ReadOptions(field_of_view_deg=90.0, max_range_m=3.0))
    assert narrow.field_of_view_deg == pytest.approx(90.0)
    assert len(narrow.bearings) == 19
    assert np.nanmax(narrow.ranges) < 3.0
    assert read_log(carmen, ReadOptions(field_of_view_deg=270.0)).field_of_view_deg == pytest.approx(270.0)
    for option in ("scan_topic", "scan_frame", "odometry_topic"):  # of bags
        for path in (archive, carmen):
            with pytest.raises(LogError, match=f"--{option.replace('_', '-')}: .*'/x'"):
                read_log(path, ReadOptions(**{option: "/x"}))
    with pytest.raises(LogError, match="--scan-topic: '/x, /y' given"):  # as typed, twice
        read_log(archive, ReadOptions(scan_topic=("/x", "/y")))


def test_beams_all_around(tmp_path: Path) -> None:
    angles = np.radians(np.arange(0.0, 361.0, 1.0))  # the last beam repeats the first
    log = read_log(write_archive(tmp_path / "a.npz", angles=angles, ranges=np.tile(1.0 + angles, (12, 1))))
    assert len(log.bearings) == 360
    assert (np.diff(log.bearings) > 0.0).all()
    assert -np.pi < log.bearings[0]
    assert log.bearings[-1] <= np.pi
    np.testing.assert_allclose(log.ranges[0], 1.0 + log.bearings % (2.0 * np.pi))
    assert log.field_of_view_deg == 360.0
    twice = np.linspace(-np.pi, 3.0 * np.pi, 720, endpoint=False)  # two turns
    log = read_log(write_archive(tmp_path / "b.npz", angles=twice, ranges=np.ones((12, 720)) + 0.01 * twice))
    assert len(log.bearings) == 360
    jumps = read_log(write_archive(tmp_path / "c.npz", angles=BEARINGS % (2.0 * np.pi)))
    np.testing.assert_allclose(jumps.bearings, BEARINGS, atol=1e-9)


def bag_in_degrees(path: Path) -> Path:
    bag = bag_of(path)
    for scan, field in itertools.product(bag.of("/scan"), ("angle_min", "angle_max", "angle_increment")):
        object.__setattr__(scan, field, np.degrees(getattr(scan, field)))
    return bag.close()


IN_DEGREES: dict[str, Callable[[Path], Log]] = {
    "archive": lambda folder: read_log(write_archive(folder / "a.npz", angles=np.degrees(BEARINGS))),
    "a turn later": lambda folder: read_log(write_archive(folder / "a.npz", angles=np.degrees(BEARINGS) % 360.0)),
    "bag": lambda folder: read_log(bag_in_degrees(folder / "a.bag")),
    "line": lambda folder: read_lines(  # only the first angle
        folder, [line.replace(f"{-np.pi / 2:.9f}", "-90.0") for line in lines_of(*drive(), rawlaser)]
    ),
}


@pytest.mark.parametrize("where", IN_DEGREES)
def test_angles_in_degrees_are_taken_as_such_and_named(tmp_path: Path, where: str) -> None:
    log = IN_DEGREES[where](tmp_path)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    assert sum("angles of the laser are taken as degrees" in note for note in log.notes) == 1


SOME = np.random.default_rng(0).uniform(0.2, 9.0, (12, BEAMS))
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "stamps in two columns": ({"t": np.zeros((12, 2))}, "t: "),
    "angles that are one": ({"angles": np.zeros(BEAMS)}, "laser"),
    "no angles": ({"angles": None}, "no angles in the archive, only"),
    "objects": ({"t": np.array([{}], object), "ranges": 0.0, "angles": 0.0}, "damaged"),
    "neither rad nor degrees": ({"angles": 100.0 * np.arange(BEAMS)}, r"are \d+\.\d turns, angles in rad expected"),
    "complex ranges": ({"ranges": SOME + 0.0j}, "ranges.npy: damaged, or of the type complex128, not numbers"),
    "um": ({"ranges": 1e6 * SOME}, r"half of the readings are beyond \d+ m, at most 100 m expected"),
    "a limit of 1 cm": ({"max_range_m": 0.012}, "no reading from 0 to"),
    "odometry in mm": (
        {"odo": drive()[1] * (1e3, 1e3, 1.0)},
        "11 of 11 motions are faster than 5 m/s.*--odometry none",
    ),
    "odometry without a number": ({"odo": np.full((12, 3), np.nan)}, "none of its 12 poses is finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_archives_of_wrong_shapes_and_units(tmp_path: Path, name: str) -> None:
    arrays, said = BAD[name]
    with pytest.raises(LogError, match=said):
        read_log(write_archive(tmp_path / "a.npz", **arrays))


@pytest.mark.parametrize(("unit", "factor", "limit"), [("mm", 1000.0, 1.0), ("cm", 100.0, 0.0)])
def test_readings_that_no_laser_has_in_metres(tmp_path: Path, unit: str, factor: float, limit: float) -> None:
    t, poses, ranges = drive()
    scaled = factor * ranges
    scaled[:, ::2] = 9999.0  # whatever comes most often, if it is one value
    most = {"max_range_m": 9.0 * (factor if limit else 1.0)}
    lines = [flaser(*row).replace("9999.000000", "9999") for row in zip(t, poses, scaled, strict=True)]
    for log in (read_log(write_archive(tmp_path / "a.npz", ranges=scaled, **most)), read_lines(tmp_path, lines)):
        np.testing.assert_allclose(log.ranges[:, 1::2], ranges[:, 1::2], atol=1e-6)
        assert np.isnan(log.ranges[:, ::2]).all()
        assert any(f"taken for {unit}" in note for note in log.notes)


def test_a_mount_in_degrees(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "b.npz", mount=np.array([0.1, 0.0, 180.0])))
    assert any("mounting pose 0.1 m, 0 m, 180 rad: at most 2 m" in note for note in log.notes)


def test_the_python_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (Path(__file__).parents[2] / "docs/logs.md").read_text()
    own, smoothed, of_a_log, stream = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    rows = [" ".join(f"{x:g}" for x in (t, *pose, *one)) for t, pose, one in zip(*drive(), strict=True)]
    (tmp_path / "robot.txt").write_text("\n".join(rows))
    exec(own, {})
    check_path(read_log("robot.npz"))
    write_archive(tmp_path / "drive.npz")
    exec(of_a_log, {})
    assert "12 {'readings without a return': 1} 0.0" in capsys.readouterr().out
    log, (_, poses, ranges) = read_log("drive.npz"), drive()
    readings = [reading(arcs(T), OdometryConfig()) for T in between(poses[:-1], poses[1:])]
    exec(smoothed, {"stream": zip([None, *readings], map(log.scan, range(len(log))), strict=True)})
    assert capsys.readouterr().out.startswith(f"{poses.shape} (")
    exec(stream, {"sensor_stream": lambda: zip(ranges, poses, strict=True), "bearings": BEARINGS})
    said = capsys.readouterr().out
    assert "at least 30 needed" in said  # for a calibration
    x, y, heading = (float(word) for word in re.findall(r"-?\d+\.\d+", said)[-3:])
    assert (x, y, heading) == pytest.approx(poses[-1], abs=0.03)
