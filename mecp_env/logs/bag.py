"""ROS 1 and ROS 2 bags, by the package `rosbags`: LaserScan, Odometry or its frames, and where lasers are mounted."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LogError
from mecp_env.core.settings import guess
from mecp_env.logs.bag_parts import check_parts, unpacked_message
from mecp_env.logs.clock import note_delay
from mecp_env.logs.frames import Frames, Transform, ZeroQuaternion, driven, planar, transform
from mecp_env.logs.recording import MOST_BEAMS, POSE_BYTES, Geometry, ReadOptions, Recording, Sweep, Track

SCAN, ECHOES = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
NO_ODOMETRY = f"no odometry: no message of type {ODOMETRY} that can be read, and no frame that moves in odom; "
TILTED = (
    "warning: by most quaternions of the odometry the robot lies on its side: they are x, y, z, w, perhaps w is first "
    "here; --odometry none does without"
)
SEVERAL = "; named more than once, it merges several"
FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FRAME_TOPICS = ("/tf", "/tf_static")
REPAIR = "`rosbag reindex` (ROS 1), `ros2 bag reindex` or `mcap recover` may repair it"
SUFFIXES = (".bag", ".db3", ".mcap")
MOST_LASERS = 8
UPRIGHT = math.cos(math.radians(45.0))  # a robot that is tilted more falls over
LEVEL = math.cos(math.radians(5.0))  # a laser that is tilted more does not measure level


@dataclass(slots=True, eq=False)
class BagLog:
    """What the messages so far have said."""

    recording: Recording
    frames: Frames
    kinds: dict[str, str] = field(default_factory=dict)  # of the topics with messages
    robot_frame: str = ""
    speeds: Track = field(default_factory=Track)  # m/s, m/s, rad/s of the messages with odometry
    tilted: int = 0  # messages with odometry of a robot that is not upright
    lasers: list[str] = field(default_factory=list)  # their frames, in the order of `Sweep.laser`

    def scan(self, message: Any, received: float) -> None:
        """A sweep. Raises `ValueError` for a damaged one."""
        ranges = _ranges(message)
        if not len(ranges):
            self.recording.counts["scans without ranges"] += 1
            return
        least, most = float(message.range_min), float(message.range_max)
        least = least if math.isfinite(least) else 0.0
        start, step = float(message.angle_min), _step(message)
        if not (len(ranges) <= MOST_BEAMS and math.isfinite(start) and math.isfinite(step)):
            raise ValueError
        geometry = Geometry(len(ranges), start, step, least, most if most > least else math.inf)
        laser = self.laser(_name(message.header.frame_id))
        off = abs(start + (len(ranges) - 1) * step - message.angle_max) > 2.0 * abs(step)
        self.recording.counts["scans whose last beam is not at their angle_max"] += off
        self.recording.add(Sweep(self.stamp(message.header, received), ranges, geometry, order=received, laser=laser))

    def stamp(self, header: Any, received: float) -> float:
        """The stamp of a message; when it was received, counted, for a driver that sets none."""
        self.recording.counts["messages without a stamp, as received"] += not _seconds(header) > 0.0
        return _stamp(header, received)

    def laser(self, frame: str) -> int:
        """Which laser has this frame. Raises `LogError` for too many."""
        if frame not in self.lasers:
            if len(self.lasers) == MOST_LASERS:
                raise LogError(f"scans of more than {MOST_LASERS} frames: {', '.join(self.lasers)}")
            self.lasers.append(frame)
        return self.lasers.index(frame)

    def odometry(self, message: Any, received: float) -> None:
        """A pose of the robot by its wheels."""
        T = transform(message.pose.pose.position, message.pose.pose.orientation)
        self.robot_frame = self.robot_frame or _name(message.child_frame_id)
        self.tilted += T[2, 2] < UPRIGHT
        self.recording.take(2 * POSE_BYTES)
        stamp, twist = self.stamp(message.header, received), message.twist.twist
        self.recording.odometry.add(stamp, planar(T), received)
        self.speeds.add(stamp, np.array([twist.linear.x, twist.linear.y, twist.angular.z]), received)

    def tf(self, message: Any, received: float) -> None:
        """Where frames are in their parents; a damaged one is left out."""
        for one in message.transforms:
            try:
                T = transform(one.transform.translation, one.transform.rotation)
            except ValueError as error:
                self.damaged(error, "transforms")
                continue
            names = _name(one.header.frame_id), _name(one.child_frame_id)
            self.frames.add(*names, T, _stamp(one.header, received), received)

    def damaged(self, error: Exception, what: str) -> None:
        """Count what cannot be used, by its fault."""
        named = f"{what} with a quaternion of zeros" if isinstance(error, ZeroQuaternion) else f"damaged {what}"
        self.recording.counts[named] += 1

    def topics(self, asked: Sequence[str], option: str, several: str, kind: str, *like: str) -> list[str]:
        """The topics of a type, or of one like it: as asked, or the only one; none without any. Raises `LogError`."""
        found = sorted(topic for topic, its in self.kinds.items() if its in (kind, *like))
        for topic in (topic for topic in asked if topic not in found):
            raise LogError(f"{option}: no {kind} on {topic!r:.80}{guess(topic, found)}; topics: {self.listed()}")
        if not asked and len(found) > 1:
            many = f"{len(found)} topics of type {kind}"
            raise LogError(f"{option}: {many}, one must be named: {', '.join(found)}{several}")
        return list(dict.fromkeys(asked)) or found

    @property
    def used(self) -> dict[int, str]:
        """The lasers whose sweeps are kept, with their frames."""
        return {laser: self.lasers[laser] for laser in sorted({sweep.laser for sweep in self.recording.sweeps})}

    def listed(self) -> str:
        """All topics with their types, in words."""
        return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(self.kinds.items()))[:600] or "none"


def is_bag(path: Path) -> bool:
    """True for the file of a bag, by its name, and for a folder of some."""
    return bool(_files(path))


def _files(path: Path) -> list[Path]:
    """What to read: a file, the folder of a ROS 2 bag, or all files of one that has no description."""
    if (path / "metadata.yaml").is_file():
        return [path]
    files = [file for file in sorted(path.iterdir()) if file.is_file()] if path.is_dir() else [path]
    return [file for file in files if file.suffix in SUFFIXES]


def read_bag(path: Path, options: ReadOptions) -> Recording:
    """What is in a bag. Raises `LogError`."""
    open_bag = _opener()
    parts = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
    recording = Recording(path.name, sum(file.stat().st_size for file in parts))
    for file in _files(path):
        check_parts(file, recording.most)
    log = BagLog(recording, Frames(recording.take))
    try:
        with open_bag(_files(path)) as bag:
            _read(bag, log, options)
    except LogError:
        raise
    except Exception as error:  # damaged bytes may raise anything
        if not recording.sweeps:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise LogError(f"no bag, or damaged; {REPAIR} ({reason:.160})") from None
        recording.counts["bag cut short"] += 1
    _choose_frame(log, options.scan_frame)
    _find_odometry(log)
    note_delay(recording)
    _mount(log)
    return recording


def _opener() -> Callable[[list[Path]], Any]:
    """What opens the files of a bag. Raises `LogError` without the library."""
    try:
        highlevel, typesys = map(importlib.import_module, ("rosbags.highlevel", "rosbags.typesys"))
    except ImportError:
        raise LogError('to read bags takes the package rosbags: pip install "mecp_env[logs]"') from None
    return partial(highlevel.AnyReader, default_typestore=typesys.get_typestore(typesys.Stores.LATEST))


def _read(bag: Any, log: BagLog, options: ReadOptions) -> None:
    """All messages of the topics that are read. Raises `LogError`."""
    used = [connection for connection in bag.connections if connection.msgcount] or bag.connections
    log.kinds |= {connection.topic: connection.msgtype for connection in used}
    takers = _takers(log, options)
    for connection, received, data in bag.messages([c for c in bag.connections if c.topic in takers]):
        try:
            message = bag.deserialize(unpacked_message(data), connection.msgtype)
            takers[connection.topic](message, 1e-9 * received)
        except LogError:
            raise
        except Exception as error:  # damaged bytes may raise anything
            log.damaged(error, "messages")


def _takers(log: BagLog, options: ReadOptions) -> dict[str, Callable[[Any, float], None]]:
    """What takes the messages of each topic that is read. Raises `LogError`.

    Several topics of odometry are an error unless one is asked for, or none is used.
    """
    scans = log.topics(options.scan_topics, "--scan-topic", SEVERAL, SCAN, ECHOES)
    if not scans:
        raise LogError(f"no laser: no topic of type {SCAN}; topics: {log.listed()}")
    asked = [options.odometry_topic] if options.odometry_topic else []
    if not options.use_odometry:
        asked = asked or [topic for topic, kind in log.kinds.items() if kind == ODOMETRY][:1]
    frames = [topic for topic, kind in log.kinds.items() if kind in FRAMES and topic.endswith(FRAME_TOPICS)]
    return {
        **dict.fromkeys(frames, log.tf),
        **dict.fromkeys(scans, log.scan),
        **dict.fromkeys(log.topics(asked, "--odometry-topic", "", ODOMETRY), log.odometry),
    }


def _ranges(message: Any) -> Array:
    """(B,) m of a scan; the first echo of each beam, where there are several."""
    beams = message.ranges
    if message.__msgtype__ == ECHOES:
        beams = [beam.echoes[0] if len(beam.echoes) else math.nan for beam in beams]
    return np.array(beams, np.float64)


def _name(frame: Any) -> str:
    return str(frame).strip("/")


def _step(message: Any) -> float:
    """rad between two beams; by the last one, for a driver that sets none, or one of the wrong sign."""
    step, span = float(message.angle_increment), float(message.angle_max - message.angle_min)
    steps = max(len(message.ranges) - 1, 1)
    return -step if abs(span + steps * step) < 2.0 * abs(step) else step or span / steps


def _stamp(header: Any, received: float) -> float:
    """s of the stamp of a message; when it was received, for a driver that sets none."""
    stamp = _seconds(header)
    return stamp if stamp > 0.0 else received


def _seconds(header: Any) -> float:
    return float(header.stamp.sec + 1e-9 * header.stamp.nanosec)


def _choose_frame(log: BagLog, frame: str | None) -> None:
    """Keep the sweeps of one frame, where it is named. Raises `LogError`."""
    if frame is None:
        return
    if _name(frame) not in log.lasers:
        there = ", ".join(log.lasers) or "none"
        raise LogError(f"--scan-frame: no scan in {frame!r:.80}{guess(frame, log.lasers)}; frames of scans: {there}")
    chosen, found = log.lasers.index(_name(frame)), log.recording.sweeps
    log.recording.sweeps = [sweep for sweep in found if sweep.laser == chosen]
    log.recording.counts["scans of another frame"] += len(found) - len(log.recording.sweeps)


def _find_odometry(log: BagLog) -> None:
    """Odometry from the frames, where no message has it; a note of where it was looked for."""
    recording = log.recording
    edge = log.frames.odometry(log.used.values())
    if 2 * log.tilted > len(recording.odometry.t):
        recording.notes.append(TILTED)
    if recording.odometry.moves:
        return
    if np.any(log.speeds.poses):
        recording.odometry = driven(log.speeds)
        recording.notes.append("odometry is made of the speeds in its messages, whose poses never change")
    elif edge and (log.frames.moving[edge].moves or not recording.odometry.t):
        recording.odometry, log.robot_frame = log.frames.moving[edge], edge[1]
        recording.notes.append(f"odometry is that of the frames {edge[0]} -> {edge[1]}")
    elif not recording.odometry.t:
        recording.notes.append(NO_ODOMETRY + f"topics: {log.listed()}; frames: {log.frames.listed()}")


def _mount(log: BagLog) -> None:
    """The mounting poses, where the bag has them. Raises `LogError` where one of several lasers has none."""
    recording, used, robot = log.recording, log.used, log.frames.robot(log.robot_frame)
    known = {laser: T for laser, frame in used.items() if (T := log.frames.mount(frame, robot)) is not None}
    _turn_over(recording, known)
    _miss_mounts(log, [frame for laser, frame in used.items() if laser not in known], robot or "base_link")
    mounts = [planar(known.get(laser, np.eye(4))) for laser in range(len(log.lasers))]
    if len(used) > 1:
        recording.mounts = mounts
    elif used:
        recording.T_robot_laser = mounts[next(iter(used))]
    recording.notes += _tilted(log, known) + _loose(log, robot)


def _turn_over(recording: Recording, mounts: dict[int, Transform]) -> None:
    """A laser that hangs upside down turns the other way."""
    for sweep in recording.sweeps:
        if sweep.laser in mounts and mounts[sweep.laser][2, 2] < 0.0:
            sweep.mirror()
            recording.counts["scans of a laser upside down, mirrored"] += 1


def _loose(log: BagLog, robot: str) -> list[str]:
    """Which frames of the lasers move on the robot."""
    names = {name for frame in log.used.values() for name in log.frames.moving_below(frame, robot)}
    return [f"warning: {name!r:.80} moves on the robot with the laser: its first pose counts" for name in sorted(names)]


def _miss_mounts(log: BagLog, lost: list[str], robot: str) -> None:
    """Note that the only laser has no mounting pose. Raises `LogError` where lasers of several have none."""
    if lost and len(log.used) > 1:
        raise LogError(
            f"scans of {len(log.lasers)} frames ({', '.join(log.lasers)}), and no mounting pose in {robot!r:.80} of "
            f"{', '.join(lost)}; --scan-frame names one; frames: {log.frames.listed()}"
        )
    centred = "the laser is taken as centred: no frame says the mounting pose of"
    for frame in lost:
        log.recording.notes.append(f"{centred} {frame!r:.80} in {robot!r:.80}; frames: {log.frames.listed()}")


def _tilted(log: BagLog, mounts: dict[int, Transform]) -> list[str]:
    """Which lasers look up or down."""
    level = {log.lasers[laser]: abs(float(T[2, 2])) for laser, T in mounts.items()}
    return [
        f"warning: the laser {frame!r:.80} is tilted by {math.degrees(math.acos(z)):.0f} deg: its scans count as level"
        for frame, z in level.items()
        if z < LEVEL
    ]
