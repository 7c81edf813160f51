"""The messages that the stages of the estimator pass on.

Lengths in metres, angles in radians counter-clockwise in (-pi, pi], float64. Frames are in the names: `p_robot` is a
point in the robot's frame, `p_map` one in the map frame (the robot's pose at reset), `T_map_robot` the pose (3,) x, y,
heading of the robot in the map. A scan is seen from the laser: between the stages "robot" is where the laser is, and
only `SlamOutput.belief` (output.py) has the pose of the robot's centre (filters/mounting.py). Messages are immutable,
their arrays included: a stage that decides differently returns a new one. Only `FeatureTable`, the memory of the map,
is written to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Bytes, Ints, Rows, carrier, row_type
from mecp_env.core.jit import compiled

UNKNOWN_ROOM = -1
HERE = -2  # the room of what is not seen through a door
NO_ID = -1
NO_IDS = np.empty(0, np.int64)


class ClusterKind(IntEnum):
    """What a cluster of hits consists of: straight walls, or something small (a leg, a thin post)."""

    LINES = 0
    SMALL = 1


class CornerKind(IntEnum):
    """The source of a corner (III-A.1): two lines cross, a line ends, or it is one of the two posts of a door."""

    CROSSING = 0
    FREE_END = 1
    JAMB = 2


class EdgeLabel(IntEnum):
    """What the scan shows along an interval of a polygon's edge: a wall, a gap of door width, or open space."""

    WALL = 0
    GAP = 1
    OPEN = 2


class Decision(IntEnum):
    """What association decided for a corner."""

    LANDMARK = 0
    PROVISIONAL = 1
    NEW = 2
    IGNORED = 3


LANDMARK = int(Decision.LANDMARK)


class Reason(IntEnum):
    """Why association decided so."""

    POLYGON = 0
    ROOM = 1
    JOINT = 2
    THROUGH_DOOR = 3
    TRACK = 4
    UNSEEN = 5
    AMBIGUOUS = 6
    REFUSED = 8
    IDENTITY = 9
    DYNAMIC = 10
    NOT_LOCALISED = 11
    RELOCALISED = 12


