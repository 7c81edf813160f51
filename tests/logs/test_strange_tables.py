"""Tables as other programs write them: missing values, dates, quaternions, comments, a row per beam, wrong names."""

import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import Log, ReadOptions, read_log
from tests.logs.files import BEARINGS, check_path, drive, flaser, lines_of, write_bag

T, POSES, RANGES = drive()
DEGREES = np.degrees(BEARINGS)
NAMES = ",".join(f"{angle:g}" for angle in DEGREES)


def read(folder: Path, text: str | bytes, name: str = "a.csv", **options: float) -> Log:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_log(folder / name, ReadOptions(**options))


def table(head: str, cells: list[list[str]], names: str = NAMES) -> str:
    """Rows of these cells, and the readings of the drive behind them."""
    readings = [[f"{r:.6f}" for r in one] for one in RANGES]
    return "\n".join([f"{head},{names}", *(",".join(a + b) for a, b in zip(cells, readings, strict=True))])


PLAIN = table("t,x,y,heading", [[f"{a:.6f}" for a in (t, *pose)] for t, pose in zip(T, POSES, strict=True)])


def check(log: Log, start: float = T[0]) -> None:
    np.testing.assert_allclose(log.t, T - T[0] + start, atol=1e-4)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.ranges, RANGES, atol=1e-5)
    check_path(log)
    assert "damaged rows" not in log.counts


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "recorded in the hall, 12 scans\n\n" + PLAIN),
        ("a.csv", "# " + PLAIN),
        ("a.csv", "% robot 7\n%" + PLAIN),
        ("a.csv", PLAIN.replace("\n", "\r")),
        ("a.csv", PLAIN.replace(",", "|")),
        ("a.txt", PLAIN.replace(",", " ")),
        ("a.log", PLAIN),
    ],
)
def test_what_is_before_the_names_between_cells_and_in_the_name_of_the_file(
    tmp_path: Path, name: str, text: str
) -> None:
    check(read(tmp_path, text, name))


@pytest.mark.parametrize("word", ["N/A", "null", "-", "None", "1.#INF", "-1.#IND", "NaN", ""])
def test_words_for_a_missing_reading(tmp_path: Path, word: str) -> None:
    lines = PLAIN.splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:-1], word])
    log = read(tmp_path, "\n".join(lines))
    assert (len(log), np.isnan(log.ranges).sum()) == (len(T), 1)


def test_rows_that_end_early(tmp_path: Path) -> None:
    lines = PLAIN.splitlines()
    lines[3] = lines[3].rsplit(",", 2)[0]
    lines[4] = ",".join(lines[4].split(",")[:6])
    log = read(tmp_path, "\n".join(lines))
    assert (len(log), np.isnan(log.ranges).sum()) == (len(T) - 1, 2)
    assert (log.counts["rows that end early"], log.counts["damaged rows"]) == (1, 1)


def date(t: float, form: str) -> str:
    return datetime.fromtimestamp(t, UTC).strftime(form)


@pytest.mark.parametrize(
    ("head", "stamp", "start"),
    [
        ("timestamp", lambda t: date(1.7e9 + t, "%Y-%m-%d %H:%M:%S.%f"), 1.7e9),
        (
            "timestamp",
            lambda t: date(1.7e9 + t, "%Y/%m/%dT%H:%M:%SZ" if t % 1.0 == 0 else "%Y/%m/%dT%H:%M:%S.%fZ"),
            1.7e9,
        ),
        ("time", lambda t: date(t, "%H:%M:%S.%f"), 0.0),
        ("header.stamp.secs,header.stamp.nsecs", lambda t: f"{1_700_000_000 + int(t)},{round(1e9 * (t % 1.0))}", 1.7e9),
        ("sec,nanosec", lambda t: f"{int(t)},{round(1e9 * (t % 1.0))}", 0.0),
        ("t", lambda t: f"{739000 + t / 86400:.10f}", 739000 * 86400.0),
    ],
)
def test_stamps_in_two_columns_or_as_dates(tmp_path: Path, head: str, stamp, start: float) -> None:
    cells = [[stamp(t), *(f"{a:.6f}" for a in pose)] for t, pose in zip(T, POSES, strict=True)]
    check(read(tmp_path, table(f"{head},x,y,yaw", cells)), start + T[0])


