"""Plain tables: `.csv` with named columns, and BreezySLAM's `.dat`; headings of any meaning."""

import gzip
import itertools
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.tables import AXLE_M, TICKS, WHEEL_M
from tests.logs.files import BEAMS, BEARINGS, check_path, drive, write_archive

BEARINGS_DEG = ",".join(f"{angle:g}" for angle in np.degrees(BEARINGS))
NAMES = ",".join(f"r{beam}" for beam in range(BEAMS))
IN_DEG, IN_MM = (1.0, 1.0, 1.0, 180.0 / np.pi), (1e3, 1e3, 1e3, 1.0)


def table(names: str, factors: tuple[float, ...] = (1.0,) * 4) -> str:
    """The drive with stamps and poses times some factors; a beam in each other column."""
    rows = [[*np.array([t, *pose]) * factors, *one] for t, pose, one in zip(*drive(), strict=True)]
    return "\n".join([f"{names},{BEARINGS_DEG}", *(",".join(f"{x:.6f}" for x in row) for row in rows)])


def read_text(folder: Path, text: str, name: str = "a.csv", **options: float) -> Log:
    (folder / name).write_text(text)
    return read_log(folder / name, ReadOptions(**options))


PLAIN = table("t,x,y,heading")


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", ";").replace(".", ","),
        PLAIN.replace(",", "\t").replace(".", ","),
        table("Time [s],X (m),Y (m),Theta (deg)", IN_DEG),
        table("t,x,y,heading_deg", IN_DEG),
        table("timestamp_ms,odom_x_mm,odom_y_mm,odom_yaw", IN_MM),
        table("field.header.stamp,pose.x,pose.y,pose.theta"),
    ],
    ids=lambda text: text[:40],
)
def test_csv(tmp_path: Path, text: str) -> None:
    log = read_text(tmp_path, text)
    t, _, ranges = drive()
    np.testing.assert_allclose(log.t, t)
    check_path(log)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.ranges, ranges, atol=1e-6)


def test_quotes_order_and_other_columns(tmp_path: Path) -> None:
    rows = [[*one, n, t, 7.0, *pose[::-1]] for n, (t, pose, one) in enumerate(zip(*drive(), strict=True))]
    lines = [f"{BEARINGS_DEG},,t,v,heading,y,x".split(","), *([f"{x:.6f}" for x in row] for row in rows)]
    text = "\n".join(",".join(f'"{word}"' for word in line) for line in lines)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(text.encode()))
    log = read_log(tmp_path / "a.csv.gz")
    check_path(log)
    np.testing.assert_allclose(log.ranges, drive()[2], atol=1e-6)
    assert "columns that are not read: 'v'" in log.notes


def test_csv_without_stamps_odometry_or_bearings(tmp_path: Path) -> None:
    rows = [",".join(f"{x:.6f}" for x in (*pose, *one)) for pose, one in zip(*drive()[1:], strict=True)]
    text = "\n".join([f"x,y,theta,{NAMES}", *rows])
    log = read_text(tmp_path, text, field_of_view_deg=180.0)
    assert len(log) == 12
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
    with pytest.raises(LogError, match="--field-of-view-deg"):
        read_text(tmp_path, text)
    row = ",".join(["2.5"] * 720)
    log = read_text(tmp_path, "\n".join(["t," + BEARINGS_DEG, *(f"{n},{row[: 4 * BEAMS - 1]}" for n in range(3))]))
    assert log.T_odom_robot is None
    numbered = "\n".join(["t," + ",".join(map(str, range(720))), *(f"{n},{row}" for n in range(3))])
    with pytest.raises(LogError, match="no bearings in degrees within a turn: --field-of-view-deg"):
        read_text(tmp_path, numbered)
    assert read_text(tmp_path, numbered, field_of_view_deg=180.0).field_of_view_deg == pytest.approx(180.0)


def test_damaged_rows_are_named(tmp_path: Path) -> None:
    lines = PLAIN.splitlines()
    log = read_text(tmp_path, "\n".join([*lines[:3], "1,2,x", *lines[3:]]))
    assert (len(log), log.counts["damaged rows"]) == (12, 1)
    assert any(note.startswith("row 4 ") for note in log.notes)
    with pytest.raises(LogError, match=r"1 damaged rows\); row 2 .*2023-01-01"):
        read_text(tmp_path, f"t,{BEARINGS_DEG}\n2023-01-01,1,2\n")


@pytest.mark.parametrize("text", ["", "a,b,c\n1,2,3\n", "1,2,3\n4,5,6\n", "t,x,y,heading\n", "t,x,y,heading,0,1\n"])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(LogError, match=r"a\.csv"):
        read_text(tmp_path, text)


