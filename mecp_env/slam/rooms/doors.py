"""Doors: a gap of door width between two collinear jambs, one pair of jambs per wall face (III).

What the stages of rooms and doors ask of a configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.slam.messages import (
    UNKNOWN_ROOM,
    Belief,
    Candidate,
    CornerKind,
    Door,
    FeatureState,
    FeatureTable,
    Reason,
    Sighting,
    rows_by_id,
)


@dataclass(frozen=True, slots=True)
class RoomLimits:
    """The limits of rooms and doors."""

    confirm_sightings: int  # of a door, as many as make a landmark
    wall_thickness_m: float  # of the thickest wall: two gaps whose middles are nearer are one, the faces of a door
    doorway_m: float  # the robot is in a doorway up to here; also between the places of its path that are kept
    recognise_m: float  # two polygons recognised this far apart merge rooms
    recognise_corners: int
    trail_places: int

    @property
    def recognise_by_corners_m(self) -> float:
        """The same as `recognise_m` for single corners, a weaker sign: three times as far apart."""
        return 3.0 * self.recognise_m

    @property
    def behind_wall_m(self) -> float:
        """A corner this far behind the middle of a door's wall is beyond the door."""
        return self.wall_thickness_m / 2.0


DYNAMIC = int(Reason.DYNAMIC)


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A door between two known rooms, one of whose jambs is no landmark any more: a gap seen there joins them again."""

    frame: Array  # (5,) as `DoorMap.frames`, where it was last
    rooms: tuple[int, int]  # in front of it, behind it


@dataclass(slots=True, eq=False)
class DoorMap:
    """Doors, candidates, and how often each pair of jambs was seen."""

    doors: list[Door] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    sightings: dict[tuple[int, int], int] = field(default_factory=dict)
    next_id: int = 0
    ids: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (D,) of `doors`
    jambs: Ints = field(default_factory=lambda: np.empty((0, 4), np.int64))  # (D,4) as `door_jambs`
    row: dict[tuple[int, int], int] = field(default_factory=dict)  # face -> index in `doors`
    inside: list[tuple[float, float]] = field(default_factory=list)  # m, map frame: gaps that lie inside one room
    passages: list[Passage] = field(default_factory=list)  # the last one at a place is the newest

    def set_doors(self, doors: list[Door]) -> None:
        """Replace the doors; what is derived from them follows."""
        self.doors = doors
        self.ids = np.array([door.id for door in doors], np.int64)
        self.jambs = door_jambs(doors)
        faces = [(face, d) for d, door in enumerate(doors) for face in (door.jambs, door.other_face) if face]
        self.row = {pair: d for face, d in faces for pair in (face, face[::-1])}

    def add(self, door: Door) -> None:
        """One more door, whose id is `next_id`."""
        self.set_doors([*self.doors, door])
        self.next_id += 1

    def change(self, d: int, door: Door) -> None:
        """Put a door in the place of the one in row `d`."""
        self.set_doors([*self.doors[:d], door, *self.doors[d + 1 :]])

    def frames(self, belief: Belief) -> Array:
        """(D,5) middle x, y, unit normal x, y towards the first room, half width of each door, from the belief.

        The middle is that of the wall where both faces are known, of the one face otherwise.
        """
        return door_frames(belief.p_map, belief.ids, self.jambs)


def door_jambs(doors: list[Door]) -> Ints:
    """(D,4) landmark ids: right and left jamb of the first face, then of the second or of the first again."""
    rows = [(*door.jambs, *(door.other_face or door.jambs)) for door in doors]
    return np.array(rows, np.int64).reshape(-1, 4)


@compiled
def seen_through(
    T_map_robot: Array,
    z: Array,
    p_map: Array,
    ids: Ints,
    jambs: Ints,
    door_ids: Ints,
    behind_m: float,
    sites: Bools,
) -> Ints:
    """(n,) id of the door through which each corner z (n,2) is seen, or -1; such corners are no `sites` (n,) any more.

    `p_map` (N,2) and `ids` (N,) are the landmarks, `jambs` (D,4) is as in `door_jambs`.
    """
    points, through = to_map(T_map_robot, polar_to_points(z)), np.empty(z.shape[0], np.int64)
    beyond_doors(T_map_robot, points, door_frames(p_map, ids, jambs), behind_m, through)
    for i in range(z.shape[0]):
        if through[i] >= 0:
            sites[i], through[i] = False, door_ids[through[i]]
    return through


@compiled
def beyond_doors(p_robot: Array, p_map: Array, doors: Array, margin: float, row: Ints) -> None:
    """Write the row (n,) of the door through which each point of `p_map` (n,2) is seen from `p_robot` (2,), or -1.

    `doors` (D,5): middle x, y, unit normal x, y, half width. A point counts when the line of sight crosses the gap, or
    the wall less than `margin` beside it (nothing is seen through a wall: the pose is that uncertain), and ends more
    than `margin` behind the middle of the wall.
    """
    aside = np.full(p_map.shape[0], margin)
    for i in range(p_map.shape[0]):
        row[i] = -1
    for d in range(doors.shape[0]):
        mx, my, nx, ny, half = doors[d]
        s0 = (p_robot[0] - mx) * nx + (p_robot[1] - my) * ny
        side = 1.0 if s0 >= 0.0 else -1.0
        t0 = (p_robot[0] - mx) * ny - (p_robot[1] - my) * nx
        for i in range(p_map.shape[0]):
            s1 = (p_map[i, 0] - mx) * nx + (p_map[i, 1] - my) * ny
            if s1 * side >= -margin:
                continue
            t1 = (p_map[i, 0] - mx) * ny - (p_map[i, 1] - my) * nx
            t = t0 + (t1 - t0) * s0 / (s0 - s1)
            if abs(t) < half + aside[i]:
                row[i], aside[i] = d, max(abs(t) - half, 0.0)


@compiled
def door_frames(p_map: Array, ids: Ints, jambs: Ints) -> Array:
    """(D,5) as `DoorMap.frames` of the doors with `jambs` (D,4), from the landmarks `p_map` (N,2) with `ids` (N,)."""
    frames = np.empty((jambs.shape[0], 5))
    row = rows_by_id(ids, jambs)
    for d in range(jambs.shape[0]):
        right, left, right_too, left_too = row[jambs[d, 0]], row[jambs[d, 1]], row[jambs[d, 2]], row[jambs[d, 3]]
        rx, ry = (p_map[right, 0] + p_map[right_too, 0]) / 2.0, (p_map[right, 1] + p_map[right_too, 1]) / 2.0
        lx, ly = (p_map[left, 0] + p_map[left_too, 0]) / 2.0, (p_map[left, 1] + p_map[left_too, 1]) / 2.0
        x, y = lx - rx, ly - ry
        width = math.hypot(x, y)
        frames[d, 0], frames[d, 1] = (rx + lx) / 2.0, (ry + ly) / 2.0
        frames[d, 2], frames[d, 3], frames[d, 4] = -y / width, x / width, width / 2.0
    return frames


def record_doorways(door_map: DoorMap, seen: Sighting, features: FeatureTable, room: int, config: RoomLimits) -> None:
    """Count this scan's doorways of this room; confirm doors, keep the rest as candidates; in place."""
    doorways, id_of = seen.corners.doorways, seen.match.ids.tolist()
    for pair, confirmable in zip(doorways.jambs.tolist(), doorways.confirmable.tolist(), strict=True):
        ids = (id_of[pair[0]], id_of[pair[1]])
        if _is_elsewhere(seen, pair[0]) or _is_elsewhere(seen, pair[1]):
            continue
        if ids in door_map.row and not door_map.inside:
            _see_again(door_map, ids, confirmable, room, config)
            continue
        ends = to_map(seen.belief.T_map_robot, polar_to_points(seen.corners.z[pair]))
        if not is_at(ends, door_map.inside, config):
            gap = Candidate(ends, ids, room, 1, seen.step, int(confirmable))
            _record_gap(door_map, gap, features, seen.belief, config)


