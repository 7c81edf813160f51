"""What bags of other robots have: odometry among the frames, several lasers, other clocks, rotations of zeros."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between
from mecp_env.logs import Log, ReadOptions, read_log
from tests.logs import files
from tests.logs.bags import ODOMETRY, SCAN, BagWriter, sweep
from tests.logs.files import BEARINGS, MOUNT, SIDE, drive

pytest.importorskip("rosbags")
FRONT, REAR = np.array([0.25, 0.0, 0.0]), np.array([-0.25, 0.0, np.pi])


@pytest.mark.parametrize("name", ["a.bag", "a"])
@pytest.mark.parametrize(
    ("parent", "child"), [("odom", "base_link"), ("/odom", "base_footprint"), ("r/odom", "r/base_link")]
)
def test_odometry_of_the_frames(tmp_path: Path, name: str, parent: str, child: str) -> None:
    bag = BagWriter(tmp_path / name)
    t, poses, ranges = drive()
    for stamp, pose, one in zip(t, poses, ranges, strict=True):
        bag.frame(stamp, "map", parent, np.zeros(3))
        bag.frame(stamp, parent, child, pose)
        bag.frame(stamp, child, "laser", MOUNT)
        bag.scan(stamp, one)
    log = read_log(bag.close())
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-5)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT, atol=1e-5)
    assert any(f"{parent.strip('/')} -> {child}" in note for note in log.notes)


def test_odometry_of_a_message_counts_before_that_of_the_frames(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.frame(stamp, "odom", "base_link", 2.0 * pose)
        bag.odometry(stamp, pose)
        bag.scan(stamp, one)
    np.testing.assert_allclose(read_log(bag.close()).T_odom_robot, drive()[1], atol=1e-5)


def test_without_odometry_topics_types_and_frames_are_listed(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, _, one in zip(*drive(), strict=True):
        bag.frame(stamp, "map", "laser", MOUNT)
        bag.scan(stamp, one)
    log = read_log(bag.close())
    assert log.T_odom_robot is None
    assert all(word in log.notes[0] for word in ("/scan", "sensor_msgs/msg/LaserScan", "map -> laser"))


def two_lasers(path: Path, topics: tuple[str, str], frames: bool = True, late: float = 0.0) -> Path:
    bag = BagWriter(path)
    for stamp, pose, _ in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        for name, mount, topic, after in (("front", FRONT, topics[0], 0.0), ("rear", REAR, topics[1], late)):
            if frames:
                bag.frame(stamp, "base_link", name, mount, "/tf_static")
            at = pose + after / 0.25 * np.array([0.05, 0.0, 0.02])
            bag.scan(stamp + after, sweep(at, mount), name, topic)
    return bag.close()


def check_room(log: Log) -> None:
    """Every hit of the merged scanner lies on a wall of the room."""
    assert log.field_of_view_deg == 360.0
    for record in log:
        x, y, heading = record.T_odom_robot
        angles = heading + log.bearings
        ranges = np.where(record.scan.hit[0], record.scan.ranges[0], np.nan)
        px, py = x + ranges * np.cos(angles), y + ranges * np.sin(angles)
        off = np.minimum(abs(abs(px) - SIDE / 2), abs(abs(py) - SIDE / 2))
        assert np.isfinite(off).mean() > 0.9
        assert np.nanmedian(off) < 0.005
        assert np.nanquantile(off, 0.95) < 0.08  # a surface between two hits cuts the corner of the room


@pytest.mark.parametrize(
    ("topics", "late"), [(("/scan", "/scan"), 0.0), (("/scan", "/scan"), 0.02), (("/a", "/b"), 0.0)]
)
def test_several_lasers_are_one_scanner(tmp_path: Path, topics: tuple[str, str], late: float) -> None:
    path = two_lasers(tmp_path / "a.bag", topics, late=late)
    log = read_log(path, ReadOptions(scan_topic=topics if topics[0] != topics[1] else None))
    assert len(log) == len(drive()[0])
    check_room(log)


def test_lasers_whose_frames_are_unknown_are_named(tmp_path: Path) -> None:
    path = two_lasers(tmp_path / "a.bag", ("/scan", "/scan"), frames=False)
    with pytest.raises(LogError, match=r"front, rear.*--scan-frame"):
        read_log(path)
    with pytest.raises(LogError, match=r"'fron'; did you mean 'front'"):
        read_log(path, ReadOptions(scan_frame="fron"))
    assert read_log(path, ReadOptions(scan_frame="rear")).counts["scans of another frame"] == len(drive()[0])


def test_clocks_that_differ(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        bag.scan(stamp, one, t=stamp + 97554.0)
    path = bag.close()
    with pytest.raises(LogError, match=r"scans from 97654.*odometry from 100.*--clock received"):
        read_log(path)
    log = read_log(path, ReadOptions(clock="received"))
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=1e-5)


def test_quaternions_of_zeros_are_named(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for n, (stamp, pose, one) in enumerate(zip(*drive(), strict=True)):
        bag.odometry(stamp, pose)
        bag.scan(stamp, one)
        rotation = bag.messages[-2][3].pose.pose.orientation
        if n == 3:
            rotation.x = rotation.y = rotation.z = rotation.w = 0.0
    log = read_log(bag.close())
    assert log.counts["messages with a quaternion of zeros"] == 1
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=5e-3)


def test_quaternions_count_whatever_their_length(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        rotation = bag.messages[-1][3].pose.pose.orientation
        rotation.z, rotation.w = 1.4 * rotation.z, 1.4 * rotation.w
        bag.scan(stamp, one)
    np.testing.assert_allclose(read_log(bag.close()).T_odom_robot, drive()[1], atol=1e-5)


def test_odometry_of_the_frames_is_that_of_the_robot_with_the_laser(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        for robot, path in (("other", -pose), ("own", pose)):
            bag.frame(stamp, "map", f"{robot}/odom", np.zeros(3))
            bag.frame(stamp, f"{robot}/odom", f"{robot}/base_link", path)
            bag.frame(stamp, f"{robot}/base_link", f"{robot}/laser", MOUNT, "/tf_static")
            bag.scan(stamp, one, f"{robot}/laser", f"/{robot}/scan")
        bag.frame(stamp + 0.1, "other/odom", "other/base_link", -pose)  # the other robot has more poses
    log = read_log(bag.close(), ReadOptions(scan_topic="/own/scan"))
    np.testing.assert_allclose(log.T_odom_robot, drive()[1], atol=1e-5)


def test_several_topics_of_odometry_are_no_fault_where_none_is_used(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        bag.put(stamp, "/filtered", ODOMETRY, bag.messages[-1][3])
        bag.scan(stamp, one)
    path = bag.close()
    with pytest.raises(LogError, match=r"--odometry-topic: 2 topics"):
        read_log(path)
    assert read_log(path, ReadOptions(use_odometry=False)).T_odom_robot is None


@pytest.mark.parametrize(("tilt", "said"), [(0.02, False), (0.5 * np.pi, True), (np.pi - 0.02, False)])
def test_a_laser_that_is_not_level_is_named(tmp_path: Path, tilt: float, said: bool) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        bag.scan(stamp, one)
        bag.frame(stamp, "base_link", "laser", MOUNT, "/tf_static")
        rotation = bag.messages[-1][3].transforms[0].transform.rotation
        rotation.x, rotation.w = np.sin(0.5 * tilt), np.cos(0.5 * tilt)
    assert any("tilted by 90 deg" in note for note in read_log(bag.close()).notes) == said


def test_a_laser_without_a_mounting_pose_is_named(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.frame(stamp, "odom", "base_footprint", pose)
        bag.scan(stamp, one)
    notes = read_log(bag.close()).notes
    assert any("'laser' in 'base_footprint'; frames: odom -> base_footprint" in note for note in notes)


def test_fields_that_a_driver_leaves_out(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.odometry(stamp, pose)
        bag.scan(stamp, one)
        message = bag.messages[-1][3]
        message.angle_increment, message.range_min, message.range_max = 0.0, np.nan, np.nan
    log = read_log(bag.close())
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
    np.testing.assert_allclose(log.ranges, drive()[2], atol=1e-5)


@pytest.mark.parametrize("constant", [False, True])
def test_odometry_that_has_speeds_alone(constant: bool, tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    t, poses, ranges = drive()
    poses = np.outer(t - t[0], [0.2, 0.0, 0.0]) if constant else poses
    vector = bag.store.types["geometry_msgs/msg/Vector3"]
    for n in range(len(t)):
        last = min(n, len(t) - 2)
        x, y, turn = (between(poses[last], poses[last + 1]) / 0.25).round(9).tolist()
        bag.odometry(t[n], np.zeros(3))
        bag.messages[-1][3].twist.twist = bag.store.types["geometry_msgs/msg/Twist"](
            vector(x, y, 0.0), vector(0.0, 0.0, turn)
        )
        bag.scan(t[n], ranges[n])
    log = read_log(bag.close())
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-5)
    assert any("speeds" in note for note in log.notes)


def test_odometry_that_never_moves_gives_way_to_that_of_the_frames(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, pose, one in zip(*drive(), strict=True):
        bag.frame(stamp, "odom", "base_link", pose)
        bag.odometry(stamp, np.zeros(3))
        bag.scan(stamp, one)
    np.testing.assert_allclose(read_log(bag.close()).T_odom_robot, drive()[1], atol=1e-5)


def plain(path: Path, rows: slice = slice(None), late: float = 0.0) -> BagWriter:
    bag = BagWriter(path)
    for stamp, pose, one in list(zip(*drive(), strict=True))[rows]:
        bag.odometry(stamp, pose)
        bag.scan(stamp, one, t=stamp + late)
        bag.frame(stamp, "base_link", "laser", MOUNT, "/tf_static")
    return bag


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_a_folder_of_parts_without_a_description(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "parts").mkdir()
    for part, rows in (("a", slice(0, 6)), ("b", slice(6, None))):
        path = plain(tmp_path / f"{part}{suffix if suffix != '.db3' else ''}", rows).close()
        path = path if path.is_file() else next(path.glob(f"*{suffix}"))
        path.rename(tmp_path / "parts" / path.name)
    np.testing.assert_allclose(read_log(tmp_path / "parts").T_odom_robot, drive()[1], atol=1e-5)


def test_topics_without_messages_are_no_choice(tmp_path: Path) -> None:
    bag = plain(tmp_path / "a.bag")
    with files.writer_of(bag.path, bag.path) as writer:
        for topic, kind in (("/odom", ODOMETRY), ("/odom2", ODOMETRY), ("/scan", SCAN), ("/scan2", SCAN)):
            end = writer.add_connection(topic, kind, typestore=bag.store)
            for received, its, _, message in bag.messages:
                if its == topic:
                    writer.write(end, round(1e9 * received), bag.store.serialize_ros1(message, kind))
    np.testing.assert_allclose(read_log(bag.path).T_odom_robot, drive()[1], atol=1e-5)


def test_the_first_echo_of_each_beam_is_read(tmp_path: Path) -> None:
    bag, kind = plain(tmp_path / "a"), "sensor_msgs/msg/MultiEchoLaserScan"
    echo = bag.store.types["sensor_msgs/msg/LaserEcho"]
    for n, (received, topic, its, scan) in enumerate(bag.messages):
        if its == SCAN:
            fields = {name: value for name, value in vars(scan).items() if name not in ("ranges", "intensities")}
            beams = [echo(np.array([one, one + 1.0], np.float32)) for one in scan.ranges]
            beams[0] = echo(np.empty(0, np.float32))
            many = bag.store.types[kind](**fields, ranges=beams, intensities=[])
            bag.messages[n] = (received, topic, kind, many)
    log = read_log(bag.close())
    np.testing.assert_allclose(log.ranges[:, 1:], drive()[2][:, 1:], atol=1e-5)
    assert np.isnan(log.ranges[:, 0]).all()


def test_clocks_that_differ_by_less_than_the_log(tmp_path: Path) -> None:
    assert not read_log(plain(tmp_path / "a.bag", late=0.1).close()).notes
    notes = read_log(plain(tmp_path / "b.bag", late=-0.5).close()).notes
    assert any("differ by -0.50 s: --clock received" in note for note in notes)


def test_a_frame_that_moves_on_the_robot_is_named(tmp_path: Path) -> None:
    bag = plain(tmp_path / "a.bag")
    for n in range(12):
        bag.frame(100.0 + n, "base_link", "pan", np.array([0.0, 0.0, 0.1 * n]))
    for message in (message for _, topic, _, message in bag.messages if topic == "/tf_static"):
        message.transforms[0].header.frame_id = "pan"
    assert any("'pan' moves on the robot" in note for note in read_log(bag.close()).notes)


def test_a_last_beam_that_is_not_at_its_angle_is_counted(tmp_path: Path) -> None:
    bag = plain(tmp_path / "a.bag")
    for message in (message for _, topic, _, message in bag.messages if topic == "/scan"):
        message.angle_max = -message.angle_max
    assert read_log(bag.close()).counts["scans whose last beam is not at their angle_max"] == 12