class Cell(IntEnum):
    """Label of a cell of the semantic grid."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2
    DOOR = 3


@carrier
class MergedScan:
    """One beam per nominal bearing of a sweep: the K interleaved beams around it, without outliers at edges."""

    ranges: Array  # (B,) m
    bearings: Array  # (B,) rad, ascending in (-pi, pi]
    hit: Bools  # (B,)
    count: Ints  # (B,) number of raw beams in the range: its variance is sigma^2 / count
    max_range_m: float
    raw_ranges: Array  # (K*B,) m, all raw beams in order of bearing
    raw_bearings: Array  # (K*B,) rad, ascending

    @property
    def step(self) -> float:
        """The spacing of the bearings, rad."""
        return (self.bearings.item(-1) - self.bearings.item(0)) / max(len(self.bearings) - 1, 1)

    @property
    def blind(self) -> bool:
        """True when the field of view has ends: the first beam does not follow the last."""
        return self.bearings.item(0) - self.bearings.item(-1) + 2.0 * math.pi > 2.0 * self.step


@carrier
class Clusters:
    """Runs of beams that may be on one structure. Positions count from `roll`, a gap, so that no run wraps."""

    roll: int  # beam index (of MergedScan) of position 0
    first: Ints  # (C,) first position of the run
    last: Ints  # (C,) last position of the run, included
    kind: Ints  # (C,) ClusterKind


@carrier
class Segments:
    """Straight pieces of wall, ccw around the robot (the bearing increases from start to end)."""

    points: Array  # (L,2,2) m, robot frame: start and end
    line: Array  # (L,2) alpha, rho of x cos(alpha) + y sin(alpha) = rho, rho >= 0: alpha points from robot to wall
    cov: Array  # (L,2,2) of (alpha, rho)
    cluster: Ints  # (L,)
    first: Ints  # (L,) first position (as in Clusters)
    last: Ints  # (L,) last position, included
    roll: int  # as in Clusters


@carrier
class Doorways:
    """Gaps of door width between two collinear jambs, as seen in one scan (III)."""

    jambs: Ints  # (g,2) corner indices: jambs[:,0] at the smaller bearing (seen from the robot, on the right)
    width: Array  # (g,) m
    confirmable: Bools  # (g,) seen near and steeply enough to count as a sighting


NO_DOORS = Doorways(np.empty((0, 2), np.int64), np.empty(0), np.empty(0, np.bool_))


@carrier
class Corners:
    """Point features of one scan (III-A.1), in order of bearing."""

    z: Array  # (n,2) m, rad: range and bearing
    cov: Array  # (2n,2n) joint covariance of z: corners that share a line are correlated
    kind: Ints  # (n,) CornerKind
    convex: Bools  # (n,) True: the solid fills less than 180 degrees (an outer corner); ends and jambs are convex
    normals: Array  # (n,2) rad, robot frame: normals (towards free space) of the faces before and after; nan: unseen
    beyond: Ints  # (n,) index into doorways of the gap behind which the corner lies, or -1
    sites: Bools  # (n,) may be a vertex of a polygon
    doorways: Doorways

    @property
    def R(self) -> Array:
        """(n,2,2) covariance of each corner's own range and bearing."""
        return point_blocks(self.cov)

    def with_linearisation(self, pose_cov: Array) -> Corners:
        """The same corners with what one linearisation at a predicted pose neglects, as an error of each position.

        `pose_cov` (3,3) is that of x, y, heading there. A position that is off by a along the ray and by b across it
        moves a corner at the range r by b^2 / (2 r) and a b / r more than the derivatives say, a heading that is off by
        t by r t^2 / 2. The root mean square of the largest part is s^2 / r for the variance s^2 of a and b, and about r
        times the variance of the heading; both grow with the sensor's own uncertainty, and are nothing for a pose that
        is known.
        """
        (x, _, _), (_, y, _), (_, _, heading) = pose_cov.tolist()
        cov = np.empty(self.cov.shape)
        inflate(self.cov, self.z, 0.5 * (x + y), heading, cov)
        marks = self.kind, self.convex, self.normals, self.beyond, self.sites
        return Corners(self.z, cov, *marks, self.doorways)

    def with_sites(self, sites: Bools) -> Corners:
        """The same corners with other `sites`."""
        marks = self.kind, self.convex, self.normals, self.beyond, sites
        return Corners(self.z, self.cov, *marks, self.doorways)

    def measurements(self, index: Ints) -> tuple[Array, Array]:
        """z (k,2) and its joint covariance (2k,2k) of the corners `index` (k,)."""
        k = len(index)
        z, R = np.empty((k, 2)), np.empty((2 * k, 2 * k))
        pick_measurements(self.z, self.cov, index, z, R)
        return z, R

    def __len__(self) -> int:
        return len(self.z)


def point_blocks(cov: Array) -> Array:
    """(n,2,2) the covariance of each point alone, from the joint one (2n,2n)."""
    n = len(cov) // 2
    blocks: Array = cov.reshape(n, 2, n, 2).diagonal(axis1=0, axis2=2).transpose(2, 0, 1)
    return blocks


@compiled
def pick_measurements(z: Array, cov: Array, index: Ints, some_z: Array, some_cov: Array) -> None:
    """Write the rows of z (n,2) and the 2x2 blocks of cov (2n,2n) that belong to `index` (k,): (k,2) and (2k,2k)."""
    for i in range(index.shape[0]):
        some_z[i, 0], some_z[i, 1] = z[index[i], 0], z[index[i], 1]
        for j in range(index.shape[0]):
            for u in range(2):
                some_cov[2 * i + u, 2 * j] = cov[2 * index[i] + u, 2 * index[j]]
                some_cov[2 * i + u, 2 * j + 1] = cov[2 * index[i] + u, 2 * index[j] + 1]


