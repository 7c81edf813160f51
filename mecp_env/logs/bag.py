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
from mecp_env.logs.bag2_parts import unpacked_message
from mecp_env.logs.bag_chunks import check_chunks
from mecp_env.logs.carmen import MOST_BEAMS
from mecp_env.logs.clock import note_delay
from mecp_env.logs.frames import Frames, Transform, ZeroQuaternion, driven, planar, transform
from mecp_env.logs.readings import POSE_BYTES, Budget, Geometry, Recording, Sweep, Track

SCAN, ECHOES = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
NO_ODOMETRY = f"no odometry: no message of type {ODOMETRY} that can be read, and no frame that moves in odom; "
TILTED = (
    "warning: by most quaternions of the odometry the robot lies on its side: they are x, y, z, w, perhaps w is first "
    "here; --odometry none does without"
)
LIKE = {SCAN: (SCAN, ECHOES)}  # types that are read as another one
FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FRAME_TOPICS = ("/tf", "/tf_static")
REPAIR = "`rosbag reindex` (ROS 1), `ros2 bag reindex` or `mcap recover` may repair it"
SUFFIXES = (".bag", ".db3", ".mcap")
MOST_LASERS = 8
UPRIGHT = math.cos(math.radians(45.0))  # a robot that is tilted more falls over
LEVEL = math.cos(math.radians(5.0))  # a laser that is tilted more does not measure level
Choice = Sequence[str]
Taker = Callable[[Any, float], None]


@dataclass(slots=True, eq=False)
class BagLog:
    """What the messages so far have said."""

    recording: Recording
    frames: Frames
    robot_frame: str = ""
    speeds: Track = field(default_factory=Track)  # m/s, m/s, rad/s of the messages with odometry
    tilted: int = 0  # messages with odometry of a robot that is not upright
    lasers: list[str] = field(default_factory=list)  # their frames, in the order of `Sweep.laser`

    @property
    def used(self) -> list[str]:
        """The frames of the lasers whose sweeps are kept."""
        return [self.lasers[laser] for laser in sorted({sweep.laser for sweep in self.recording.sweeps})]

    def scan(self, message: Any, received: float) -> None:
        """A sweep. Raises `ValueError` for a damaged one."""
        ranges = _ranges(message)
        if not len(ranges):
            self.recording.counts["scans without ranges"] += 1
            return
        least, most = float(message.range_min), float(message.range_max)
        least = least if math.isfinite(least) else 0.0
        view = float(message.angle_min), _step(message)
        if not (len(ranges) <= MOST_BEAMS and all(map(math.isfinite, view))):
            raise ValueError
        geometry = Geometry(len(ranges), *view, least, most if most > least else math.inf)
        laser = self._laser(_name(message.header.frame_id))
        off = abs(view[0] + (len(ranges) - 1) * view[1] - message.angle_max) > 2.0 * abs(view[1])
        self.recording.counts["scans whose last beam is not at their angle_max"] += off
        self.recording.add(Sweep(self._stamp(message.header, received), ranges, geometry, order=received, laser=laser))

    def _stamp(self, header: Any, received: float) -> float:
        """The stamp of a message; when it was received, counted, for a driver that sets none."""
        self.recording.counts["messages without a stamp, as received"] += not _seconds(header) > 0.0
        return _stamp(header, received)

    def _laser(self, frame: str) -> int:
        """Which laser has this frame. Raises `LogError` for too many."""
        if frame not in self.lasers:
            if len(self.lasers) == MOST_LASERS:
                raise LogError(f"scans of more than {MOST_LASERS} frames: {', '.join(self.lasers)}")
            self.lasers.append(frame)
        return self.lasers.index(frame)

    def mounts(self, lasers: Sequence[int], robot: str) -> dict[int, Transform]:
        """The poses in the frame of the robot of those lasers that have one."""
        found = {laser: self.frames.mount(self.lasers[laser], robot) for laser in lasers}
        return {laser: T for laser, T in found.items() if T is not None}

    def odometry(self, message: Any, received: float) -> None:
        """A pose of the robot by its wheels."""
        T = transform(message.pose.pose.position, message.pose.pose.orientation)
        self.robot_frame = self.robot_frame or _name(message.child_frame_id)
        self.tilted += T[2, 2] < UPRIGHT
        self.recording.budget.take(2 * POSE_BYTES)
        stamp, twist = self._stamp(message.header, received), message.twist.twist
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
            self.frames.add(
                _name(one.header.frame_id), _name(one.child_frame_id), T, _stamp(one.header, received), received
            )

    def damaged(self, error: Exception, what: str) -> None:
        """Count what cannot be used, by its fault."""
        named = f"{what} with a quaternion of zeros" if isinstance(error, ZeroQuaternion) else f"damaged {what}"
        self.recording.counts[named] += 1