def test_dat(tmp_path: Path) -> None:
    rows, metre = [], TICKS / (np.pi * WHEEL_M)  # ticks of a metre
    for n in range(10):
        left, right = round(0.1 * n * metre), round(0.1 * n * metre + 0.05 * n * AXLE_M * metre)
        rows.append(" ".join(map(str, [100_000 * n, 0, left, right, *[0] * 20, *[2000] * 680, 0, 0, 7])))
    log = read_text(tmp_path, " \n".join(rows) + " \n", "a.dat")
    np.testing.assert_allclose(log.t, 0.1 * np.arange(10))
    np.testing.assert_allclose(log.T_odom_robot[:, 2], 0.05 * np.arange(10), atol=2e-3)
    assert np.hypot(*np.diff(log.T_odom_robot[:, :2], axis=0).T) == pytest.approx(0.1 + 0.025 * AXLE_M, abs=2e-3)
    assert log.ranges.shape == (10, 682)
    assert np.isnan(log.ranges[:, -2:]).all()
    assert log.field_of_view_deg == pytest.approx(240.0)


def test_ticks_without_end_are_a_damaged_row(tmp_path: Path) -> None:
    ends = ([1, 0, 10, 10], [2, 0, "inf", 10], [3, 0, "1e300", 10], [4, 0, 20, 20])
    rows = [" ".join(map(str, [*each, *[0] * 20, *[1000] * 9, 0])) for each in ends]
    log = read_text(tmp_path, "\n".join(rows), "a.dat")
    assert (len(log), log.counts["damaged rows"]) == (2, 2)


def circle() -> np.ndarray:
    """(200,3) poses of a drive once round."""
    heading = 2.0 * np.pi * np.arange(200) / 200
    return np.column_stack((np.sin(heading), 1.0 - np.cos(heading), heading))


def along_the_walls() -> np.ndarray:
    """(161,3) poses of a drive round a building."""
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [0.0, 5.0], [0.0, 0.0]])
    poses = np.zeros((1, 3))
    for side, (start, end) in enumerate(itertools.pairwise(corners)):
        places = start + np.linspace(0.0, 1.0, 40)[:, None] * (end - start)
        poses = np.vstack([poses, np.column_stack((places, np.full(40, side * np.pi / 2)))])
    return poses


@pytest.mark.parametrize("poses", [circle(), along_the_walls()], ids=["circle", "walls"])
@pytest.mark.parametrize("factor", [1.0, -1.0, 180.0 / np.pi, -180.0 / np.pi])
def test_headings_are_understood_by_where_the_robot_drives(tmp_path: Path, factor: float, poses: np.ndarray) -> None:
    more = {"t": np.arange(len(poses)), "odo": poses * (1.0, 1.0, factor), "ranges": np.full((len(poses), BEAMS), 2.5)}
    log = read_log(write_archive(tmp_path / "a.npz", **more, ref=None, rel=None))
    np.testing.assert_allclose(np.exp(1j * log.T_odom_robot[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-9)
    assert any("headings" in note for note in log.notes) == (factor != 1.0)


def written(path: Path, names: str, readings: list[str]) -> Path:
    """A table of the drive, with these texts for its readings."""
    t, poses, _ = drive()
    rows = [(*(f"{x:.6f}" for x in (t_, *pose)), said) for t_, pose, said in zip(t, poses, readings, strict=True)]
    path.write_text("\n".join([f"Time,x,y,yaw,{names}", *map(",".join, rows)]))
    return path


def test_a_list_in_a_cell_and_what_messages_say_of_the_laser(tmp_path: Path) -> None:
    """As pandas writes a table of `LaserScan` messages, and bagpy, with a column for each range."""
    _, _, ranges = drive()
    says, laser = "angle_min,angle_increment,range_max", f"{BEARINGS[0]:.6f},{BEARINGS[1] - BEARINGS[0]:.6f},30"
    texts = [", ".join(f"{r:.6f}" for r in one) for one in ranges]
    names = ",".join(f"ranges_{k}" for k in range(BEAMS))
    for path in (
        written(tmp_path / "a.csv", f"{says},ranges", [f'{laser},"[{text}]"' for text in texts]),
        written(tmp_path / "b.csv", f"{says},{names}", [f"{laser},{text}" for text in texts]),
    ):
        log = read_log(path)
        np.testing.assert_allclose(log.ranges, ranges, atol=1e-6)
        np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
        lines = path.read_text().splitlines()
        path.write_text("\n".join([lines[0], "1,2", *lines[1:]]))  # a first row that is damaged
        assert (len(read_log(path)), read_log(path).counts["damaged rows"]) == (len(log), 1)