def _is_elsewhere(seen: Sighting, corner: int) -> bool:
    """True for a corner that is not of this room, or on something that moves."""
    outside = seen.through[corner] >= 0 or seen.corners.beyond[corner] >= 0
    return bool(outside or seen.match.reason[corner] == DYNAMIC)


def _record_gap(door_map: DoorMap, gap: Candidate, features: FeatureTable, belief: Belief, config: RoomLimits) -> None:
    """Count one sighting of a gap; `gap.confirmable`: 1 if it was seen well."""
    if gap.ids in door_map.row:
        _see_again(door_map, gap.ids, gap.confirmable > 0, gap.room, config)
        return
    if min(gap.ids) >= 0 and gap.confirmable:
        before = door_map.sightings.get(gap.ids, 0), _seen_well(door_map, gap.ends, config)
        door_map.sightings[gap.ids] = max(before) + 1
        _confirm(door_map, gap.ids, features, belief, gap.room, config)
    _note_candidate(door_map, replace(gap, confirmable=door_map.sightings.get(gap.ids, 0)), belief, config)


def rooms_next_door(door_map: DoorMap, room: int, sightings: int) -> set[int]:
    """The rooms behind the doors of `room` that were seen at least `sightings` times."""
    sure = (door for door in door_map.doors if door.sightings >= sightings)
    return {other for door in sure if room in door.rooms for other in door.rooms} - {room}


