"""Coordinate frames of a bag: where each is in its parent, mounting poses of lasers, and odometry among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.se2 import chained
from mecp_env.logs.clock import ascending_rows
from mecp_env.logs.recording import POSE_BYTES, Track

Transform = Array  # (4,4)
ROBOT_FRAMES = ("base_link", "base_footprint")
LOOSE = 0.05  # of a transform, in m and of unit vectors: a frame that changes more is not fixed
MOST_CHAIN = 32  # frames between the laser and the robot
MOST_NAMES = 1000  # frames in a bag
Edge = tuple[str, str]  # parent, child


class ZeroQuaternion(ValueError):
    """A rotation of four zeros, as drivers send that set none."""


@dataclass(slots=True, eq=False)
class Frames:
    """The frames of the messages so far."""

    take: Callable[[int], None]  # spends bytes
    parents: dict[str, tuple[str, Transform]] = field(default_factory=dict)  # frame -> its parent, pose in it
    moving: dict[Edge, Track] = field(default_factory=dict)  # poses of robots in their odometry frames
    loose: set[str] = field(default_factory=set)  # those that move in their parents

    def add(self, parent: str, child: str, T_parent_child: Transform, stamp: float, order: float) -> None:
        """Take in the pose of a frame in its parent. Raises `LogError` for too many frames."""
        if child not in self.parents and len(self.parents) >= MOST_NAMES:
            raise LogError(f"it has more than {MOST_NAMES} frames")
        _, first = self.parents.setdefault(child, (parent, T_parent_child))
        if abs(T_parent_child - first).max() > LOOSE:
            self.loose.add(child)
        edge, T_odom_robot = (parent, child), T_parent_child
        if _is_odometry(child) and _is_robot(parent):
            edge, T_odom_robot = (child, parent), np.asarray(np.linalg.inv(T_parent_child), np.float64)
        if _is_odometry(edge[0]) and not _is_odometry(edge[1]):
            self.take(POSE_BYTES)
            self.moving.setdefault(edge, Track()).add(stamp, planar(T_odom_robot), order)

    def odometry(self, lasers: Iterable[str]) -> Edge | None:
        """The odometry frame and the robot's: that of the robot that carries the lasers, then that of the usual name.

        None where none moved.
        """
        above = {name for laser in lasers for name, _ in self._chain(laser)}
        poses = {edge: len(track.t) for edge, track in self.moving.items() if len(track.t) > 1}
        return max(poses, key=lambda edge: (edge[1] in above, _is_robot(edge[1]), poses[edge]), default=None)

    def robot(self, stated: str) -> str:
        """The robot's frame: as the odometry states it, or by its usual name; empty where there is none."""
        known = {*self.parents, *(parent for parent, _ in self.parents.values())}
        usual = sorted((name for name in known if _is_robot(name)), key=lambda name: (len(name), name))
        return stated if stated in known or not usual else usual[0]

    def mount(self, laser: str, robot: str) -> Transform | None:
        """The laser's pose in the robot's frame, where frames join the two."""
        above = dict(self._chain(laser)), dict(self._chain(robot))
        common = next((name for name in above[0] if name in above[1]), None)
        return None if common is None else np.linalg.inv(above[1][common]) @ above[0][common]

    def moving_below(self, laser: str, robot: str) -> list[str]:
        """Those that move between the robot's frame and the laser's, with which it is."""
        above = [name for name, _ in self._chain(laser)]
        return [name for name in above[: above.index(robot)] if name in self.loose] if robot in above else []

    def _chain(self, frame: str) -> Iterator[tuple[str, Transform]]:
        """The frame and those above it, each with the pose of the first in it."""
        T = np.eye(4)
        for _ in range(MOST_CHAIN):
            yield frame, T
            if frame not in self.parents:
                return
            frame, step = self.parents[frame]
            T = step @ T

    def listed(self) -> str:
        """All frames with their parents, in words."""
        return ", ".join(f"{parent} -> {child}" for child, (parent, _) in self.parents.items())[:600] or "none"


def driven(speeds: Track) -> Track:
    """The poses after driving at these speeds (3,) m/s, m/s, rad/s from each stamp to the next."""
    rows = ascending_rows(np.array(speeds.t, np.float64))
    t, order, speed = (np.array(values)[rows] for values in (speeds.t, speeds.order, speeds.poses))
    return Track(t.tolist(), list(chained(speed[:-1] * np.diff(t)[:, None])), order.tolist())


def _is_odometry(frame: str) -> bool:
    return "odom" in frame.rsplit("/", 1)[-1].lower()


def _is_robot(frame: str) -> bool:
    return frame.rsplit("/", 1)[-1].lower() in ROBOT_FRAMES


def transform(position: Any, rotation: Any) -> Transform:
    """(4,4) of a position and a quaternion of whatever length. Raises `ValueError` unless they are finite."""
    length = math.hypot(rotation.x, rotation.y, rotation.z, rotation.w)
    if length == 0.0:
        raise ZeroQuaternion
    x, y, z, w = rotation.x / length, rotation.y / length, rotation.z / length, rotation.w / length
    T = np.eye(4)
    T[:3, 3] = position.x, position.y, position.z
    T[0, :3] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    T[1, :3] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    T[2, :3] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)
    if not np.isfinite(T).all():
        raise ValueError
    return T


def planar(T: Transform) -> Array:
    """(3,) x, y, heading of a transform."""
    return np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])])
