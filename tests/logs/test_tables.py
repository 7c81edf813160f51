"""Tables as other programs write them: any names, units, dates, lists and marks between cells; a row per beam."""

import gzip
import itertools
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.tables import AXLE_M, TICKS, WHEEL_M
from tests.logs.files import BEAMS, BEARINGS, check_path, drive, write_archive

T, POSES, RANGES = drive()
DEGREES = np.degrees(BEARINGS)
STEP = BEARINGS[1] - BEARINGS[0]


def read(folder: Path, text: str | bytes, name: str = "a.csv", **options: float) -> Log:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_log(folder / name, ReadOptions(**options))


def joined(*values: float | str) -> str:
    return ",".join(value if isinstance(value, str) else f"{value:.6f}" for value in values)


def names(form: str, values: Sequence[float] = DEGREES) -> str:
    return ",".join(form.format(value) for value in values)


PLACES, NUMBERED = names("{:g}"), ",".join(f"r{beam}" for beam in range(BEAMS))


def table(
    head: str,
    cells: Callable[[float, np.ndarray], Sequence[float | str]] = lambda t, pose: (t, *pose),
    beams: str = PLACES,
    readings: Callable[[np.ndarray], str] = lambda one: joined(*one),
) -> str:
    """Rows of cells of stamp and pose, and the readings of the drive behind them."""
    rows = [f"{joined(*cells(t, pose))},{readings(one)}" for t, pose, one in zip(T, POSES, RANGES, strict=True)]
    return "\n".join([f"{head},{beams}", *rows])


def check(log: Log, start: float = T[0]) -> None:
    np.testing.assert_allclose(log.t, T - T[0] + start, atol=1e-4)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    np.testing.assert_allclose(log.ranges, RANGES, atol=1e-5)
    check_path(log)
    assert "damaged rows" not in log.counts


PLAIN = table("t,x,y,heading")
SAME = {
    "plain": PLAIN,
    "semicolons": PLAIN.replace(",", ";"),
    "bars": PLAIN.replace(",", "|"),
    "decimal commas": PLAIN.replace(",", ";").replace(".", ","),
    "decimal commas and tabs": PLAIN.replace(",", "\t").replace(".", ","),
    "line ends of old Macs": PLAIN.replace("\n", "\r"),
    "a title": "recorded in the hall, 12 scans\n\n" + PLAIN,
    "names in a comment": "# " + PLAIN,
    "percent signs": "% robot 7\n%" + PLAIN,
    "degrees": table("t,x,y,heading_deg", lambda t, pose: (t, *pose[:2], np.degrees(pose[2]))),
    "units in brackets": table("Time [s],X (m),Y (m),Theta (deg)", lambda t, p: (t, *p[:2], np.degrees(p[2]))),
    "units in square brackets": PLAIN.replace("t,x,y,heading", "ros_time[s],px[m],py[m],phi[rad]"),
    "names with a prefix": PLAIN.replace("t,x,y,heading", "field.header.stamp,pose.x,pose.y,pose.orientation"),
    "ms and mm": table("timestamp_ms,odom_x_mm,odom_y_mm,odom_yaw", lambda t, p: (1e3 * t, *(1e3 * p[:2]), p[2])),
    "bearings with their unit": table("t,x,y,heading", beams=names("{:g}deg")),
    "bearings with a name": table("t,x,y,heading", beams=names("beam_{:g}_deg")),
    "bearings with brackets": table("t,x,y,heading", beams=names("angle {:g} [deg]")),
    "bearings in radians": table("t,x,y,heading", beams=names("{:.5f}", BEARINGS)),
    "x, y, z, w": table(
        "t,x,y,qx,qy,qz,qw", lambda t, p: (t, *p[:2], 0, 0, 2 * np.sin(p[2] / 2), 2 * np.cos(p[2] / 2))
    ),
    "w, x, y, z": table("t,x,y,qw,qx,qy,qz", lambda t, p: (t, *p[:2], np.cos(p[2] / 2), 0, 0, np.sin(p[2] / 2))),
    "z, w": table(
        "t,x,y,field.pose.pose.orientation.z,field.pose.pose.orientation.w",
        lambda t, p: (t, *p[:2], np.sin(p[2] / 2), np.cos(p[2] / 2)),
    ),
    **{
        f"a list as {form} of {mark!r}": table(
            "t,x,y,yaw,angle_min,angle_max",
            lambda t, pose: (t, *pose, BEARINGS[0], BEARINGS[-1]),
            "ranges",
            lambda one, form=form, mark=mark: form.format(mark.join(f"{r:.6f}" for r in one)),
        )
        for form in ("[{}]", "{{{}}}", "array('f', [{}])", '"[{}]"')
        for mark in (",", ";", " ")
    },
    "a list and that of its bearings": table(
        "t,x,y,yaw,angles",
        lambda t, pose: (t, *pose, " ".join(f"{a:.6f}" for a in BEARINGS)),
        "ranges",
        lambda one: " ".join(f"{r:.6f}" for r in one),
    ),
    "what messages say of the laser": table(
        "Time,x,y,yaw,angle_min,angle_increment,range_max",
        lambda t, pose: (t, *pose, BEARINGS[0], STEP, 30.0),
        ",".join(f"ranges_{k}" for k in range(BEAMS)),
    ),
    **{
        f"{form} before the readings": table(
            f"{','.join(form.format(k) for k in range(BEAMS))},t,x,y,heading",
            lambda t, pose: (*["47"] * BEAMS, t, *pose),
        )
        for form in ("intensity_{}", "ranges.remission[{}]", "Quality {}")
    },
}