def _see_again(door_map: DoorMap, ids: tuple[int, int], confirmable: bool, room: int, config: RoomLimits) -> None:
    """Count one more sighting of a known door from a room, if it is seen well, up to a limit.

    A face seen from within this room is one of its walls: if it was assigned to a room next door, it was first seen
    through an unknown door.
    """
    d = door_map.row[ids]
    door = door_map.doors[d]
    rooms, side = list(door.rooms), 0 if ids == door.jambs else 1
    if not confirmable:
        return
    if room not in rooms and rooms[side] in rooms_next_door(door_map, room, config.confirm_sightings):
        rooms[side] = room
    door_map.doors[d] = Door(door.id, door.jambs, door.other_face, (rooms[0], rooms[1]), door.sightings + 1)


def _confirm(
    door_map: DoorMap, ids: tuple[int, int], features: FeatureTable, belief: Belief, room: int, config: RoomLimits
) -> None:
    """Turn a pair of jambs seen often enough into a door, or into the second face of one."""
    if door_map.sightings[ids] < config.confirm_sightings or not are_landmarks(ids, features):
        return
    _mark_jambs(ids, features)
    new = Door(door_map.next_id, ids, None, (room, UNKNOWN_ROOM), door_map.sightings[ids])
    frame = gap_frame(belief.p_map[belief.rows(np.array(ids))])
    before, behind = rooms_beside(door_map, frame, config)
    new = replace(new, rooms=(room, behind if before == room else UNKNOWN_ROOM))
    for d, other in enumerate(door_map.frames(belief)):
        joined = _joined(door_map.doors[d], other, new, frame, room, config)
        if joined is not None:
            door_map.change(d, joined)
            return
    door_map.add(new)


def _mark_jambs(ids: tuple[int, int], features: FeatureTable) -> None:
    """The posts of a door belong to both its rooms; a concave corner in place of one is a corner of its room."""
    features.rows["kind"][[i for i in ids if features.rows["convex"][i]]] = int(CornerKind.JAMB)


def are_landmarks(ids: tuple[int, int], features: FeatureTable) -> bool:
    """True when both jambs are landmarks, so that the gap can become a door."""
    return all(i >= 0 and features.rows["state"][i] == int(FeatureState.LANDMARK) for i in ids)


def _joined(door: Door, frame: Array, new: Door, new_frame: Array, room: int, config: RoomLimits) -> Door | None:
    """The known door with this sighting added, when the new pair of jambs is one of its faces; None otherwise."""
    alike = same_place(frame, new_frame, config)
    if not alike:
        return None
    if alike > 0.0 or door.other_face is not None:
        return replace(door, sightings=door.sightings + 1)
    beyond = room if door.rooms[1] == UNKNOWN_ROOM and room != door.rooms[0] else door.rooms[1]
    faces = (new.jambs[1], new.jambs[0])
    return replace(door, other_face=faces, rooms=(door.rooms[0], beyond), sightings=door.sightings + new.sightings)


def same_place(frame: Array, other: Array, config: RoomLimits) -> float:
    """Cosine between the normals of two frames (5,), below 0 for the two faces of a wall; 0 for gaps elsewhere."""
    offset = other[:2] - frame[:2]
    alike = float(frame[2] * other[2] + frame[3] * other[3])
    apart = abs(offset[0] * frame[2] + offset[1] * frame[3])
    sideways = abs(offset[0] * frame[3] - offset[1] * frame[2])
    elsewhere = abs(alike) < 0.9 or sideways > config.wall_thickness_m or apart > config.wall_thickness_m
    return 0.0 if elsewhere else alike


def _seen_well(door_map: DoorMap, ends: Array, config: RoomLimits) -> int:
    """How often the gap with the ends (2,2) was seen well: by the face behind it, or by a jamb since forgotten, too."""
    return max((c.confirmable for c in door_map.candidates if same_gap(c.ends, ends, config)), default=0)


def _note_candidate(door_map: DoorMap, new: Candidate, belief: Belief, config: RoomLimits) -> None:
    """Remember a gap until it is a door; one gap is one candidate."""
    same = [i for i, known in enumerate(door_map.candidates) if same_gap(known.ends, new.ends, config)]
    if is_at(new.ends, door_map.frames(belief)[:, :2].tolist(), config):
        door_map.candidates = [c for i, c in enumerate(door_map.candidates) if i not in same]
    elif same:
        known = door_map.candidates[same[0]]
        ids = new.ids if min(new.ids) >= 0 else known.ids
        sightings, well = known.sightings + 1, max(known.confirmable, new.confirmable)
        door_map.candidates[same[0]] = Candidate(new.ends, ids, known.room, sightings, new.last_step, well)
    else:
        door_map.candidates.append(new)


