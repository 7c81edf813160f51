"""Plain tables: `.csv` with named columns, and BreezySLAM's `.dat`."""

from __future__ import annotations

import gzip
import itertools
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import ReadOptions, read_log
from mecp_env.logs.tables import AXLE_M, TICKS, WHEEL_M
from tests.logs.files import BEAMS, BEARINGS, drive, write_archive


def csv(path: Path, names: str, separator: str = ",", skip: int = 0) -> Path:
    rows = [[t, *pose, *one][skip:] for t, pose, one in zip(*drive(), strict=True)]
    lines = [names.replace(",", separator), *(separator.join(f"{x:.6f}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


DEGREES = ",".join(f"{angle:g}" for angle in np.degrees(BEARINGS))
NAMES = ",".join(f"r{beam}" for beam in range(BEAMS))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_csv(tmp_path: Path, separator: str) -> None:
    log = read_log(csv(tmp_path / "a.csv", f"t,x,y,heading,{DEGREES}", separator))
    t, poses, ranges = drive()
    np.testing.assert_allclose(log.t, t)
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-6)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.ranges, ranges, atol=1e-6)


def test_csv_without_odometry_or_bearings(tmp_path: Path) -> None:
    log = read_log(csv(tmp_path / "a.csv", f"x,y,theta,{NAMES}", skip=1), ReadOptions(field_of_view_deg=180.0))
    assert len(log) == 12
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
    with pytest.raises(LogError, match="--field-of-view-deg"):
        read_log(tmp_path / "a.csv")
    path = tmp_path / "b.csv"
    path.write_text("\n".join(["t," + DEGREES, *(f"{n}," + ",".join(["2.5"] * BEAMS) for n in range(3))]))
    assert read_log(path).T_odom_robot is None


def test_damaged_rows_are_named(tmp_path: Path) -> None:
    path = csv(tmp_path / "a.csv", f"t,x,y,heading,{DEGREES}")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:3], "1,2,x", *lines[3:]]))
    log = read_log(path)
    assert (len(log), log.counts["damaged rows"]) == (12, 1)
    assert any(note.startswith("row 4 ") for note in log.notes)


@pytest.mark.parametrize("text", ["", "a,b,c\n1,2,3\n", "1,2,3\n4,5,6\n", "t,x,y,heading\n", "t,x,y,heading,0,1\n"])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=r"a\.csv"):
        read_log(tmp_path / "a.csv")


def test_dat(tmp_path: Path) -> None:
    rows, metre = [], TICKS / (np.pi * WHEEL_M)  # ticks of a metre
    for n in range(10):
        left, right = round(0.1 * n * metre), round(0.1 * n * metre + 0.05 * n * AXLE_M * metre)
        rows.append(" ".join(map(str, [100_000 * n, 0, left, right, *[0] * 20, *[2000] * 680, 0, 0, 7])))
    (tmp_path / "a.dat").write_text(" \n".join(rows) + " \n")
    log = read_log(tmp_path / "a.dat")
    np.testing.assert_allclose(log.t, 0.1 * np.arange(10))
    np.testing.assert_allclose(log.T_odom_robot[:, 2], 0.05 * np.arange(10), atol=2e-3)
    assert np.hypot(*np.diff(log.T_odom_robot[:, :2], axis=0).T) == pytest.approx(0.1 + 0.025 * AXLE_M, abs=2e-3)
    assert log.ranges.shape == (10, 682)
    assert np.isnan(log.ranges[:, -2:]).all()
    assert log.field_of_view_deg == pytest.approx(240.0)


def test_ticks_without_end_are_a_damaged_row(tmp_path: Path) -> None:
    row = [1, 0, 10, 10, *[0] * 20, *[1000] * 9, 0]
    rows = [row, [2, 0, "inf", 10, *row[4:]], [3, 0, "1e300", 10, *row[4:]], [4, 0, 20, 20, *row[4:]]]
    (tmp_path / "a.dat").write_text("".join(" ".join(map(str, each)) + "\n" for each in rows))
    log = read_log(tmp_path / "a.dat")
    assert (len(log), log.counts["damaged rows"]) == (2, 2)


