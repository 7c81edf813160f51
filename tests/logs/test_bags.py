"""What bags of other robots have: odometry among the frames, several lasers, other clocks, rotations of zeros."""

from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.bag_parts import MOST_MESSAGE, check_parts, unpacked_message
from tests.logs.files import (
    BEARINGS,
    MOUNT,
    ODOMETRY,
    SCAN,
    SIDE,
    BagWriter,
    bag_of,
    check_path,
    drive,
    sweep,
)

pytest.importorskip("rosbags")
FRONT, REAR = np.array([0.25, 0.0, 0.0]), np.array([-0.25, 0.0, np.pi])
HERE = np.zeros(3)


@pytest.mark.parametrize(
    ("name", "parent", "child"), [("a.bag", "odom", "base_link"), ("a", "/odom", "base_footprint")]
)
def test_odometry_of_the_frames(tmp_path: Path, name: str, parent: str, child: str) -> None:
    bag = bag_of(tmp_path / name, odometry=False, frames="")
    bag.frames(("map", parent, HERE), (parent, child, drive()[1]), (child, "laser", MOUNT))
    log = read_log(bag.close())
    check_path(log)
    np.testing.assert_allclose(log.T_robot_laser, MOUNT, atol=1e-5)
    assert any(f"{parent.strip('/')} -> {child}" in note for note in log.notes)


@pytest.mark.parametrize(("of_frames", "of_messages"), [(2.0, 1.0), (1.0, 0.0)])
def test_odometry_of_a_message_counts_before_that_of_the_frames_if_it_moves(
    tmp_path: Path, of_frames: float, of_messages: float
) -> None:
    bag = bag_of(tmp_path / "a.bag", odometry=False)
    for stamp, pose in zip(*drive()[:2], strict=True):
        bag.odometry(stamp, of_messages * pose)
    check_path(read_log(bag.frames(("odom", "base_link", of_frames * drive()[1])).close()))


def test_odometry_of_the_frames_is_that_of_the_robot_with_the_laser(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "a.bag")
    for stamp, _, one in zip(*drive(), strict=True):
        for robot in ("other", "own"):
            bag.scan(stamp, one, f"{robot}/laser", f"/{robot}/scan")
    for robot, path in (("other", -drive()[1]), ("own", drive()[1])):
        bag.frames(
            ("map", f"{robot}/odom", HERE),
            (f"{robot}/odom", f"{robot}/base_link", path),
            (f"{robot}/base_link", f"{robot}/laser", MOUNT),
        )
    for stamp, pose in zip(*drive()[:2], strict=True):
        bag.frame(stamp + 0.1, "other/odom", "other/base_link", -pose)  # the other robot has more poses
    check_path(read_log(bag.close(), ReadOptions(scan_topic="/own/scan")))