@pytest.mark.parametrize(
    ("names", "axes"),
    [
        ("qx,qy,qz,qw", "xyzw"),
        ("qw,qx,qy,qz", "wxyz"),
        ("field.pose.pose.orientation.z,field.pose.pose.orientation.w", "zw"),
    ],
)
def test_headings_as_quaternions(tmp_path: Path, names: str, axes: str) -> None:
    cells = []
    for t, (x, y, heading) in zip(T, POSES, strict=True):
        turn = {"x": 0.0, "y": 0.0, "z": 2.0 * np.sin(heading / 2), "w": 2.0 * np.cos(heading / 2)}  # of any length
        cells.append([f"{a:.6f}" for a in (t, x, y, *(turn[axis] for axis in axes))])
    check(read(tmp_path, table(f"t,x,y,{names}", cells)))


def test_texts_in_columns_that_are_not_read_as_rostopic_writes(tmp_path: Path) -> None:
    head = "%time,field.header.frame_id,field.angle_min,field.angle_increment"
    says = f"laser,{BEARINGS[0]:.6f},{BEARINGS[1] - BEARINGS[0]:.6f}"
    names = ",".join(f"field.ranges{k}" for k in range(len(BEARINGS)))
    log = read(tmp_path, table(head, [[f"{1e9 * (1.7e9 + t):.0f}", says] for t in T], names))
    np.testing.assert_allclose(log.t, 1.7e9 + T, atol=1e-5)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)


def test_names_of_readings_in_radians(tmp_path: Path) -> None:
    log = read(tmp_path, PLAIN.replace(NAMES, ",".join(f"{angle:.5f}" for angle in BEARINGS)))
    check(log)
    assert any("bearings in rad" in note for note in log.notes)


@pytest.mark.parametrize(
    "head",
    [
        "time[s],x[m],y[m],yaw[rad]",
        "Time(s),X (m),Y (m),Theta(rad)",
        "ros_time,px,py,phi",
        "datetime,pose.x,pose.y,orientation",
    ],
)
def test_names_with_units_in_brackets_and_other_names(tmp_path: Path, head: str) -> None:
    check(read(tmp_path, PLAIN.replace("t,x,y,heading", head)))


@pytest.mark.parametrize("name", ["intensity_{}", "ranges.remission[{}]", "Quality {}"])
def test_intensities_beside_readings_are_not_taken_for_them(tmp_path: Path, name: str) -> None:
    """They are as many, and may come first."""
    head, *rows = PLAIN.splitlines()
    names = ",".join(name.format(k) for k in range(len(BEARINGS)))
    intensities = ",".join(["47"] * len(BEARINGS))
    check(read(tmp_path, "\n".join([f"{names},{head}", *(f"{intensities},{row}" for row in rows)])))


@pytest.mark.parametrize("line", ["1" * 200_000 + "a", "1 " * 100_000 + "a", "a" * 200_000, "-" * 200_000 + "1_"])
def test_long_names_cost_little_time(tmp_path: Path, line: str) -> None:
    start = time.process_time()
    with pytest.raises(LogError):
        read(tmp_path, "t,x,y,heading," + ",".join(f"{line}{k}" for k in range(9)) + f"\n{line}")
    assert time.process_time() - start < 10.0


@pytest.mark.parametrize("form", ["%Y%m%d_%H%M%S.%f", "%Y%m%dT%H%M%S.%fZ", "%Y%m%d-%H%M%S.%f"])
def test_dates_without_marks_within(tmp_path: Path, form: str) -> None:
    """In Python, `20240301_120000` is a number."""
    cells = [[date(1.7e9 + t, form), *(f"{a:.6f}" for a in pose)] for t, pose in zip(T, POSES, strict=True)]
    check(read(tmp_path, table("t,x,y,yaw", cells)), 1.7e9 + T[0])


def test_times_of_the_day_over_midnight(tmp_path: Path) -> None:
    start = 86400.0 - T[5]
    cells = [[date(start + t, "%H:%M:%S.%f"), *(f"{a:.6f}" for a in p)] for t, p in zip(T, POSES, strict=True)]
    check(read(tmp_path, table("time,x,y,yaw", cells)), start + T[0])


