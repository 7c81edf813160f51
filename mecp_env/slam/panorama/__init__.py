"""A window of recent scans, each with a clone of its pose in the filter: what a laser with a blind side has seen.

They serve twice. Corners and walls on the blind side complete those of a scan, so that polygons surround the robot and
are matched as a whole; they update nothing. And a scan is registered with the surfaces of the window, which tells how
far the robot has moved since: in a corridor that shows few corners, and with poor odometry.

A past pose of the laser in the state of a filter: two points fixed to it, ahead of it and behind it.

To the filter, the points are landmarks that no corner is ever matched to. Their ids are below `NO_ID`, and a belief
leaves them out. By its two marks, a past pose has the exact covariance of the filter with the present pose and the map
(a stochastic clone), and a scan registered with a past one is an observation of two points.

Poses are T_past_now (3,): x, y, heading of the present pose in the frame of the past one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import block_of, sandwich
from mecp_env.core.se2 import compose, inverse, polar_to_points, wrap_angle
from mecp_env.slam.config import PanoramaConfig, SensorModel, SlamConfig
from mecp_env.slam.messages import (
    UNKNOWN_ROOM,
    Corners,
    FeatureState,
    FeatureTable,
    Match,
    MergedScan,
    Reason,
    RoomGraph,
    ScanFeatures,
)
from mecp_env.slam.panorama.registration import (
    Registration,
    RegistrationLimits,
    Surfaces,
    joined_surfaces,
    likelier,
    register,
    surfaces_of,
)
from mecp_env.slam.panorama.surroundings import Surroundings, are_new, moved_corners, surround
from mecp_env.slam.protocols import Filter

Update = Callable[[Filter, Array, Array, Ints], None]
LEVER_M = 10.0  # of a mark from its pose: a range and a bearing are nearly linear at this distance
RIGID_SIGMA_M = 1e-4 * LEVER_M  # of the marks in the frame of their pose: measurements of them stay invertible


@compiled
def seen_from(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """T_now_past (3,) and its covariance (3,3), from T_past_now (3,) and that of it."""
    T_now_past, J = inverse(T_past_now), np.zeros((3, 3))
    c, s = math.cos(T_now_past[2]), math.sin(T_now_past[2])
    J[0, 0], J[0, 1], J[0, 2] = -c, s, T_now_past[1]
    J[1, 0], J[1, 1], J[1, 2] = -s, -c, -T_now_past[0]
    J[2, 2] = -1.0
    return T_now_past, sandwich(J, cov)


@compiled
def marks_seen(T_past_now: Array, cov: Array) -> tuple[Array, Array]:
    """z (2,2) and R (4,4) of the two marks of a past pose, seen from a pose T_past_now with a covariance (3,3)."""
    T_now_past, spread = seen_from(T_past_now, cov)
    z, J = np.empty((2, 2)), np.empty((4, 3))
    for k in range(2):
        lever = LEVER_M - 2.0 * LEVER_M * k  # ahead, then behind
        dx, dy = lever * math.cos(T_now_past[2]), lever * math.sin(T_now_past[2])
        x, y = T_now_past[0] + dx, T_now_past[1] + dy
        r = math.hypot(x, y)
        z[k, 0], z[k, 1] = r, math.atan2(y, x)
        for row, (u, v) in enumerate(((x / r, y / r), (-y / r**2, x / r**2))):
            J[2 * k + row, 0], J[2 * k + row, 1], J[2 * k + row, 2] = u, v, v * dx - u * dy
    R = sandwich(J, spread)
    for k in range(2):
        R[2 * k, 2 * k] += RIGID_SIGMA_M**2
        R[2 * k + 1, 2 * k + 1] += (RIGID_SIGMA_M / LEVER_M) ** 2
    return z, R


@compiled
def poses_of_marks(mean: Array, cov: Array) -> tuple[Array, Array]:
    """T_past_now (w,3) and covariances (w,3,3), from mean (3+4w,) and covariance of the pose and of two marks each."""
    count = (mean.shape[0] - 3) // 4
    poses, covs, J = np.empty((count, 3)), np.empty((count, 3, 3)), np.zeros((3, 7))
    rows = np.arange(7)
    for k in range(count):
        at = 3 + 4 * k
        axis_x, axis_y = mean[at] - mean[at + 2], mean[at + 1] - mean[at + 3]
        heading, square = math.atan2(axis_y, axis_x), axis_x * axis_x + axis_y * axis_y
        c, s = math.cos(heading), math.sin(heading)
        dx, dy = mean[0] - 0.5 * (mean[at] + mean[at + 2]), mean[1] - 0.5 * (mean[at + 1] + mean[at + 3])
        x, y = c * dx + s * dy, c * dy - s * dx
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, wrap_angle(mean[2] - heading)
        J[0, 0], J[0, 1], J[1, 0], J[1, 1], J[2, 2] = c, s, -s, c, 1.0
        for mark in range(2):  # the first is ahead of the past pose: its heading, and half of its place
            side = 1.0 - 2.0 * mark
            for i, by_heading in enumerate((y, -x, -1.0)):
                J[i, 3 + 2 * mark] = -side * axis_y / square * by_heading
                J[i, 4 + 2 * mark] = side * axis_x / square * by_heading
            for i in range(2):
                for j in range(2):
                    J[i, 3 + 2 * mark + j] -= 0.5 * J[i, j]
        for i in range(4):
            rows[3 + i] = at + i
        covs[k] = sandwich(J, block_of(cov, rows, rows))
    return poses, covs


FIRST_MARK = -2  # NO_ID is -1


@dataclass(frozen=True, slots=True, eq=False)
class RecentScan:
    """A scan of the window."""

    marks: Ints  # (2,) ids of the marks of its pose
    beams: MergedScan
    surfaces: Surfaces
    corners: Corners
    ids: Ints  # (n,) features that its corners are, or NO_ID
    still: Bools  # (n,) which of them are on no dynamic object
    room: int  # before merges are resolved; UNKNOWN_ROOM in a doorway
    doubtful: int  # scans up to this one, since the last at a sure pose from which the track is unbroken; 0: this one


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """The motion since a scan of the window, as the surfaces tell."""

    mark: int  # the first mark of that scan's pose
    T_past_now: Array  # (3,) m, rad
    cov: Array  # (3,3)


@dataclass(slots=True, eq=False, init=False)
class RecentScans:
    """The window, the newest scan last."""

    config: PanoramaConfig
    least_corners: int  # that tell where the robot is
    sensor: SensorModel
    limits: RegistrationLimits
    scans: list[RecentScan] = field(default_factory=list)
    next_mark: int = FIRST_MARK
    registered: Registered | None = None  # that of the last scan
    lost: bool = False  # the pose is searched for: every scan is registered, since odometry alone would drift
    linked: bool = False  # nothing says that the last scan was taken elsewhere
    vouched: bool = False  # it was registered, and a scan of the window that its track goes back to had a sure pose

    def __init__(self, config: SlamConfig) -> None:
        self.config, self.sensor = config.panorama, config.sensor
        self.least_corners = config.localisation.least_corners
        self.limits = RegistrationLimits.of(config)
        self.scans, self.next_mark, self.registered = [], FIRST_MARK, None
        self.lost = self.linked = self.vouched = False

    def are_used(self, scan: ScanFeatures) -> bool:
        """True for a scan that the window completes, or whose corners do not tell where the robot is."""
        use, few = self.config.use, self.lost or len(scan.corners) < self.least_corners
        return use == "always" or (use != "never" and scan.beams.blind) or (use == "needed" and few)

    def register(
        self, scan: ScanFeatures, landmark_filter: Filter, update: Update, slack: Array, lost: bool = False
    ) -> bool:
        """Update the filter with the motion since the newest scan of the window; True when the surfaces agree.

        By `update(filter, z, R, ids)`. `slack` (3,3): what failed odometry adds to the covariance of the motion.
        `lost`: the pose is searched for.
        """
        self.lost, self.registered, self.linked, self.vouched = lost, None, False, False
        if not (self.scans and self.are_used(scan)):
            return False
        last, found = self.scans[-1], self._registration(scan, landmark_filter, slack)
        if found is None:
            return False
        self.linked, cov = True, found.cov(self.limits) + self.floor
        update(landmark_filter, *marks_seen(found.T_past_now, cov), last.marks)
        self.registered = Registered(int(last.marks[0]), found.T_past_now, cov)
        self.vouched = last.doubtful < self.config.scans
        return True

    def _registration(self, scan: ScanFeatures, landmark_filter: Filter, slack: Array) -> Registration | None:
        """The motion since the newest scan of the window, None where the surfaces do not agree; and `linked`."""
        since, spread = self._poses(self.scans, landmark_filter)
        poses = [compose(since[-1], inverse(pose)) for pose in since]  # in the frame of the newest
        window = joined_surfaces([past.surfaces.seen_from(T) for past, T in zip(self.scans, poses, strict=True)])
        seen, beams, prior = self._surfaces(scan), self.scans[-1].beams, (since[-1], spread[-1] + self.floor)
        found = register(window, seen, beams, prior, self.limits)
        self.linked = found is not None and found.is_possible(prior, self.limits)
        if found is not None and found.is_clear(prior, self.limits):
            return found
        failed = prior[0], prior[1] + slack
        return likelier(found, register(window, seen, beams, failed, self.limits), prior, failed, self.limits)

    def around(
        self, scan: ScanFeatures, graph: RoomGraph, features: FeatureTable, landmark_filter: Filter
    ) -> Surroundings:
        """A scan with what the window shows on its blind side of the room that the robot is in."""
        if not (self.scans and scan.beams.blind and self.are_used(scan)):
            return Surroundings.of(scan)
        newest_first, sight = self.scans[::-1], (scan.beams.bearings[0], scan.beams.bearings[-1])
        known, here = (features.rows["room"], features.rows["state"]), rooms_like(graph)
        past, walls, taken = [], [], polar_to_points(scan.corners.z)
        for recent, T_past_now, cov in zip(newest_first, *self._poses(newest_first, landmark_filter), strict=True):
            T_now_past, cov = seen_from(T_past_now, cov)
            kept = is_in_room((recent.ids, recent.corners.beyond, recent.still), recent.room, known, here)
            kept[kept], places = are_new(recent.corners.z[kept], T_now_past, sight, taken, self.limits.inside_m)
            taken = np.concatenate((taken, places))
            past.append((moved_corners(recent.corners, kept, T_now_past, cov), recent.ids[kept]))
            walls.append(recent.surfaces.seen_from(T_now_past))
        return surround(scan, past, walls, self.limits.inside_m)

    def remember(self, scan: ScanFeatures, match: Match, graph: RoomGraph, landmark_filter: Filter, sure: bool) -> None:
        """Take a scan into the window, if the robot has moved since the newest one; the oldest leaves it.

        One for which no window is used empties it. `sure`: nothing speaks against the pose that it was taken at.
        """
        if self.are_used(scan):
            if self._moved(landmark_filter):
                self._append(scan, match, graph, landmark_filter, sure)
        elif self.scans:
            self.forget(landmark_filter)

    def _append(self, scan: ScanFeatures, match: Match, graph: RoomGraph, landmark_filter: Filter, sure: bool) -> None:
        marks = np.array([self.next_mark, self.next_mark - 1])
        self.next_mark -= len(marks)
        landmark_filter.augment(*marks_seen(np.zeros(3), self.floor), marks)
        if not landmark_filter.has(int(marks[1])):  # the filter is full
            landmark_filter.remove(marks[:1] if landmark_filter.has(int(marks[0])) else marks[:0])
            return
        room, still = UNKNOWN_ROOM if graph.in_doorway else graph.current, match.reason != Reason.DYNAMIC
        seen = scan.beams, self._surfaces(scan), scan.corners
        self.scans.append(RecentScan(marks, *seen, match.ids, still, room, 0 if sure else self._doubtful()))
        if len(self.scans) > self.config.scans:
            landmark_filter.remove(self.scans.pop(0).marks)

    def forget(self, landmark_filter: Filter) -> None:
        """Empty the window: the robot was put elsewhere."""
        for scan in self.scans:
            landmark_filter.remove(scan.marks)
        self.scans.clear()

    @property
    def floor(self) -> Array:
        """(3,3) covariance of a registration by any number of beams: what noise has in common in a scan."""
        metres = max(self.sensor.range_sigma_m, self.sensor.least_range_sigma_m) / self.limits.alike_beams
        turn = max(self.sensor.bearing_sigma_rad / self.limits.alike_beams, self.sensor.least_range_sigma_m)
        floor: Array = np.diag([metres**2, metres**2, turn**2])
        return floor

    def _doubtful(self) -> int:
        """Of a scan at a doubtful pose: one more than the newest has, if nothing broke the track from there."""
        return self.scans[-1].doubtful + 1 if self.scans and self.linked else self.config.scans

    def _poses(self, scans: list[RecentScan], landmark_filter: Filter) -> tuple[Array, Array]:
        marks = np.concatenate([scan.marks for scan in scans])
        poses, covs = poses_of_marks(*landmark_filter.marginal(marks))
        return poses, covs

    def _surfaces(self, scan: ScanFeatures) -> Surfaces:
        return surfaces_of(scan.beams, scan.segments, scan.wall, self.sensor)

    def _moved(self, landmark_filter: Filter) -> bool:
        if not self.scans:
            return True
        x, y, turn = self._poses(self.scans[-1:], landmark_filter)[0][0]
        return math.hypot(x, y) > self.config.spacing_m or abs(turn) > self.config.spacing_rad


def rooms_like(graph: RoomGraph) -> Ints:
    """(r,) the room that the robot is in, with all that were merged into it."""
    merged = [room for room in graph.merged if graph.resolve(room) == graph.current]
    return np.array([graph.current, *merged], np.int64)


@compiled
def is_in_room(corners: tuple[Ints, Ints, Bools], room: int, features: tuple[Ints, Ints], here: Ints) -> Bools:
    """(n,) which corners of a scan taken in a `room` are of one of the rooms `here` (r,), on nothing that moves.

    Of the `corners`: the features that they are, the gap beyond which they lie, and whether they are still. Of the
    `features` (F,): room and state. One that is known is where its feature is.
    """
    (ids, beyond, still), (rooms, states) = corners, features
    kept = np.zeros(ids.shape[0], np.bool_)
    for i in range(ids.shape[0]):
        if not still[i] or (ids[i] >= 0 and states[ids[i]] == FeatureState.DEAD):
            continue
        own = rooms[ids[i]] if ids[i] >= 0 else (room if beyond[i] < 0 else UNKNOWN_ROOM)
        for k in range(here.shape[0]):
            kept[i] |= own == here[k]
    return kept