@compiled
def inflate(cov: Array, z: Array, place: float, turn: float, inflated: Array) -> None:
    """Write cov (2n,2n) of ranges and bearings z (n,2) with an independent error of each point added.

    Its sigma is place / r + turn r in m at a range r, with `place` in m^2 and `turn` in rad.
    """
    for i in range(cov.shape[0]):
        for j in range(cov.shape[0]):
            inflated[i, j] = cov[i, j]
    for i in range(z.shape[0]):
        sigma = place / z[i, 0] + turn * z[i, 0]
        inflated[2 * i, 2 * i] += sigma * sigma
        inflated[2 * i + 1, 2 * i + 1] += (sigma / z[i, 0]) ** 2


@carrier
class ScanFeatures:
    """What the front end finds in a scan (III-A.1)."""

    beams: MergedScan
    segments: Segments
    corners: Corners
    wall: Bools  # (B,) which beams end on a straight wall, and may cross a polygon

    def with_corners(self, corners: Corners) -> ScanFeatures:
        """The same with other `corners`."""
        return ScanFeatures(self.beams, self.segments, corners, self.wall)


@carrier
class Polygon:
    """A Maximum Empty Convex Polygon of one scan (III-A.2)."""

    corners: Ints  # (k,) indices into Corners, counter-clockwise, from the smallest
    intervals: Array  # (m,4) edge index, start and end as share of the edge's length, EdgeLabel; in order


@carrier
class MapPolygon:
    """A polygon of the map: links to features (III-B.1); centre and covariance are recomputed from the belief.

    A sighting makes a new one that shares `ids` with the old.
    """

    ids: Ints  # (k,) feature ids (landmarks, or tracks that may become landmarks), counter-clockwise
    intervals: Array  # (m,4) as in Polygon, from its last sighting
    room: int
    seen: int = 1
    last_step: int = 0


@carrier
class PolygonGroup:
    """The map polygons of one cardinality, for matching."""

    index: Ints  # (C,) index in the list of map polygons
    ids: Ints  # (C,k) vertex ids, ccw


class FeatureState(IntEnum):
    """State of a feature id: a track is not confirmed yet, a landmark is in the filter, dead ids stay dead."""

    TRACK = 0
    LANDMARK = 1
    DEAD = 2


FEATURE = row_type(  # what is remembered of a feature beside the filter's estimate
    [
        ("state", np.int64),  # FeatureState
        ("room", np.int64),  # before merges are resolved
        ("kind", np.int64),  # CornerKind
        ("seen", np.int64),  # number of sightings
        ("last_step", np.int64),  # of the last sighting
        ("doubts", np.int64),  # scans since then that showed that it is not there
        ("normals", np.float64, (2,)),  # rad, map frame, of the faces before and after; nan: unseen
        ("p_map", np.float64, (2,)),  # m, where it was last seen (tracks only)
        ("convex", np.int64),  # 1 or 0, as in Corners; 8 bytes wide, so that no byte of a row is padding
    ],
)


@dataclass(slots=True, eq=False)
class FeatureTable:
    """All features, one row per id; ids are never used twice."""

    rows: Rows = field(default_factory=lambda: np.empty(0, FEATURE))  # (F,) FEATURE

    def append(self, rows: Rows) -> Ints:
        """The ids (n,) of new features with these `rows` (n,) FEATURE."""
        count = len(self.rows)
        both = self.rows.view(np.uint8), rows.view(np.uint8)  # as records, it would take ten times as long
        self.rows = np.concatenate(both).view(FEATURE)
        return np.arange(count, len(self.rows))

    def __len__(self) -> int:
        return len(self.rows)