def loop(degrees: bool, clockwise: bool) -> tuple[list[str], np.ndarray]:
    """Rows of a drive once round, with headings of some meaning, and the poses (n,3) as they are meant."""
    heading = 2.0 * np.pi * np.arange(200) / 200
    poses = np.column_stack((np.sin(heading), 1.0 - np.cos(heading), heading))
    written = poses * (1.0, 1.0, (-1.0 if clockwise else 1.0) * (180.0 / np.pi if degrees else 1.0))
    return [",".join(f"{x:.6f}" for x in [n, *pose, *[2.5] * BEAMS]) for n, pose in enumerate(written)], poses


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("degrees", [False, True])
def test_headings_are_understood_by_where_the_robot_drives(tmp_path: Path, degrees: bool, clockwise: bool) -> None:
    rows, poses = loop(degrees, clockwise)
    (tmp_path / "a.csv").write_text("\n".join([f"t,x,y,heading,{DEGREES}", *rows]))
    log = read_log(tmp_path / "a.csv")
    assert log.T_odom_robot is not None
    np.testing.assert_allclose(np.exp(1j * log.T_odom_robot[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-4)
    assert any("headings" in note for note in log.notes) == (degrees or clockwise)


def test_a_column_of_headings_in_degrees(tmp_path: Path) -> None:
    rows, poses = loop(degrees=True, clockwise=False)
    (tmp_path / "a.csv").write_text("\n".join([f"t,x,y,heading_deg,{DEGREES}", *rows[:40]]))
    log = read_log(tmp_path / "a.csv")
    np.testing.assert_allclose(log.T_odom_robot, poses[:40], atol=1e-4)


@pytest.mark.parametrize(
    ("names", "factors"),
    [
        ("Time [s],X (m),Y (m),Theta (deg)", (1.0, 1.0, 1.0, 180.0 / np.pi)),
        ("timestamp_ms,odom_x_mm,odom_y_mm,odom_yaw", (1e3, 1e3, 1e3, 1.0)),
        ("field.header.stamp,pose.x,pose.y,pose.theta", (1.0, 1.0, 1.0, 1.0)),
    ],
)
def test_names_say_the_unit(tmp_path: Path, names: str, factors: tuple[float, ...]) -> None:
    rows = [[*np.array([t, *pose]) * factors, *one] for t, pose, one in zip(*drive(), strict=True)]
    text = [f"{names},{DEGREES}", *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(text))
    log = read_log(tmp_path / "a.csv")
    np.testing.assert_allclose(log.t, drive()[0])
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=1e-5)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_comma_may_be_the_decimal_point(tmp_path: Path, separator: str) -> None:
    path = csv(tmp_path / "a.csv", f"t,x,y,heading,{DEGREES}", separator)
    path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_allclose(read_log(path).ranges, drive()[2], atol=1e-6)


def test_quotes_order_and_other_columns(tmp_path: Path) -> None:
    rows = [[*one, n, t, 7.0, *pose[::-1]] for n, (t, pose, one) in enumerate(zip(*drive(), strict=True))]
    lines = [f"{DEGREES},,t,v,heading,y,x".split(","), *([f"{x:.6f}" for x in row] for row in rows)]
    (tmp_path / "a.csv.gz").write_bytes(
        gzip.compress("\n".join(",".join(f'"{word}"' for word in line) for line in lines).encode())
    )
    log = read_log(tmp_path / "a.csv.gz")
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=1e-6)
    np.testing.assert_allclose(log.ranges, drive()[2], atol=1e-6)
    assert "columns that are not read: ', v'" in log.notes


def test_numbers_of_beams_are_no_bearings(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{n}," + ",".join(["2.5"] * 720) for n in range(3)]
    path.write_text("\n".join(["t," + ",".join(map(str, range(720))), *rows]))
    with pytest.raises(LogError, match="no bearings in degrees within a turn: --field-of-view-deg"):
        read_log(path)
    assert read_log(path, ReadOptions(field_of_view_deg=180.0)).field_of_view_deg == pytest.approx(180.0)


def test_where_all_rows_are_damaged_the_first_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"t,{DEGREES}\n2023-01-01,1,2\n")
    with pytest.raises(LogError, match=r"1 damaged rows\); row 2 .*2023-01-01"):
        read_log(tmp_path / "a.csv")


@pytest.mark.parametrize("factor", [180.0 / np.pi, -1.0])
def test_headings_along_the_walls_of_a_building(tmp_path: Path, factor: float) -> None:
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [0.0, 5.0], [0.0, 0.0]])
    poses = np.array([[0.0, 0.0, 0.0]])
    for side, (start, end) in enumerate(itertools.pairwise(corners)):
        places = start + np.linspace(0.0, 1.0, 40)[:, None] * (end - start)
        poses = np.vstack([poses, np.column_stack((places, np.full(40, side * np.pi / 2)))])
    more = {"t": np.arange(len(poses)), "odo": poses * (1.0, 1.0, factor), "ranges": np.full((len(poses), BEAMS), 2.5)}
    log = read_log(write_archive(tmp_path / "a.npz", **more, ref=None, rel=None))
    np.testing.assert_allclose(np.exp(1j * log.T_odom_robot[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-9)
    assert any("headings" in note for note in log.notes)


def test_a_list_in_a_cell_and_what_messages_say_of_the_laser(tmp_path: Path) -> None:
    """As pandas writes a table of `LaserScan` messages, and bagpy, with a column for each range."""
    t, poses, ranges = drive()
    says, step = "angle_min,angle_increment,range_max", BEARINGS[1] - BEARINGS[0]
    listed, flat = tmp_path / "a.csv", tmp_path / "b.csv"
    rows = [
        (*(f"{x:.6f}" for x in (t_, *pose, BEARINGS[0], step, 30.0)), one)
        for t_, pose, one in zip(t, poses, ranges, strict=True)
    ]
    listed.write_text(
        "\n".join(
            [
                f"Time,x,y,yaw,{says},ranges",
                *(",".join((*row, f'"[{", ".join(f"{r:.6f}" for r in one)}]"')) for *row, one in rows),
            ]
        )
    )
    names = ",".join(f"ranges_{k}" for k in range(BEAMS))
    flat.write_text(
        "\n".join(
            [f"Time,x,y,yaw,{says},{names}", *(",".join((*row, *(f"{r:.6f}" for r in one))) for *row, one in rows)]
        )
    )
    for path in (listed, flat):
        log = read_log(path)
        np.testing.assert_allclose(log.ranges, ranges, atol=1e-6)
        np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000.0), ("cm", 100.0)])
def test_readings_that_no_laser_has_in_metres_are_taken_for_what_they_are(
    tmp_path: Path, unit: str, factor: float
) -> None:
    t, poses, ranges = drive()
    lines = [
        ",".join(f"{x:.6f}" for x in (t_, *pose, *(factor * one)))
        for t_, pose, one in zip(t, poses, ranges, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join([f"t,x,y,heading,{DEGREES}", *lines]))
    log = read_log(tmp_path / "a.csv")
    np.testing.assert_allclose(log.ranges, ranges, atol=1e-6)
    assert any(f"taken for {unit}" in note for note in log.notes)
