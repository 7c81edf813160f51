"""A short drive through a square room, written in every format that is read."""

import math
from pathlib import Path
from typing import Any, Self

import numpy as np

from mecp_env.core.se2 import composed
from mecp_env.logs import Log, read_log

BEAMS, SIDE = 37, 6.0
BEARINGS = np.radians(np.linspace(-90.0, 90.0, BEAMS))
MOUNT = np.array([0.1, 0.0, 0.0])
SCAN, ODOMETRY, FRAMES = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


def drive(scans: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (n,), poses (n,3) and ranges (n,B): straight on, turning slowly, in the middle of a room."""
    t = 100.0 + 0.25 * np.arange(scans)
    heading = 0.02 * np.arange(scans)
    poses = np.column_stack((0.05 * np.arange(scans), 0.001 * np.arange(scans) ** 2, heading))
    return t, poses, np.array([sweep(pose) for pose in poses])


def sweep(pose: np.ndarray, mount: np.ndarray = MOUNT) -> np.ndarray:
    """(B,) m to the walls of a square room, whose middle is at the origin."""
    x, y, heading = composed(pose, mount)
    with np.errstate(divide="ignore"):
        c, s = np.cos(heading + BEARINGS), np.sin(heading + BEARINGS)
        across = (SIDE / 2 - np.sign(c) * x) / abs(c)
        up = (SIDE / 2 - np.sign(s) * y) / abs(s)
    return np.round(np.minimum(across, up), 3)


def check_path(log: Log, poses: np.ndarray | None = None) -> None:
    """The odometry of a log is that of the drive, or as given."""
    np.testing.assert_allclose(log.T_odom_robot, drive()[1] if poses is None else poses, atol=1e-5)


def joined(*parts: object) -> str:
    return " ".join(" ".join(f"{x:.6f}" for x in np.ravel(p)) if isinstance(p, np.ndarray) else str(p) for p in parts)


def head(kind: str) -> str:
    return f"{kind} 0 {-math.pi / 2:.9f} {math.pi:.9f} {math.pi / (BEAMS - 1):.9f} 30.0 0.01 0 {BEAMS}"


def flaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    return joined("FLASER", len(ranges), ranges, composed(pose, MOUNT), pose, t, "robot", t - 100.0)


def robotlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    laser = composed(pose, MOUNT)
    return joined(head("ROBOTLASER1"), ranges, 0, laser, pose, "0 0 0.3 0.3 0", t, "robot", t - 100.0)


def old_robotlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    return joined(head("ROBOTLASER1"), ranges, composed(pose, MOUNT), pose, "0 0 0.3 0.3", t, "robot", t - 100.0)


def rawlaser(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
    odom = joined("ODOM", pose, "0 0 0", t, "robot", t - 100.0)
    return odom + "\n" + joined(head("RAWLASER1"), ranges, 0, t, "robot", t - 100.0)


CARMEN = {"flaser": flaser, "robotlaser": robotlaser, "old_robotlaser": old_robotlaser, "rawlaser": rawlaser}


def lines_of(t: np.ndarray, poses: np.ndarray, ranges: np.ndarray, line=flaser) -> list[str]:
    return [line(*row) for row in zip(t, poses, ranges, strict=True)]


def read_lines(folder: Path, lines: list[str]) -> Log:
    """The log of a CARMEN file of these lines."""
    (folder / "a.log").write_text("\n".join(lines))
    return read_log(folder / "a.log")


def write_carmen(path: Path, line=flaser, scans: int = 12) -> Path:
    lines = lines_of(*drive(scans), line)
    path.write_text("\n".join(["# CARMEN Logfile", f"PARAM robot_frontlaser_offset {MOUNT[0]}", *lines, ""]))
    return path


def write_archive(path: Path, scans: int = 12, **more: object) -> Path:
    t, poses, ranges = drive(scans)
    ranges[2, 3] = np.nan
    arrays = {"t": t, "ranges": ranges, "angles": BEARINGS, "odo": poses, "ref": poses, "mount": MOUNT}
    arrays |= {"rel": np.array([[t[0], t[4], *poses[4]]])} | more
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


class BagWriter:
    """Collects messages with their times of receipt; `close` writes them as a bag of ROS 1 (`.bag`) or ROS 2."""

    packing: Any = None  # of a ROS 2 bag: which parts are packed

    def __init__(self, path: Path) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self.ros1 = path, path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", FRAMES))
        self.messages: list[tuple[float, str, str, Any]] = []

    def make(self, kind: str, *values: object, **fields: object) -> Any:
        """A message, or a part of one."""
        return self.store.types[kind](*values, **fields)

    def put(self, received: float, topic: str, kind: str, message: object) -> None:
        self.messages.append((received, topic, kind, message))

    def of(self, topic: str) -> list[Any]:
        """The messages so far on a topic."""
        return [message for _, its, _, message in self.messages if its == topic]

    def header(self, stamp: float, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=int(stamp), nanosec=round(1e9 * (stamp % 1.0)))
        return self.make("std_msgs/msg/Header", **({"seq": 0} if self.ros1 else {}), stamp=time, frame_id=frame)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", float(x), float(y), float(z))

    def turn(self, heading: float) -> Any:
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))

    def scan(self, received: float, ranges: np.ndarray, frame: str = "laser", topic: str = "/scan", t=None) -> None:
        angles = {"angle_min": BEARINGS[0], "angle_max": BEARINGS[-1], "angle_increment": BEARINGS[1] - BEARINGS[0]}
        limits = {"time_increment": 0.0, "scan_time": 0.25, "range_min": 0.1, "range_max": 30.0}
        arrays = {"ranges": ranges.astype(np.float32), "intensities": np.empty(0, np.float32)}
        header = self.header(received if t is None else t, frame)
        self.put(received, topic, SCAN, self.make(SCAN, header, **angles, **limits, **arrays))

    def odometry(self, received: float, pose: np.ndarray, speed: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        at = self.make("geometry_msgs/msg/Pose", self.vector(*pose[:2], 0.0, "Point"), self.turn(pose[2]))
        twist = self.make("geometry_msgs/msg/Twist", self.vector(*speed[:2], 0.0), self.vector(0.0, 0.0, speed[2]))
        parts = (("PoseWithCovariance", at), ("TwistWithCovariance", twist))
        both = (self.make(f"geometry_msgs/msg/{kind}", part, np.zeros(36)) for kind, part in parts)
        message = self.make(ODOMETRY, self.header(received, "odom"), "base_link", *both)
        self.put(received, "/odom", ODOMETRY, message)

    def frame(self, received: float, parent: str, child: str, pose: np.ndarray, topic: str = "/tf") -> None:
        transform = self.make("geometry_msgs/msg/Transform", self.vector(*pose[:2], 0.2), self.turn(pose[2]))
        one = self.make("geometry_msgs/msg/TransformStamped", self.header(received, parent), child, transform)
        self.put(received, topic, FRAMES, self.make(FRAMES, [one]))

    def frames(self, *edges: tuple[str, str, np.ndarray]) -> Self:
        """The poses, (n,3) or one (3,), of frames in their parents throughout the drive."""
        for row, stamp in enumerate(drive()[0]):
            for parent, child, poses in edges:
                self.frame(stamp, parent, child, poses if poses.ndim == 1 else poses[row])
        return self

    def close(self, *empty: tuple[str, str]) -> Path:
        """The path of what is written, with topics (and their types) that have no messages."""
        pack = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        folder = self.path.with_suffix("") if self.path.suffix in (".db3", ".mcap") else self.path
        with writer_of(self.path, folder, self.packing) as writer:
            ends = {topic: writer.add_connection(topic, kind, typestore=self.store) for topic, kind in empty}
            for received, topic, kind, message in sorted(self.messages, key=lambda one: one[0]):
                if topic not in ends:
                    ends[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(ends[topic], round(1e9 * received), pack(message, kind))
        return next(folder.glob(f"*{self.path.suffix}")) if folder != self.path else folder


def writer_of(path: Path, folder: Path, packing: Any) -> Any:
    from rosbags import rosbag1, rosbag2

    if path.suffix == ".bag":
        return rosbag1.Writer(path)
    plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    writer = rosbag2.Writer(folder, version=8, storage_plugin=plugin)
    if packing is not None:
        writer.set_compression(packing, rosbag2.CompressionFormat.ZSTD)
    return writer


def bag_of(
    path: Path,
    scan_topics: tuple[str, ...] = ("/scan",),
    odometry: bool = True,
    frames: str = "/tf_static",
    rows: slice = slice(None),
    late: float = 0.0,
) -> Self:
    """The drive, or some rows of it; scans are stamped so many seconds after they are received."""
    bag = BagWriter(path)
    for n, (stamp, pose, one) in enumerate(list(zip(*drive(), strict=True))[rows]):
        if frames and not n:
            bag.frame(stamp, "base_link", "laser", MOUNT, frames)
        for topic in scan_topics:
            bag.scan(stamp, one, topic=topic, t=stamp + late)
        if odometry:
            bag.odometry(stamp, pose)
    return bag


def write_bag(path: Path, **more: Any) -> Path:
    """A bag of ROS 1 (`.bag`) or ROS 2 (a folder, or the file in it with the suffix of `path`)."""
    return bag_of(path, **more).close()