def test_rows_of_messages_that_have_either_a_pose_or_readings(tmp_path: Path) -> None:
    """As PlotJuggler and outer joins write them; the odometry has other stamps, and more of them."""
    often = np.arange(T[0], T[-1] + 0.01, 0.05)
    path = np.column_stack([np.interp(often, T, column) for column in POSES.T])
    poses = [(t, ",".join(f"{a:.6f}" for a in pose) + "," * len(BEARINGS)) for t, pose in zip(often, path, strict=True)]
    scans = [(t + 1e-4, ",,," + ",".join(f"{r:.6f}" for r in one)) for t, one in zip(T[:-1], RANGES, strict=False)]
    rows = [f"{t:.4f},{cells}" for t, cells in sorted(poses + scans)]
    log = read(tmp_path, "\n".join([f"t,x,y,heading,{NAMES}", *rows]))
    np.testing.assert_allclose(log.T_odom_robot, POSES[:-1], atol=1e-4)
    np.testing.assert_allclose(log.ranges, RANGES[:-1], atol=1e-5)
    assert not log.counts


def of_lists(head: str, said: str, form: str, mark: str) -> str:
    """Rows of stamp and pose, what is said of the laser, and a list of readings."""
    lists = [form.format(mark.join(f"{r:.6f}" for r in one)) for one in RANGES]
    poses = [",".join(f"{a:.6f}" for a in (t, *pose)) for t, pose in zip(T, POSES, strict=True)]
    return "\n".join([f"t,x,y,yaw,{head}", *(f"{a},{said},{b}" for a, b in zip(poses, lists, strict=True))])


@pytest.mark.parametrize("form", ["[{}]", "{{{}}}", "array('f', [{}])"])
@pytest.mark.parametrize("mark", [",", ";", " "])
def test_lists_of_readings(tmp_path: Path, form: str, mark: str) -> None:
    said = f"{BEARINGS[0]:.6f},{BEARINGS[-1]:.6f}"
    check(read(tmp_path, of_lists("angle_min,angle_max,ranges", said, form, mark)))


def test_lists_of_readings_without_brackets_and_of_their_bearings(tmp_path: Path) -> None:
    bearings = " ".join(f"{a:.6f}" for a in BEARINGS)
    check(read(tmp_path, of_lists("angles,ranges", bearings, "{}", " ")))


def test_a_date_that_is_not_understood_comes_with_what_is(tmp_path: Path) -> None:
    cells = [["01.03.2024 12:00:00", *map(str, pose)] for pose in POSES]
    with pytest.raises(LogError, match=r"row 2 is the first that is damaged: 01\.03\.2024 .*dates as 2024-03-01"):
        read(tmp_path, table("t,x,y,heading", cells))


@pytest.mark.parametrize("name", ["{:g}deg", "beam_{:g}_deg", "{:g}°", "angle {:g} [deg]"])
def test_names_of_readings_with_the_unit_of_their_bearing(tmp_path: Path, name: str) -> None:
    check(read(tmp_path, PLAIN.replace(NAMES, ",".join(map(name.format, DEGREES)))))


def test_names_of_readings_with_their_own_unit(tmp_path: Path) -> None:
    head, *rows = PLAIN.splitlines()
    names = ",".join(f"r{k}_mm" for k in range(len(BEARINGS)))
    pose_first = [row.split(",", 4) for row in rows]
    in_mm = [",".join([*pose, *(f"{1e3 * float(r):.3f}" for r in ranges.split(","))]) for *pose, ranges in pose_first]
    check(read(tmp_path, "\n".join([head.replace(NAMES, names), *in_mm]), field_of_view_deg=180.0))


def by_beam(head: str, line: str, bearings: np.ndarray = DEGREES, mm: float = 1.0) -> str:
    """A row per beam, by a format of t, x, y, h (heading), a (bearing) and r (range)."""
    rows = [
        line.format(t=t, x=x, y=y, h=heading, a=a, r=mm * r, k=k)
        for k, (t, (x, y, heading), one) in enumerate(zip(T, POSES, RANGES, strict=True))
        for a, r in zip(bearings, one, strict=True)
    ]
    return "\n".join([head, *rows])


@pytest.mark.parametrize(
    ("text", "has_stamps", "has_poses"),
    [
        (by_beam("t,x,y,yaw,angle,range", "{t:f},{x:f},{y:f},{h:f},{a:f},{r:f}", BEARINGS), True, True),
        (by_beam("stamp;angle_deg;distance_mm;quality", "{t:f};{a:f};{r:f};47", mm=1e3), True, False),
        (by_beam("scan_id angle distance", "{k} {a:f} {r:f}"), False, False),
        (by_beam("#Angle Distance Quality", "{a:f} {r:f} 47", mm=1e3), False, False),
        (by_beam("opened: COM3 at: 115200\n", "Angle: {a:f}, Distance: {r:f}", mm=1e3), False, False),
        (by_beam("angle,x,y,range", "{a:f},0.1,0.2,{r:f}"), False, False),  # x and y of the points
    ],
)
def test_a_row_per_beam(tmp_path: Path, text: str, has_stamps: bool, has_poses: bool) -> None:
    log = read(tmp_path, text, "a.txt")
    np.testing.assert_allclose(log.ranges, RANGES, atol=1e-5)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.t, T if has_stamps else np.arange(len(T)))
    assert (log.T_odom_robot is not None) == has_poses
    if has_poses:
        check_path(log)


