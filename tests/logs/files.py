"""A short drive through a square room, written in every format that is read."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

BEAMS, SIDE = 37, 6.0
BEARINGS = np.radians(np.linspace(-90.0, 90.0, BEAMS))
MOUNT = np.array([0.1, 0.0, 0.0])


def drive(scans: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,), poses (n,3) and ranges (n,B): straight on, turning slowly, in the middle of a room."""
    t = 100.0 + 0.25 * np.arange(scans)
    heading = 0.02 * np.arange(scans)
    poses = np.column_stack((0.05 * np.arange(scans), 0.001 * np.arange(scans) ** 2, heading))
    return t, poses, np.array([sweep(pose) for pose in poses])


def sweep(pose: np.ndarray) -> np.ndarray:
    """(B,) m to the walls of a square room, whose middle is at the origin."""
    x, y, heading = pose
    x, y = x + MOUNT[0] * math.cos(heading), y + MOUNT[0] * math.sin(heading)
    with np.errstate(divide="ignore"):
        c, s = np.cos(heading + BEARINGS), np.sin(heading + BEARINGS)
        across = (SIDE / 2 - np.sign(c) * x) / abs(c)
        up = (SIDE / 2 - np.sign(s) * y) / abs(s)
    return np.round(np.minimum(across, up), 3)


def joined(*parts: object) -> str:
    return " ".join(" ".join(f"{x:.6f}" for x in np.ravel(p)) if isinstance(p, np.ndarray) else str(p) for p in parts)


def laser_pose(pose: np.ndarray) -> np.ndarray:
    x, y, heading = pose
    return np.array([x + MOUNT[0] * math.cos(heading), y + MOUNT[0] * math.sin(heading), heading])


def head(kind: str) -> str:
    return f"{kind} 0 {-math.pi / 2:.9f} {math.pi:.9f} {math.pi / (BEAMS - 1):.9f} 30.0 0.01 0 {BEAMS}"


def flaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    return joined("FLASER", len(ranges), ranges, laser_pose(pose), pose, t, "robot", t - 100.0)


def robotlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    return joined(head("ROBOTLASER1"), ranges, 0, laser_pose(pose), pose, "0 0 0.3 0.3 0", t, "robot", t - 100.0)


def old_robotlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    return joined(head("ROBOTLASER1"), ranges, laser_pose(pose), pose, "0 0 0.3 0.3", t, "robot", t - 100.0)


def rawlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    odom = joined("ODOM", pose, "0 0 0", t, "robot", t - 100.0)
    return odom + "\n" + joined(head("RAWLASER1"), ranges, 0, t, "robot", t - 100.0)


CARMEN = {"flaser": flaser, "robotlaser": robotlaser, "old_robotlaser": old_robotlaser, "rawlaser": rawlaser}


def write_carmen(path: Path, line=flaser, scans: int = 12) -> Path:
    lines = [line(*row) for row in zip(*drive(scans), strict=True)]
    path.write_text("\n".join(["# CARMEN Logfile", f"PARAM robot_frontlaser_offset {MOUNT[0]}", *lines, ""]))
    return path


def write_archive(path: Path, scans: int = 12, **more: object) -> Path:
    t, poses, ranges = drive(scans)
    ranges[2, 3] = np.nan
    relations = np.array([[t[0], t[4], *poses[4]]])
    arrays = {
        "t": t,
        "ranges": ranges,
        "angles": BEARINGS,
        "odo": poses,
        "ref": poses,
        "rel": relations,
        "mount": MOUNT,
    }
    arrays = {name: value for name, value in (arrays | more).items() if value is not None}
    np.savez(path, **arrays)
    return path


def write_bag(
    path: Path, scan_topics: tuple[str, ...] = ("/scan",), odometry: bool = True, frames: str = "/tf_static"
) -> Path:
    """A bag of ROS 1 (`.bag`) or ROS 2 (a folder, or the file in it with the suffix of `path`)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    folder = path.with_suffix("") if path.suffix in (".db3", ".mcap") else path
    with writer_of(path, folder) as writer:
        topics = dict.fromkeys(scan_topics, "sensor_msgs/msg/LaserScan")
        topics |= {"/odom": "nav_msgs/msg/Odometry"} if odometry else {}
        topics |= {frames: "tf2_msgs/msg/TFMessage"}
        ends = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        pack = store.serialize_ros1 if ros1 else store.serialize_cdr

        def write(topic, stamp, message):
            writer.write(ends[topic], round(1e9 * stamp), pack(message, topics[topic]))

        t, poses, ranges = drive()
        write(frames, t[0], frames_message(store, t[0]))
        for stamp, pose, one in zip(t, poses, ranges, strict=True):
            for topic in scan_topics:
                write(topic, stamp, scan_message(store, stamp, one))
            if odometry:
                write("/odom", stamp, odometry_message(store, stamp, pose))
    return next(folder.glob(f"*{path.suffix}")) if folder != path else path


def writer_of(path: Path, folder: Path):
    from rosbags import rosbag1, rosbag2

    if path.suffix == ".bag":
        return rosbag1.Writer(path)
    plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    return rosbag2.Writer(folder, version=8, storage_plugin=plugin)


def header_of(store, stamp: float, frame: str):
    kinds = store.types
    time = kinds["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round(1e9 * (stamp % 1.0)))
    sequence = {"seq": 0} if "seq" in kinds["std_msgs/msg/Header"].__annotations__ else {}
    return kinds["std_msgs/msg/Header"](stamp=time, frame_id=frame, **sequence)


def scan_message(store, stamp: float, ranges: np.ndarray):
    angles = {"angle_min": BEARINGS[0], "angle_max": BEARINGS[-1], "angle_increment": BEARINGS[1] - BEARINGS[0]}
    limits = {"time_increment": 0.0, "scan_time": 0.25, "range_min": 0.1, "range_max": 30.0}
    arrays = {"ranges": ranges.astype(np.float32), "intensities": np.empty(0, np.float32)}
    return store.types["sensor_msgs/msg/LaserScan"](header_of(store, stamp, "laser"), **angles, **limits, **arrays)


def turn_message(store, heading: float):
    return store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))


def odometry_message(store, stamp: float, pose: np.ndarray):
    kinds, cov, zero = store.types, np.zeros(36), store.types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    at = kinds["geometry_msgs/msg/Pose"](kinds["geometry_msgs/msg/Point"](*pose[:2], 0.0), turn_message(store, pose[2]))
    twist = kinds["geometry_msgs/msg/TwistWithCovariance"](kinds["geometry_msgs/msg/Twist"](zero, zero), cov)
    with_cov = kinds["geometry_msgs/msg/PoseWithCovariance"](at, cov)
    return kinds["nav_msgs/msg/Odometry"](header_of(store, stamp, "odom"), "base_link", with_cov, twist)


def frames_message(store, stamp: float):
    kinds = store.types
    transform = kinds["geometry_msgs/msg/Transform"](
        kinds["geometry_msgs/msg/Vector3"](*MOUNT[:2], 0.2), turn_message(store, 0.0)
    )
    one = kinds["geometry_msgs/msg/TransformStamped"](header_of(store, stamp, "base_link"), "laser", transform)
    return kinds["tf2_msgs/msg/TFMessage"]([one])
