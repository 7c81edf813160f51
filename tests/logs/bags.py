"""Bags with any messages: scans of several frames, odometry among the frames, stamps of another clock."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tests.logs import files

SCAN, ODOMETRY, FRAMES = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class BagWriter:
    """Collects messages with their times of receipt; `close` writes them."""

    def __init__(self, path: Path) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self.ros1 = path, path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            fields = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(fields, "tf2_msgs/msg/TFMessage"))
        self.messages: list[tuple[float, str, str, object]] = []

    def put(self, received: float, topic: str, kind: str, message: object) -> None:
        self.messages.append((received, topic, kind, message))

    def scan(self, received: float, ranges: np.ndarray, frame: str = "laser", topic: str = "/scan", t=None) -> None:
        message = files.scan_message(self.store, received if t is None else t, ranges)
        message.header.frame_id = frame
        self.put(received, topic, SCAN, message)

    def odometry(self, received: float, pose: np.ndarray, child: str = "base_link") -> None:
        message = files.odometry_message(self.store, received, pose)
        message.child_frame_id = child
        self.put(received, "/odom", ODOMETRY, message)

    def frame(self, received: float, parent: str, child: str, pose: np.ndarray, topic: str = "/tf") -> None:
        kinds = self.store.types
        at = kinds["geometry_msgs/msg/Vector3"](float(pose[0]), float(pose[1]), 0.0)
        transform = kinds["geometry_msgs/msg/Transform"](at, files.turn_message(self.store, pose[2]))
        header = files.header_of(self.store, received, parent)
        one = kinds["geometry_msgs/msg/TransformStamped"](header, child, transform)
        self.put(received, topic, FRAMES, kinds["tf2_msgs/msg/TFMessage"]([one]))

    def close(self) -> Path:
        pack = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        ends: dict[str, object] = {}
        with files.writer_of(self.path, self.path) as writer:
            for received, topic, kind, message in sorted(self.messages, key=lambda one: one[0]):
                if topic not in ends:
                    ends[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(ends[topic], round(1e9 * received), pack(message, kind))
        return self.path


def sweep(pose: np.ndarray, mount: np.ndarray) -> np.ndarray:
    """(B,) m of a laser with this mounting pose, in the room of `files`."""
    x, y, heading = pose
    at = x + mount[0] * math.cos(heading), y + mount[0] * math.sin(heading), heading + mount[2]
    return files.sweep(
        np.array([at[0] - files.MOUNT[0] * math.cos(at[2]), at[1] - files.MOUNT[0] * math.sin(at[2]), at[2]])
    )