@pytest.mark.parametrize("bearings", [DEGREES, DEGREES % 360.0])
def test_rows_per_beam_of_half_a_turn_of_which_some_are_missing(tmp_path: Path, bearings: np.ndarray) -> None:
    """Bearings from 0 to 360 jump in the middle of a sweep, and beams without a return often have no row."""
    head, *rows = by_beam("angle,distance", "{a:f},{r:f}", bearings).splitlines()
    kept = np.random.default_rng(1).random(len(rows)) > 0.1
    log = read(tmp_path, "\n".join([head, *(row for row, there in zip(rows, kept, strict=True) if there)]))
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.ranges, np.where(kept.reshape(RANGES.shape), RANGES, np.nan), atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        by_beam("#Angule Distance Quality", "{a:f} {r:f} 47", mm=1e3),
        by_beam("SLAMTEC Lidar S/N: 7\nVersion: 1.12", "   theta: {a:f} Dist: {r:f} Q: 47", mm=1e3),
    ],
)
def test_an_rplidar_counts_clockwise(tmp_path: Path, text: str) -> None:
    log = read(tmp_path, text, "a.log" if "theta" in text else "a.txt")
    np.testing.assert_allclose(log.ranges, RANGES[:, ::-1], atol=1e-5)
    assert any("turned round" in note for note in log.notes)
    assert "damaged rows" not in log.counts


def test_beams_of_any_number_and_spacing_around(tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(0), ["angle,distance"]
    for _ in range(20):
        count = 400 + rng.integers(-10, 10)
        angles = 360.0 / count * (np.arange(count) + rng.uniform(0.1, 0.9, count))
        rows += [f"{a:.3f},{2.0 + np.cos(np.radians(a)):.4f}" for a in angles]
    log = read(tmp_path, "\n".join(rows), max_range_m=10.0)
    assert len(log) == 20
    np.testing.assert_allclose(log.ranges, np.tile(2.0 + np.cos(log.bearings), (20, 1)), atol=0.03)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.npz", b"", "an empty file"),
        ("a.bag", b"", "an empty file"),
        ("a.csv", "t,x\n".encode("utf-16-le"), "UTF-16"),
        ("a.log", b"#ROSBAG V2.0\n", r"\.bag"),
        ("a.bag", b"\x89MCAP0\r\n", r"\.mcap"),
        ("a.csv", b"SQLite format 3\0", r"\.db3"),
        ("a.csv", b"angle,range\n" + b"1,2\n" * 5, "5 rows per scan, 8 to"),
        ("a.csv", b't,x,y,yaw,ranges\n0,0,0,0,"[1. 2. ... 3. 4.]"\n', "as NumPy prints it"),
        ("a.csv", b't,x,y,yaw,ranges\n0,0,0,0,"[1. 2.\n 3. 4.]"\n', "as NumPy prints it"),
        ("a.txt", b'{"t": 0.0, "ranges": [1.0, 2.0]}\n', "JSON: write"),
        ("a.txt", b'[{"t": 0.0, "ranges": [1.0, 2.0]}]\n', "JSON: write"),
        ("a.yaml", b"header:\n  seq: 1\n---\n", "record a bag"),
        ("a.bag", bytes(100), "begins as none does"),
        ("a.xlsx", b"PK\x03\x04", "spreadsheet as .csv"),
    ],
)
def test_files_that_are_not_what_their_name_says(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    with pytest.raises(LogError, match=said):
        read(tmp_path, content, name)


@pytest.mark.parametrize("name", ["a.csv", "a.txt", "a.tsv", "a.log"])
def test_a_carmen_log_by_its_lines_whatever_its_name(tmp_path: Path, name: str) -> None:
    lines = lines_of(T, POSES, RANGES, flaser)
    check_path(read(tmp_path, "\r".join(lines), name))


def test_a_bag_has_its_name(tmp_path: Path) -> None:
    check_path(read_log(write_bag(tmp_path / "a.bag")))