@pytest.mark.parametrize("name", SAME)
def test_tables_that_say_the_same(tmp_path: Path, name: str) -> None:
    check(read(tmp_path, SAME[name]))
    if name == "plain":
        check(read(tmp_path, PLAIN, "a.log"))
        check(read(tmp_path, PLAIN.replace(",", " "), "a.txt"))
        check(read(tmp_path, gzip.compress(PLAIN.encode()), "a.csv.gz"))


def test_quotes_order_other_columns_and_readings_with_their_own_unit(tmp_path: Path) -> None:
    rows = [
        [*(1e3 * one), n, t, 7.0, *pose[::-1]] for n, (t, pose, one) in enumerate(zip(T, POSES, RANGES, strict=True))
    ]
    head = f"{','.join(f'r{beam}_mm' for beam in range(BEAMS))},,t,v,heading,y,x"
    lines = [",".join(f'"{word}"' for word in line.split(",")) for line in (head, *(joined(*row) for row in rows))]
    log = read(tmp_path, "\n".join(lines), field_of_view_deg=180.0)
    check(log)
    assert "columns that are not read: 'v'" in log.notes


@pytest.mark.parametrize("word", ["N/A", "null", "-", "None", "1.#INF", "-1.#IND", "NaN", ""])
def test_words_for_a_missing_reading(tmp_path: Path, word: str) -> None:
    lines = PLAIN.splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:-1], word])
    log = read(tmp_path, "\n".join(lines))
    assert (len(log), np.isnan(log.ranges).sum()) == (len(T), 1)


def test_damaged_rows_and_rows_that_end_early(tmp_path: Path) -> None:
    lines = PLAIN.splitlines()
    lines[3] = lines[3].rsplit(",", 2)[0]
    lines[4] = ",".join(lines[4].split(",")[:6])
    log = read(tmp_path, "\n".join([*lines[:3], "1,2,x", *lines[3:]]))
    assert (len(log), np.isnan(log.ranges).sum()) == (len(T) - 1, 2)
    assert (log.counts["rows that end early"], log.counts["damaged rows"]) == (1, 2)
    assert any(note.startswith("row 4 ") for note in log.notes)
    lists = SAME["a list as [{}] of ','"].splitlines()
    assert len(read(tmp_path, "\n".join([lists[0], "1,2", *lists[1:]]))) == len(T)


def date(form: str, start: float = 1.7e9) -> Callable[[float], str]:
    return lambda t: datetime.fromtimestamp(start + t, UTC).strftime(form)


def in_two(t: float, start: int = 0) -> str:
    return f"{start + int(t)},{round(1e9 * (t % 1.0))}"


STAMPS: list[tuple[str, Callable[[float], str], float]] = [
    ("timestamp", date("%Y-%m-%d %H:%M:%S.%f"), 1.7e9 + T[0]),
    ("timestamp", lambda t: date("%Y/%m/%dT%H:%M:%SZ" if t % 1.0 == 0 else "%Y/%m/%dT%H:%M:%S.%fZ")(t), 1.7e9 + T[0]),
    ("t", date("%Y%m%d_%H%M%S.%f"), 1.7e9 + T[0]),  # in Python, `20240301_120000` is a number
    ("t", date("%Y%m%dT%H%M%S.%fZ"), 1.7e9 + T[0]),
    ("time", date("%H:%M:%S.%f", 0.0), T[0]),
    ("time", date("%H:%M:%S.%f", 86400.0 - T[5]), 86400.0 - T[5] + T[0]),  # over midnight
    ("header.stamp.secs,header.stamp.nsecs", lambda t: in_two(t, 1_700_000_000), 1.7e9 + T[0]),
    ("sec,nanosec", in_two, T[0]),
    ("t", lambda t: f"{739000 + t / 86400:.10f}", 739000 * 86400.0 + T[0]),
]


@pytest.mark.parametrize(("head", "stamp", "start"), STAMPS)
def test_stamps_in_two_columns_or_as_dates(
    tmp_path: Path, head: str, stamp: Callable[[float], str], start: float
) -> None:
    check(read(tmp_path, table(f"{head},x,y,yaw", lambda t, pose: (stamp(t), *pose))), start)


def test_texts_in_columns_that_are_not_read_as_rostopic_writes(tmp_path: Path) -> None:
    head = "%time,field.header.frame_id,field.angle_min,field.angle_increment"
    beams = ",".join(f"field.ranges{k}" for k in range(BEAMS))
    log = read(tmp_path, table(head, lambda t, _: (f"{1e9 * (1.7e9 + t):.0f}", "laser", BEARINGS[0], STEP), beams))
    np.testing.assert_allclose(log.t, 1.7e9 + T, atol=1e-5)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)