def test_without_odometry_or_mount_what_is_there_is_listed(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag", odometry=False, frames="")
    log = read_log(bag.frames(("map", "laser", MOUNT)).close())
    assert log.T_odom_robot is None
    assert all(word in log.notes[0] for word in ("/scan", "sensor_msgs/msg/LaserScan", "map -> laser"))
    bag = bag_of(tmp_path / "b.bag", odometry=False, frames="").frames(("odom", "base_footprint", drive()[1]))
    notes = read_log(bag.close()).notes
    assert any("'laser' in 'base_footprint'; frames: odom -> base_footprint" in note for note in notes)


def test_the_mount_is_in_the_frame_that_the_odometry_names(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag", frames="")
    bag.frames(("base_footprint", "base_link", np.array([0.2, 0.0, 0.0])), ("base_link", "laser", MOUNT))
    for message in bag.of("/odom"):
        message.child_frame_id = "base_footprint"
    np.testing.assert_allclose(read_log(bag.close()).T_robot_laser, MOUNT + np.array([0.2, 0.0, 0.0]), atol=1e-5)


def two_lasers(path: Path, topics: tuple[str, str], frames: bool = True, late: float = 0.0) -> Path:
    bag = BagWriter(path)
    for stamp, pose in zip(*drive()[:2], strict=True):
        bag.odometry(stamp, pose)
        for name, mount, topic, after in (("front", FRONT, topics[0], 0.0), ("rear", REAR, topics[1], late)):
            at = pose + after / 0.25 * np.array([0.05, 0.0, 0.02])
            bag.scan(stamp + after, sweep(at, mount), name, topic)
    return (bag.frames(("base_link", "front", FRONT), ("base_link", "rear", REAR)) if frames else bag).close()


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
    assert log.sensor()["no_return"] == "unknown"  # a beam that no laser covers tells nothing
    check_room(log)


def test_lasers_whose_frames_are_unknown_are_named(tmp_path: Path) -> None:
    path = two_lasers(tmp_path / "a.bag", ("/scan", "/scan"), frames=False)
    with pytest.raises(LogError, match=r"front, rear.*--scan-frame"):
        read_log(path)
    with pytest.raises(LogError, match=r"'fron'; did you mean 'front'"):
        read_log(path, ReadOptions(scan_frame="fron"))
    assert read_log(path, ReadOptions(scan_frame="rear")).counts["scans of another frame"] == len(drive()[0])


def test_clocks_that_differ(tmp_path: Path) -> None:
    path = bag_of(tmp_path / "a.bag", late=97554.0).close()
    with pytest.raises(LogError, match=r"scans from 97654.*odometry from 100.*--clock received"):
        read_log(path)
    check_path(read_log(path, ReadOptions(clock="received")))
    assert not read_log(bag_of(tmp_path / "b.bag", late=0.1).close()).notes
    notes = read_log(bag_of(tmp_path / "c.bag", late=-0.5).close()).notes
    assert any("differ by -0.50 s: --clock received" in note for note in notes)


def test_quaternions_count_whatever_their_length_but_not_those_of_zeros(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag")
    for n, message in enumerate(bag.of("/odom")):
        rotation, length = message.pose.pose.orientation, 1.4 * (n != 3)
        rotation.z, rotation.w = length * rotation.z, length * rotation.w
    log = read_log(bag.close())
    assert log.counts["messages with a quaternion of zeros"] == 1
    between_neighbours = drive()[1]
    between_neighbours[3] = 0.5 * (between_neighbours[2] + between_neighbours[4])
    np.testing.assert_allclose(log.T_odom_robot, between_neighbours, atol=1e-4)


def test_several_topics_of_odometry_are_no_fault_where_none_is_used_nor_are_topics_without_messages(
    tmp_path: Path,
) -> None:
    bag = bag_of(tmp_path / "a.bag")
    bag.put(100.0, "/filtered", ODOMETRY, bag.of("/odom")[0])
    path = bag.close(("/odom2", ODOMETRY), ("/scan2", SCAN))  # without messages
    with pytest.raises(LogError, match=r"--odometry-topic: 2 topics"):
        read_log(path)
    assert read_log(path, ReadOptions(use_odometry=False)).T_odom_robot is None


@pytest.mark.parametrize(("tilt", "said"), [(0.02, False), (0.5 * np.pi, True), (np.pi - 0.02, False)])
def test_a_laser_that_is_not_level_is_named(tmp_path: Path, tilt: float, said: bool) -> None:
    bag = bag_of(tmp_path / "a.bag")
    rotation = bag.of("/tf_static")[0].transforms[0].transform.rotation
    rotation.x, rotation.w = np.sin(0.5 * tilt), np.cos(0.5 * tilt)
    assert any("tilted by 90 deg" in note for note in read_log(bag.close()).notes) == said


def test_a_frame_that_moves_on_the_robot_is_named(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag", frames="").frames(("pan", "laser", MOUNT))
    bag.frames(("base_link", "pan", np.outer(np.arange(12.0), [0.0, 0.0, 0.1])))
    assert any("'pan' moves on the robot" in note for note in read_log(bag.close()).notes)


def test_messages_without_stamps_are_counted(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag")
    for message in bag.of("/scan"):
        object.__setattr__(message.header.stamp, "sec", 0)
        object.__setattr__(message.header.stamp, "nanosec", 0)
    log = read_log(bag.close())
    np.testing.assert_allclose(log.t, drive()[0])
    assert log.counts["messages without a stamp, as received"] == 12


def test_fields_that_a_driver_leaves_out_or_states_wrongly(tmp_path: Path) -> None:
    bag, other = bag_of(tmp_path / "a.bag"), bag_of(tmp_path / "b.bag")
    for message, wrong in zip(bag.of("/scan"), other.of("/scan"), strict=True):
        message.angle_increment, message.range_min, message.range_max = 0.0, np.nan, np.nan
        wrong.angle_max = -wrong.angle_max
    log = read_log(bag.close())
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
    np.testing.assert_allclose(log.ranges, drive()[2], atol=1e-5)
    assert read_log(other.close()).counts["scans whose last beam is not at their angle_max"] == 12


@pytest.mark.parametrize("constant", [False, True])
def test_odometry_that_has_speeds_alone(constant: bool, tmp_path: Path) -> None:
    t, poses, _ = drive()
    poses = np.outer(t - t[0], [0.2, 0.0, 0.0]) if constant else poses
    bag = bag_of(tmp_path / "a.bag", odometry=False)
    speeds = (between(poses[:-1], poses[1:]) / 0.25).round(9)
    for stamp, speed in zip(t, [*speeds, speeds[-1]], strict=True):
        bag.odometry(stamp, HERE, speed)
    log = read_log(bag.close())
    check_path(log, poses)
    assert any("speeds" in note for note in log.notes)


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_a_folder_of_parts_without_a_description(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "parts").mkdir()
    for part, rows in (("a", slice(0, 6)), ("b", slice(6, None))):
        path = bag_of(tmp_path / f"{part}{suffix}", rows=rows).close()
        path.rename(tmp_path / "parts" / path.name)
    check_path(read_log(tmp_path / "parts"))


def test_the_first_echo_of_each_beam_is_read(tmp_path: Path) -> None:
    bag, kind = bag_of(tmp_path / "a"), "sensor_msgs/msg/MultiEchoLaserScan"
    for n, (received, topic, its, scan) in enumerate(bag.messages):
        if its == SCAN:
            fields = {name: value for name, value in vars(scan).items() if name not in ("ranges", "intensities")}
            echoes = [[], *([one, one + 1.0] for one in scan.ranges[1:])]
            beams = [bag.make("sensor_msgs/msg/LaserEcho", np.array(each, np.float32)) for each in echoes]
            bag.messages[n] = (received, topic, kind, bag.make(kind, **fields, ranges=beams, intensities=[]))
    log = read_log(bag.close())
    np.testing.assert_allclose(log.ranges[:, 1:], drive()[2][:, 1:], atol=1e-5)
    assert np.isnan(log.ranges[:, 0]).all()


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_part_with_packed_messages_alone(tmp_path: Path, suffix: str) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    bag = bag_of(tmp_path / f"a{suffix}")
    bag.packing = rosbag2.CompressionMode.MESSAGE
    part = bag.close()
    check_path(read_log(part))
    (part.parent / "metadata.yaml").unlink()
    check_path(read_log(part))


def test_a_packed_message_is_unpacked_up_to_a_limit() -> None:
    zstd = pytest.importorskip("backports.zstd")
    assert len(unpacked_message(zstd.compress(bytes(2**26)))) == MOST_MESSAGE
    assert unpacked_message(zstd.compress(b"short")) == b"short"
    assert unpacked_message(b"plain") == b"plain"


def with_chunks(path: Path, *chunks: bytes) -> Path:
    """A file with the records of a bag of ROS 1, without heads."""
    records = (bytes(4) + len(chunk).to_bytes(4, "little") + chunk for chunk in chunks)
    path.write_bytes(b"#ROSBAG V2.0\n" + b"".join(records))
    return path


@pytest.mark.parametrize("module", ["bz2", "lz4.frame", "backports.zstd"])
def test_frames_in_a_chunk_count_together_whatever_the_one_before_is(tmp_path: Path, module: str) -> None:
    """Seen: behind a damaged chunk, none was checked."""
    pack, noise = pytest.importorskip(module).compress, np.random.default_rng(0).bytes(200_000)
    frames = pack(noise) + 1000 * pack(b"x") + 3 * pack(bytes(1_000_000))
    cut, wrong = pack(noise)[:-5000], pack(noise)[:9000] + bytes(50) + pack(noise)[9050:]
    bag = with_chunks(tmp_path / "a.bag", cut, wrong, frames)
    check_parts(bag, 3_201_000)
    with pytest.raises(LogError, match="a chunk unpacks to more than 3200999 bytes"):
        check_parts(bag, 3_200_999)


def test_an_increment_of_the_wrong_sign_and_scans_without_ranges(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag")
    for scan in bag.of("/scan"):
        scan.angle_min, scan.angle_max, scan.ranges = scan.angle_max, scan.angle_min, scan.ranges[::-1].copy()
    bag.of("/scan")[3].ranges = np.empty(0, np.float32)
    log = read_log(bag.close())
    assert log.counts["scans without ranges"] == 1
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-5)
    np.testing.assert_allclose(log.ranges, np.delete(drive()[2], 3, axis=0), atol=1e-5)


def test_quaternions_with_w_first_limits_that_are_wrong_and_a_clock_that_is_set_back_are_named(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "a.bag")
    for message in bag.of("/odom"):
        q = message.pose.pose.orientation
        q.x, q.y, q.z, q.w = q.w, q.x, q.y, q.z
    for scan in bag.of("/scan"):
        scan.range_max = float(np.quantile(drive()[2], 0.1))
    bag.of("/scan")[-1].header.stamp.sec -= 2
    notes = read_log(bag.close()).notes
    for said in ("perhaps w is first", "of the readings measure nothing", "1 of 12 scans are out of order"):
        assert any(said in note for note in notes)