def is_bag(path: Path) -> bool:
    """True for the file of a bag, by its name, and for a folder of some."""
    return bool(_files(path))


def _files(path: Path) -> list[Path]:
    """What to read: a file, the folder of a ROS 2 bag, or all files of one that has no description."""
    if (path / "metadata.yaml").is_file():
        return [path]
    files = [file for file in sorted(path.iterdir()) if file.is_file()] if path.is_dir() else [path]
    return [file for file in files if file.suffix in SUFFIXES]


def read_bag(
    path: Path, scan_topics: Choice = (), odometry_topics: Choice = (), frame: str | None = None, several: bool = False
) -> Recording:
    """What is in a bag; `frame` names the laser to read. Raises `LogError`.

    Several topics of odometry are an error unless one is asked for, or any will do (`several`).
    """
    open_bag = _opener()
    recording = Recording(path.name, budget=Budget.of(_size(path)))
    for file in _files(path):
        check_chunks(file, recording.budget.most)
    log, kinds = BagLog(recording, Frames(recording.budget)), dict[str, str]()
    try:
        with open_bag(_files(path)) as bag:
            used = [connection for connection in bag.connections if connection.msgcount] or bag.connections
            kinds |= {connection.topic: connection.msgtype for connection in used}
            _read(bag, log, _takers(kinds, log, scan_topics, odometry_topics, several))
    except LogError:
        raise
    except Exception as error:  # damaged bytes may raise anything
        if not log.recording.sweeps:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise LogError(f"no bag, or damaged; {REPAIR} ({reason:.160})") from None
        log.recording.counts["bag cut short"] += 1
    _choose_frame(log, frame)
    _find_odometry(log, kinds)
    note_delay(log.recording)
    _mount(log)
    return log.recording


def _opener() -> Callable[[list[Path]], Any]:
    """What opens the files of a bag. Raises `LogError` without the library."""
    try:
        reader = importlib.import_module("rosbags.highlevel")
        stores = importlib.import_module("rosbags.typesys")
    except ImportError:
        raise LogError('to read bags takes the package rosbags: pip install "mecp_env[logs]"') from None
    return partial(reader.AnyReader, default_typestore=stores.get_typestore(stores.Stores.LATEST))


def _size(path: Path) -> int:
    """Bytes of a file, or of all files of a folder."""
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
    return sum(file.stat().st_size for file in files)


def _takers(
    kinds: dict[str, str], log: BagLog, scan_topics: Choice, odometry_topics: Choice, several: bool
) -> dict[str, Taker]:
    """What takes the messages of each topic that is read. Raises `LogError`."""
    scans = _topics(kinds, SCAN, scan_topics, "--scan-topic")
    if not scans:
        raise LogError(f"no laser: no topic of type {SCAN}; topics: {_listed(kinds)}")
    any_one = [topic for topic, kind in kinds.items() if kind == ODOMETRY][:1] if several else []
    odometry = _topics(kinds, ODOMETRY, odometry_topics or any_one, "--odometry-topic")
    takers: dict[str, Taker] = dict.fromkeys(
        (topic for topic, kind in kinds.items() if kind in FRAMES and topic.endswith(FRAME_TOPICS)), log.tf
    )
    return takers | dict.fromkeys(scans, log.scan) | dict.fromkeys(odometry, log.odometry)


def _read(bag: Any, log: BagLog, takers: dict[str, Taker]) -> None:
    """All messages of the chosen topics."""
    for connection, received, data in bag.messages([c for c in bag.connections if c.topic in takers]):
        try:
            message = bag.deserialize(unpacked_message(data), connection.msgtype)
            takers[connection.topic](message, 1e-9 * received)
        except LogError:
            raise
        except Exception as error:  # damaged bytes may raise anything
            log.damaged(error, "messages")


def _topics(kinds: dict[str, str], kind: str, asked: Choice, option: str) -> list[str]:
    """The topics of a type: as asked, or the only one; none without any. Raises `LogError`."""
    found = sorted(topic for topic, its in kinds.items() if its in LIKE.get(kind, (kind,)))
    for topic in asked:
        if topic not in found:
            raise LogError(f"{option}: no {kind} on {topic!r:.80}{guess(topic, found)}; topics: {_listed(kinds)}")
    if not asked and len(found) > 1:
        several = "; named more than once, it merges several" if kind == SCAN else ""
        raise LogError(f"{option}: {len(found)} topics of type {kind}, one must be named: {', '.join(found)}{several}")
    return list(dict.fromkeys(asked)) or found