def test_tables_without_stamps_odometry_or_bearings(tmp_path: Path) -> None:
    text = table("x,y,theta", lambda _, pose: tuple(pose), NUMBERED)
    log = read(tmp_path, text, field_of_view_deg=180.0)
    check_path(log)
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
    assert read(tmp_path, table("t", lambda t, _: (t,))).T_odom_robot is None
    row = ",".join(["2.5"] * 720)
    numbered = "\n".join(["t," + ",".join(map(str, range(720))), *(f"{n},{row}" for n in range(3))])
    assert read(tmp_path, numbered, field_of_view_deg=180.0).field_of_view_deg == pytest.approx(180.0)
    for without, said in (
        (text, "--field-of-view-deg"),
        (numbered, "no bearings in degrees within a turn: --field-of"),
    ):
        with pytest.raises(LogError, match=said):
            read(tmp_path, without)


def test_rows_of_messages_that_have_either_a_pose_or_readings(tmp_path: Path) -> None:
    """As PlotJuggler and outer joins write them; the odometry has other stamps, and more of them."""
    often = np.arange(T[0], T[-1] + 0.01, 0.05)
    path = np.column_stack([np.interp(often, T, column) for column in POSES.T])
    poses = [(t, joined(*pose) + "," * BEAMS) for t, pose in zip(often, path, strict=True)]
    scans = [(t + 1e-4, f",,,{joined(*one)}") for t, one in zip(T[:-1], RANGES, strict=False)]
    rows = [f"{t:.4f},{cells}" for t, cells in sorted(poses + scans)]
    log = read(tmp_path, "\n".join([f"t,x,y,heading,{PLACES}", *rows]))
    np.testing.assert_allclose(log.T_odom_robot, POSES[:-1], atol=1e-4)
    np.testing.assert_allclose(log.ranges, RANGES[:-1], atol=1e-5)
    assert not log.counts


@pytest.mark.parametrize("line", ["1" * 200_000 + "a", "1 " * 100_000 + "a", "-" * 200_000 + "1_"])
def test_long_names_cost_little_time(tmp_path: Path, line: str) -> None:
    start = time.process_time()
    with pytest.raises(LogError):
        read(tmp_path, "t,x,y,heading," + ",".join(f"{line}{k}" for k in range(9)) + f"\n{line}")
    assert time.process_time() - start < 10.0


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
    ("name", "text"),
    [
        ("a.txt", by_beam("#Angule Distance Quality", "{a:f} {r:f} 47", mm=1e3)),
        ("a.log", by_beam("SLAMTEC Lidar S/N: 7\nVersion: 1.12", "   theta: {a:f} Dist: {r:f} Q: 47", mm=1e3)),
    ],
)
def test_an_rplidar_counts_clockwise(tmp_path: Path, name: str, text: str) -> None:
    log = read(tmp_path, text, name)
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
    ("text", "said"),
    [
        ("1,2,3\n4,5,6\n", r"a\.csv"),
        ("angle,range\n" + "1,2\n" * 5, "5 rows per scan, 8 to"),
        (f"t,{PLACES}\n2023-01-01,1,2\n", r"1 damaged rows\); row 2 .*2023-01-01"),
        (table("t,x,y,heading", lambda t, p: ("01.03.2024 12:00:00", *p)), r"row 2 .* 01\.03\.2024 .*as 2024-03-01"),
        ('t,x,y,yaw,ranges\n0,0,0,0,"[1. 2. ... 3. 4.]"\n', "as NumPy prints it"),
        ('t,x,y,yaw,ranges\n0,0,0,0,"[1. 2.\n 3. 4.]"\n', "as NumPy prints it"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(LogError, match=said):
        read(tmp_path, text)


def test_dat(tmp_path: Path) -> None:
    """Ticks without end are a damaged row."""
    rows, metre = [], TICKS / (np.pi * WHEEL_M)  # ticks of a metre
    for n in range(10):
        left, right = round(0.1 * n * metre), round(0.1 * n * metre + 0.05 * n * AXLE_M * metre)
        rows.append(" ".join(map(str, [100_000 * n, 0, left, right, *[0] * 20, *[2000] * 680, 0, 0, 7])))
    rows[5:5] = [" ".join(map(str, [2, 0, ticks, 10, *[0] * 20, *[1000] * 9, 0])) for ticks in ("inf", "1e300")]
    log = read(tmp_path, " \n".join(rows) + " \n", "a.dat")
    np.testing.assert_allclose(log.t, 0.1 * np.arange(10))
    np.testing.assert_allclose(log.T_odom_robot[:, 2], 0.05 * np.arange(10), atol=2e-3)
    assert np.hypot(*np.diff(log.T_odom_robot[:, :2], axis=0).T) == pytest.approx(0.1 + 0.025 * AXLE_M, abs=2e-3)
    assert log.ranges.shape == (10, 682)
    assert np.isnan(log.ranges[:, -2:]).all()
    assert log.field_of_view_deg == pytest.approx(240.0)
    assert log.counts["damaged rows"] == 2


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