@carrier
class Match:
    """The decision for each corner of a scan, with its reason."""

    ids: Ints  # (n,) landmark id (LANDMARK), track id (PROVISIONAL), NO_ID
    decision: Ints  # (n,) Decision
    reason: Ints  # (n,) Reason
    nis: Array  # (n,) normalised innovation squared of the pairing, nan without one
    polygon: int  # index of the matched polygon of the scan, or -1
    known: int  # index of the MapPolygon matched (in the store at the time), or -1

    def __post_init__(self) -> None:
        """Make the columns read-only: a stage that decides differently returns a new match."""
        for column in (self.ids, self.decision, self.reason, self.nis):
            if isinstance(column, np.ndarray):  # `check_match` reports anything else
                column.setflags(write=False)

    def assign(self, corners: Any, ids: Any, decision: Any, reason: Any) -> Match:
        """A new match with these columns (c,), or one value, for some `corners` (c,)."""
        columns = self.ids.copy(), self.decision.copy(), self.reason.copy()
        for column, values in zip(columns, (ids, decision, reason), strict=True):
            column[corners] = values
        return Match(*columns, self.nis, self.polygon, self.known)

    def recognised(self) -> Ints:
        """The corners (c,) that are landmarks."""
        corners: Ints = (self.decision == LANDMARK).nonzero()[0]
        return corners

    @property
    def found(self) -> int:
        """How many corners are landmarks."""
        decisions: list[int] = self.decision.tolist()
        return decisions.count(LANDMARK)


@carrier
class Sighting:
    """A scan's corners with the features that they are, and the belief about where they were seen from."""

    corners: Corners
    match: Match
    through: Ints  # (n,) id of the mapped door each corner is seen through, or -1
    belief: Belief
    step: int

    def with_match(self, match: Match) -> Sighting:
        """The same with another `match`."""
        return Sighting(self.corners, match, self.through, self.belief, self.step)


@carrier
class Belief:
    """The estimate of the filter in world coordinates, whatever its internal state is."""

    T_map_robot: Array  # (3,) x, y, heading
    pose_cov: Array  # (3,3) of x, y, heading
    ids: Ints  # (N,) landmark ids, in the order of their initialisation
    p_map: Array  # (N,2) m, landmark means
    covs: Array  # (N,2,2) m^2, marginal covariance of each landmark

    def rows(self, wanted: Ints) -> Ints:
        """Row of each landmark id in `wanted` (any shape), all of which are in `ids`."""
        rows = np.empty(wanted.shape, np.int64)
        find_rows(self.ids, wanted.ravel(), rows.reshape(-1))
        return rows


@carrier
class Door:
    """A door of the map: one pair of jambs per wall face, the second face optional."""

    id: int
    jambs: tuple[int, int]  # landmark ids of the first face: right and left as seen from rooms[0]
    other_face: tuple[int, int] | None  # landmark ids of the second face, same order in space
    rooms: tuple[int, int]  # the room of the first face, the room beyond or UNKNOWN_ROOM
    sightings: int


@carrier
class Candidate:
    """A gap of door width that is not yet confirmed as a door."""

    ends: Array  # (2,2) m, map frame: right and left as seen from `room`
    ids: tuple[int, int]  # feature ids of its two jambs, NO_ID where not known
    room: int
    sightings: int
    last_step: int
    confirmable: int = 0  # sightings from near enough, of either face, whichever ids its jambs had


def resolved(room: int, merged: dict[int, int]) -> int:
    """The room that `room` stands for after all merges; `merged`: as in `RoomGraph`."""
    while room in merged:
        room = merged[room]
    return room