def _listed(kinds: dict[str, str]) -> str:
    return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items()))[:600] or "none"


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
    chosen = log.lasers.index(_name(frame))
    log.recording.counts["scans of another frame"] += sum(s.laser != chosen for s in log.recording.sweeps)
    log.recording.sweeps = [sweep for sweep in log.recording.sweeps if sweep.laser == chosen]


def _find_odometry(log: BagLog, kinds: dict[str, str]) -> None:
    """Odometry from the frames, where no message has it; a note of where it was looked for."""
    recording = log.recording
    edge = log.frames.odometry(log.used)
    if 2 * log.tilted > len(recording.odometry.t):
        recording.notes.append(TILTED)
    if recording.odometry.moves:
        return
    if np.any(log.speeds.poses):
        recording.odometry = driven(log.speeds)
        recording.notes.append("odometry is made of the speeds in its messages, whose poses never change")
    elif edge is not None and (log.frames.moving[edge].moves or not recording.odometry.t):
        recording.odometry, log.robot_frame = log.frames.moving[edge], edge[1]
        recording.notes.append(f"odometry is that of the frames {edge[0]} -> {edge[1]}")
    elif not recording.odometry.t:
        recording.notes.append(NO_ODOMETRY + f"topics: {_listed(kinds)}; frames: {log.frames.listed()}")


def _mount(log: BagLog) -> None:
    """The mounting poses, where the bag has them. Raises `LogError` where one of several lasers has none."""
    recording, robot = log.recording, log.frames.robot(log.robot_frame)
    used = sorted({sweep.laser for sweep in recording.sweeps})
    known = log.mounts(used, robot)
    _turn_over(recording, {laser for laser, T in known.items() if T[2, 2] < 0.0})
    if len(used) > 1:
        _check_mounts(log, [log.lasers[laser] for laser in used if laser not in known], robot)
        recording.mounts = [planar(known.get(laser, np.eye(4))) for laser in range(len(log.lasers))]
    elif known:
        recording.T_robot_laser = planar(known[used[0]])
    elif used:
        recording.T_robot_laser = np.zeros(3)
        recording.notes.append(_centred(log, log.lasers[used[0]], robot))
    recording.notes += _tilted(log, known) + _loose(log, used, robot)


def _loose(log: BagLog, used: list[int], robot: str) -> list[str]:
    """Which frames of the lasers move on the robot."""
    names = {name for laser in used for name in log.frames.moving_below(log.lasers[laser], robot)}
    return [f"warning: {name!r:.80} moves on the robot with the laser: its first pose counts" for name in sorted(names)]


def _centred(log: BagLog, laser: str, robot: str) -> str:
    """That the only laser has no mounting pose."""
    there = f"{laser!r:.80} in {robot or 'base_link'!r:.80}; frames: {log.frames.listed()}"
    return f"the laser is taken as centred: no frame says the mounting pose of {there}"


def _tilted(log: BagLog, mounts: dict[int, Transform]) -> list[str]:
    """Which lasers look up or down."""
    level = {log.lasers[laser]: abs(float(T[2, 2])) for laser, T in mounts.items()}
    return [
        f"warning: the laser {frame!r:.80} is tilted by {math.degrees(math.acos(z)):.0f} deg: its scans count as level"
        for frame, z in level.items()
        if z < LEVEL
    ]


def _turn_over(recording: Recording, upside_down: set[int]) -> None:
    """A laser that hangs upside down turns the other way."""
    recording.counts["scans of a laser upside down, mirrored"] += sum(s.laser in upside_down for s in recording.sweeps)
    recording.sweeps = [s.mirrored() if s.laser in upside_down else s for s in recording.sweeps]


def _check_mounts(log: BagLog, lost: list[str], robot: str) -> None:
    """Raise `LogError` where lasers have no mounting pose."""
    if lost:
        there = f"frames: {log.frames.listed()}"
        raise LogError(
            f"scans of {len(log.lasers)} frames ({', '.join(log.lasers)}), and no mounting pose in "
            f"{robot or 'base_link'!r:.80} of {', '.join(lost)}; --scan-frame names one; {there}"
        )