def is_at(ends: Array, middles: Sequence[Sequence[float]], config: RoomLimits) -> bool:
    """True when the gap with the ends (2,2) is one of those with these middles, m."""
    x, y = ((ends[0] + ends[1]) / 2.0).tolist()
    return any(math.hypot(x - m_x, y - m_y) < config.wall_thickness_m for m_x, m_y in middles)


def same_gap(a: Array, b: Array, config: RoomLimits) -> bool:
    """True when two gaps with the ends a and b (2,2) are one."""
    (a_x, a_y, c_x, c_y), (b_x, b_y, d_x, d_y) = a.ravel().tolist(), b.ravel().tolist()
    return math.hypot((a_x + c_x - b_x - d_x) / 2.0, (a_y + c_y - b_y - d_y) / 2.0) < config.wall_thickness_m


def gap_frame(ends: Array) -> Array:
    """(5,) as `DoorMap.frames`, of a gap with the ends (2,2): right and left as seen from the first room."""
    (right_x, right_y), (left_x, left_y) = ends.tolist()
    x, y = left_x - right_x, left_y - right_y
    width = math.hypot(x, y)
    return np.array([(right_x + left_x) / 2.0, (right_y + left_y) / 2.0, -y / width, x / width, width / 2.0])


def offset(frame: Sequence[float], p_robot: Array) -> tuple[float, float]:
    """How far a robot is ahead of a gap, towards its first room, and beside its posts, below 0 between; frame (5,)."""
    x, y, n_x, n_y, half = frame
    dx, dy = p_robot.item(0) - x, p_robot.item(1) - y
    return dx * n_x + dy * n_y, abs(dx * n_y - dy * n_x) - half


def rooms_beside(door_map: DoorMap, frame: Array, config: RoomLimits) -> tuple[int, int]:
    """The rooms in front of and behind a gap with this frame (5,), from the last passage there; unknown without one."""
    for passage in reversed(door_map.passages):
        alike = same_place(passage.frame, frame, config)
        if alike:
            return passage.rooms if alike > 0.0 else passage.rooms[::-1]
    return UNKNOWN_ROOM, UNKNOWN_ROOM


def pass_through(
    door_map: DoorMap, candidate: Candidate, features: FeatureTable, rooms: tuple[int, int], config: RoomLimits
) -> None:
    """The robot drove through a candidate between `rooms`, from the first: it is a door, as sure as one seen well."""
    door_map.candidates = [c for c in door_map.candidates if c is not candidate]
    _mark_jambs(candidate.ids, features)
    sightings = max(candidate.sightings, config.confirm_sightings)
    door_map.add(Door(door_map.next_id, candidate.ids, None, rooms, sightings))


def _without_faces(door: Door, lost: set[int]) -> Door | None:
    """The door without the faces that have a lost landmark; None without a face."""
    faces = [face for face in (door.jambs, door.other_face) if face and lost.isdisjoint(face)]
    return replace(door, jambs=faces[0], other_face=(*faces, None)[1]) if faces else None


def forget_jambs(door_map: DoorMap, gone: Ints, belief: Belief) -> None:
    """Remove the faces of doors with one of the landmarks `gone` (m,), still in the belief, and doors without a face.

    What a door between two known rooms joined is remembered as a `Passage`.
    """
    lost = set(gone.tolist())
    doors = [_without_faces(door, lost) for door in door_map.doors]
    for door, kept, frame in zip(door_map.doors, doors, door_map.frames(belief), strict=True):
        if kept is None and UNKNOWN_ROOM not in door.rooms:
            door_map.passages.append(Passage(frame.copy(), door.rooms))
    door_map.set_doors([door for door in doors if door is not None])
    door_map.sightings = {pair: count for pair, count in door_map.sightings.items() if lost.isdisjoint(pair)}
    door_map.candidates = [c for c in door_map.candidates if lost.isdisjoint(c.ids)]


def rename_jambs(door_map: DoorMap, keep: int, drop: int) -> None:
    """Two ids are one corner: doors that named `drop` now name `keep`."""

    def renamed(pair: tuple[int, int]) -> tuple[int, int]:
        return (keep if pair[0] == drop else pair[0], keep if pair[1] == drop else pair[1])

    def with_renamed(door: Door) -> Door:
        return replace(door, jambs=renamed(door.jambs), other_face=door.other_face and renamed(door.other_face))

    door_map.set_doors(list(map(with_renamed, door_map.doors)))
    merged: dict[tuple[int, int], int] = {}
    for pair, count in door_map.sightings.items():
        merged[renamed(pair)] = merged.get(renamed(pair), 0) + count
    door_map.sightings = merged
    door_map.candidates = [replace(c, ids=renamed(c.ids)) for c in door_map.candidates]
