"""ROS 1 and ROS 2 bags, by the package `rosbags`: LaserScan, Odometry, and the mounting pose from the frames."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.errors import LogError
from mecp_env.core.settings import guess
from mecp_env.logs.carmen import MOST_BEAMS
from mecp_env.logs.recording import Geometry, Recording, Sweep

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC, MOVING = "/tf_static", "/tf"  # ROS 1 bags often have the fixed frames among the others
REPAIR = "`rosbag reindex` (ROS 1), `ros2 bag reindex` or `mcap recover` may repair it"
MOST_FRAMES = 32  # between the laser and the robot
Transform = Array  # (4,4)


@dataclass(slots=True, eq=False)
class BagLog:
    """What the messages so far have said."""

    recording: Recording
    laser_frame: str = ""
    robot_frame: str = ""
    parents: dict[str, tuple[str, Transform]] = field(default_factory=dict)  # frame -> its parent, pose in it

    def scan(self, message: Any, received: float) -> None:
        """A sweep. Raises `ValueError` for a damaged one."""
        ranges = np.array(message.ranges, np.float64)
        limits = float(message.range_min), float(message.range_max)
        view = float(message.angle_min), float(message.angle_increment)
        if not (0 < len(ranges) <= MOST_BEAMS and all(map(math.isfinite, (*view, limits[0])))):
            raise ValueError
        geometry = Geometry(len(ranges), *view, limits[0], limits[1] if limits[1] > limits[0] else math.inf)
        self.laser_frame = self.laser_frame or str(message.header.frame_id).strip("/")
        self.recording.sweeps.append(Sweep(_stamp(message.header, received), ranges, geometry))

    def odometry(self, message: Any, received: float) -> None:
        """A pose of the robot by its wheels."""
        T = _transform(message.pose.pose.position, message.pose.pose.orientation)
        self.robot_frame = self.robot_frame or str(message.child_frame_id).strip("/")
        self.recording.odometry.add(_stamp(message.header, received), _planar(T))

    def frames(self, message: Any, received: float) -> None:
        """Where frames are in their parents."""
        for one in message.transforms:
            T = _transform(one.transform.translation, one.transform.rotation)
            self.parents[str(one.child_frame_id).strip("/")] = str(one.header.frame_id).strip("/"), T

    def mount(self) -> Transform | None:
        """The laser's pose in the robot's frame, where static frames join the two."""
        above = dict(self._chain(self.laser_frame)), dict(self._chain(self.robot_frame))
        common = next((name for name in above[0] if name in above[1]), None)
        return None if common is None else np.linalg.inv(above[1][common]) @ above[0][common]

    def _chain(self, frame: str) -> Iterator[tuple[str, Transform]]:
        """The frame and those above it, each with the pose of the first in it."""
        T = np.eye(4)
        for _ in range(MOST_FRAMES):
            yield frame, T
            if frame not in self.parents:
                return
            frame, step = self.parents[frame]
            T = step @ T


def is_bag(path: Path) -> bool:
    """True for the folder or file of a bag, by its name."""
    return path.suffix in (".bag", ".db3", ".mcap") or (path / "metadata.yaml").is_file()


def read_bag(path: Path, scan_topic: str | None = None, odometry_topic: str | None = None) -> Recording:
    """What is in a bag. Raises `LogError`."""
    try:
        reader = importlib.import_module("rosbags.highlevel")
        stores = importlib.import_module("rosbags.typesys")
    except ImportError:
        raise LogError('to read bags takes the package rosbags: pip install "mecp_env[logs]"') from None
    log = BagLog(Recording(path.name))
    try:
        with reader.AnyReader([path], default_typestore=stores.get_typestore(stores.Stores.LATEST)) as bag:
            _read(bag, log, scan_topic, odometry_topic)
    except LogError:
        raise
    except Exception as error:  # damaged bytes may raise anything
        if not log.recording.sweeps:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise LogError(f"no bag, or damaged; {REPAIR} ({reason:.160})") from None
        log.recording.counts["bag cut short"] += 1
    _turn_over(log)
    return log.recording


def _read(bag: Any, log: BagLog, scan_topic: str | None, odometry_topic: str | None) -> None:
    """All messages of the chosen topics."""
    kinds = {connection.topic: connection.msgtype for connection in bag.connections}
    scans = _topic(kinds, SCAN, scan_topic, "--scan-topic")
    if scans is None:
        raise LogError(f"no laser: no topic of type {SCAN}; topics: {_listed(kinds)}")
    odometry = _topic(kinds, ODOMETRY, odometry_topic, "--odometry-topic")
    takers = {scans: log.scan, odometry: log.odometry}
    takers |= dict.fromkeys(_frame_topics(kinds), log.frames)
    for connection, received, data in bag.messages([c for c in bag.connections if c.topic in takers]):
        try:
            takers[connection.topic](bag.deserialize(data, connection.msgtype), 1e-9 * received)
        except Exception:  # damaged bytes may raise anything
            log.recording.counts["damaged messages"] += 1


def _frame_topics(kinds: dict[str, str]) -> list[str]:
    """The topic of the frames: of the fixed ones, or else of all."""
    return [topic for topic in (STATIC, MOVING) if kinds.get(topic) in FRAMES][:1]


def _topic(kinds: dict[str, str], kind: str, asked: str | None, option: str) -> str | None:
    """The topic of a type: as asked, or the only one; None without any. Raises `LogError`."""
    found = sorted(topic for topic, its in kinds.items() if its == kind)
    if asked is not None and asked not in found:
        raise LogError(f"{option}: no {kind} on {asked!r:.80}{guess(asked, found)}; topics: {_listed(kinds)}")
    if asked is None and len(found) > 1:
        raise LogError(f"{option}: {len(found)} topics of type {kind}, one must be named: {', '.join(found)}")
    return asked or next(iter(found), None)


def _listed(kinds: dict[str, str]) -> str:
    return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))[:600] or "none"


def _stamp(header: Any, received: float) -> float:
    """The stamp of a message; when it was received, for a driver that sets none."""
    stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
    return float(stamp) if stamp > 0.0 else received


def _transform(position: Any, rotation: Any) -> Transform:
    """(4,4) of a position and a quaternion. Raises `ValueError` unless they are finite and of length 1."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    T = np.eye(4)
    T[:3, 3] = position.x, position.y, position.z
    T[0, :3] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    T[1, :3] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    T[2, :3] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)
    if not np.isfinite(T).all() or abs(x * x + y * y + z * z + w * w - 1.0) > 0.01:
        raise ValueError
    return T


def _planar(T: Transform) -> Array:
    """(3,) x, y, heading of a transform."""
    return np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])])


def _turn_over(log: BagLog) -> None:
    """The mounting pose, where the bag has it; a laser that hangs upside down turns the other way."""
    mount = log.mount()
    if mount is None:
        return
    log.recording.T_robot_laser = _planar(mount)
    if mount[2, 2] < 0.0:
        log.recording.counts["scans of a laser upside down, mirrored"] = len(log.recording.sweeps)
        log.recording.sweeps = [sweep.mirrored() for sweep in log.recording.sweeps]