@carrier
class RoomGraph:
    """Rooms and the doors between them."""

    current: int  # the room the robot believes to be in
    in_doorway: bool  # the robot is in a door: what it sees may be in either room
    rooms: tuple[int, ...]  # ids of the rooms, merged ones left out
    doors: tuple[Door, ...]
    candidates: tuple[Candidate, ...]
    merged: dict[int, int]  # room that was merged -> room it became
    parted: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Room entered unnoticed -> the room it was taken for, and the first step in it."""

    def resolve(self, room: int) -> int:
        """The room that `room` stands for after all merges."""
        return resolved(room, self.merged)

    def rooms_behind(self, through: Ints) -> Ints:
        """(n,) the room, or UNKNOWN_ROOM, behind the door that each corner is seen `through` (n,); HERE without one."""
        return np.array(self._behind(through.tolist()), np.int64)

    def _behind(self, through: list[int]) -> list[int]:
        if max(through, default=-1) < 0:
            return [HERE] * len(through)
        behind = {door.id: door.rooms[door.rooms[0] == self.current] for door in self.doors if door.id in through}
        return [behind.get(door, HERE) for door in through]

    def rooms_of(self, beyond: Ints, through: Ints) -> Ints:
        """(n,) the room of each corner, UNKNOWN_ROOM `beyond` (n,) a gap that is no door, and seen from a doorway."""
        if self.in_doorway:
            return np.full(len(beyond), UNKNOWN_ROOM)
        here, behind = (self.current, UNKNOWN_ROOM), self._behind(through.tolist())
        rooms = [here[gap >= 0] if room == HERE else room for room, gap in zip(behind, beyond.tolist(), strict=True)]
        return np.array(rooms, np.int64)


@carrier
class MapView:
    """What an associator may use: the map before the corners of this scan are known."""

    step: int
    belief: Belief  # predicted to this step
    features: FeatureTable
    groups: dict[int, PolygonGroup]  # map polygons by cardinality
    graph: RoomGraph
    through: Ints  # (n,) for each corner of the scan: id of the mapped door it is seen through, or -1
    past: Ints | None = None  # (p,) corners of recent scans: they are vertices of polygons, and matched with them only

    def at(self, belief: Belief) -> MapView:
        """The same map as it is expected from another `belief`."""
        return MapView(self.step, belief, self.features, self.groups, self.graph, self.through, self.past)


@carrier
class SemanticGrid:
    """The occupancy grid with meaning, painted from the current estimates. Index [row, col] = [y, x]."""

    label: Bytes  # (H,W) Cell
    polygon: Bools  # (H,W) covered by a polygon (the paper's layer)
    room: NDArray[np.int16]  # (H,W) room id, -1 unknown
    origin: Array  # (2,) m, map frame: the lower left corner of cell [0, 0]
    resolution_m: float
    version: int  # grows whenever a cell changed


@compiled
def find_rows(ids: Ints, wanted: Ints, rows: Ints) -> bool:
    """Write the row in `ids` (N,), which differ, of each of `wanted` (m,), -1 where missing; True: none is missing."""
    complete, last = True, -1
    for k in range(wanted.shape[0]):
        rows[k] = row_of(ids, wanted[k], last + 1)
        complete, last = complete and rows[k] >= 0, rows[k]
    return complete


@compiled
def row_of(ids: Ints, wanted: int, first: int = 0) -> int:
    """The row of `wanted` in `ids` (N,), which differ, or -1; looked for from the row `first` on, then before it."""
    for i in range(first, ids.shape[0]):
        if ids[i] == wanted:
            return i
    for i in range(min(first, ids.shape[0])):
        if ids[i] == wanted:
            return i
    return -1


@compiled
def rows_by_id(ids: Ints, asked: Ints) -> Ints:
    """The row in `ids` (N,), which differ, of each id from 0 to the largest of `asked`, -1 where missing."""
    largest, wanted = 0, asked.reshape(-1)
    for i in range(wanted.shape[0]):
        largest = max(largest, wanted[i])
    rows = np.full(largest + 1, -1, np.int64)
    for i in range(ids.shape[0]):
        if 0 <= ids[i] <= largest:
            rows[ids[i]] = i
    return rows
