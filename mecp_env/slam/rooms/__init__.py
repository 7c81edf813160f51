"""Room graph: the room of the robot, the rooms behind doors, and merges of rooms (III, III-B, Fig. 6).

The robot's path since it entered a room: whether it has left the room unnoticed, through a door not known then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from mecp_env.core.carriers import Array, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import (
    UNKNOWN_ROOM,
    Belief,
    CornerKind,
    Corners,
    Decision,
    Door,
    FeatureState,
    FeatureTable,
    MapPolygon,
    RoomGraph,
    Sighting,
    resolved,
)
from mecp_env.slam.rooms.doors import (
    DoorMap,
    Passage,
    RoomLimits,
    are_landmarks,
    door_frames,
    forget_jambs,
    gap_frame,
    is_at,
    offset,
    pass_through,
    record_doorways,
    rename_jambs,
    rooms_beside,
    rooms_next_door,
    seen_through,
)


@dataclass(slots=True, eq=False)
class Trail:
    """Places `doorway_m` apart, and when they were passed; the oldest are forgotten."""

    places: Array = field(default_factory=lambda: np.empty((0, 4)))
    """(n,4): x, y in m, map frame; the step and the number of features then. The last is where the robot is now."""

    def add(self, step: int, features: int, T_map_robot: Array, config: RoomLimits) -> None:
        """Note where the robot is in a step, and how many features there are."""
        (x, y, _), n = T_map_robot.tolist(), len(self.places)
        places = self.places
        if n > 1 and math.dist((places.item(n - 2, 0), places.item(n - 2, 1)), (x, y)) < config.doorway_m:
            places[n - 1, 0], places[n - 1, 1] = x, y
            return
        kept = self.places[max(n - config.trail_places, 0) :]
        self.places = np.empty((len(kept) + 1, 4))
        self.places[:-1], self.places[-1] = kept, (x, y, step, features)

    def passed(self, jambs: Array) -> tuple[int, int] | None:
        """Step and number of features when the robot went through a gap (2,2) m for good; None if it did not."""
        at = last_crossing(self.places[:, :2], jambs)
        return None if at < 0 else (int(self.places[at, 2]), int(self.places[at, 3]))


def last_crossing(path: Array, gap: Array) -> int:
    """The first place of the path (n,2) after it crossed a gap (2,2) for the last time; -1 if it ends where it began.

    A path that went through and came back crossed the gap as often one way as the other.
    """
    (dx, dy), p_gap = gap[1] - gap[0], path - gap[0]
    off = dx * p_gap[:, 1] - dy * p_gap[:, 0]
    before = np.flatnonzero((off[:-1] > 0.0) != (off[1:] > 0.0))
    share = off[before] / (off[before] - off[before + 1])
    crossing = p_gap[before] + share[:, None] * (p_gap[before + 1] - p_gap[before])
    along = crossing[:, 0] * dx + crossing[:, 1] * dy
    after = before[(along > 0.0) & (along < dx * dx + dy * dy)] + 1
    net = np.where(off[after] > 0.0, 1, -1).sum()
    return int(after[-1]) if net != 0 else -1


LANDMARK = int(FeatureState.LANDMARK)
Joins = TypeVar("Joins", Door, Passage)


@dataclass(slots=True, eq=False)
class RoomGraphEstimator:
    """Estimates rooms and doors from what is seen and from the robot's path."""

    config: RoomLimits
    door_map: DoorMap = field(default_factory=DoorMap)
    current: int = 0
    in_doorway: bool = False
    rooms: list[int] = field(default_factory=lambda: [0])
    merged: dict[int, int] = field(default_factory=dict)
    next_room: int = 1
    newest: int = UNKNOWN_ROOM  # the room that the last crossing opened, until the robot leaves it
    other_room_signs: list[tuple[int, float, float]] = field(default_factory=list)  # room recognised, x, y
    trail: Trail = field(default_factory=Trail)  # the path since this room was entered
    parted: dict[int, tuple[int, int]] = field(default_factory=dict)  # as in RoomGraph
    previous_room: dict[int, int] = field(default_factory=dict)  # landmark -> room it was in before it was moved
    seen_from_both: set[tuple[int, int, int]] = field(default_factory=set)  # moved and moved back; the two rooms

    def graph(self) -> RoomGraph:
        """The room graph after the last step."""
        known = tuple(self.rooms), tuple(self.door_map.doors), tuple(self.door_map.candidates)
        return RoomGraph(self.current, self.in_doorway, *known, dict(self.merged), dict(self.parted))

    def mark_beyond(self, corners: Corners, belief: Belief) -> tuple[Corners, Ints]:
        """The corners with those seen through a mapped door no longer sites, and (n,) the id of that door or -1."""
        if not self.door_map.doors or not len(corners):
            return corners, np.full(len(corners), -1, np.int64)
        sites, doors = corners.sites.copy(), (self.door_map.jambs, self.door_map.ids)
        pose, landmarks = belief.T_map_robot, (belief.p_map, belief.ids)
        through = seen_through(pose, corners.z, *landmarks, *doors, self.config.behind_wall_m, sites)
        return corners.with_sites(sites), through

    def update(self, seen: Sighting, features: FeatureTable, known: list[MapPolygon]) -> bool:
        """True when landmarks changed their room, by a merge of rooms or one by one.

        Records this scan's doorways, follows the robot through doors, and moves landmarks that belong to another room.
        """
        self.trail.add(seen.step, len(features), seen.belief.T_map_robot, self.config)
        before = self.door_map.next_id
        if not self.in_doorway:
            record_doorways(self.door_map, seen, features, self.current, self.config)
        if self._detect_missed_door(before, seen.belief, features):
            return True
        merged = self._follow(features, seen.belief)
        self._follow_candidates(features, seen.belief)
        polygon_room = self.resolve(known[seen.match.known].room) if seen.match.known >= 0 else UNKNOWN_ROOM
        return self._recognise(seen, features, polygon_room) or merged

    def rename(self, merged: tuple[tuple[int, int], ...]) -> None:
        """Landmarks were merged: doors now name the ids kept, the first of each pair."""
        for keep, drop in merged:
            rename_jambs(self.door_map, keep, drop)

    def forget(self, pruned: Ints, belief: Belief) -> None:
        """The landmarks `pruned` (m,) are gone after this belief, and with them the doors that have no other face."""
        if len(pruned):
            forget_jambs(self.door_map, pruned, belief)

    def place(self, room: int) -> None:
        """Be in a room that the robot was put into, and did not drive to."""
        self._arrive(room)
        self.in_doorway, self.newest = False, UNKNOWN_ROOM

    def _detect_missed_door(self, first: int, belief: Belief, features: FeatureTable) -> bool:
        """True when the robot has driven through a door that was only now confirmed (ids from `first` on).

        What was seen since then belongs to a new room.
        """
        for d, door in enumerate(self.door_map.doors if self.door_map.next_id > first else ()):
            passed = self.trail.passed(belief.p_map[belief.rows(np.array(door.jambs))]) if door.id >= first else None
            if passed is None:
                continue
            here, there = rooms_beside(self.door_map, self.door_map.frames(belief)[d], self.config)
            left, room = self.current, here if there == self.current else self._open()
            self.door_map.change(d, replace(door, rooms=(room, left)))
            step, count = passed
            later = features.rows["room"][count:]  # features initialised since then
            later[later == left] = room
            self.parted[room] = (left, step)
            self._arrive(room)
            return True
        return False

    def arrive_at(self, ids: Ints, features: FeatureTable) -> None:
        """The robot is found where the landmarks `ids` (n,) are: in the room that most of them lie in."""
        rooms = [self.resolve(room) for room in features.rows["room"][ids].tolist() if room != UNKNOWN_ROOM]
        if rooms:
            self.place(max(sorted(set(rooms)), key=rooms.count))

    def _arrive(self, room: int) -> None:
        """Be in another room."""
        self.other_room_signs.clear()
        self.trail = Trail()
        self.current = room

    def _follow(self, features: FeatureTable, belief: Belief) -> bool:
        """Change the room when the path crosses a door, with hysteresis; true when rooms merged."""
        self.in_doorway = False
        if not self.door_map.doors:
            return False
        config, jambs = self.config, self.door_map.jambs
        near = _doors_near(belief.T_map_robot, belief.p_map, belief.ids, jambs, config.doorway_m).tolist()
        for _, ahead, aside, half in near:
            self.in_doorway |= abs(ahead) < config.doorway_m and abs(aside) < half
        for row, ahead, _, _ in near:
            d, side = int(row), 0 if ahead > 0.0 else 1
            if abs(ahead) > config.doorway_m and self._has_crossed(self.door_map.doors[d], side, belief):
                return self._enter(d, side, features, belief)
        return False

    def _has_crossed(self, door: Door, side: int, belief: Belief) -> bool:
        """True when the robot, now on the side of `door.rooms[side]`, came through the door.

        Nobody knew of a door of other rooms that it leads here: then the path decides.
        """
        if self.current in door.rooms:
            return door.rooms[1 - side] == self.current
        return self.trail.passed(belief.p_map[belief.rows(np.array(door.jambs))]) is not None

    def _enter(self, d: int, side: int, features: FeatureTable, belief: Belief) -> bool:
        """Be in the room on that side of a door; true when the room left turns out to be another one."""
        self.newest, left = UNKNOWN_ROOM, self.current
        door, signs = self.door_map.doors[d], {self.resolve(room) for room, _, _ in self.other_room_signs}
        rooms = [left if room == UNKNOWN_ROOM and i != side else room for i, room in enumerate(door.rooms)]
        rooms[side] = self._open() if rooms[side] == UNKNOWN_ROOM else rooms[side]
        self.door_map.doors[d] = replace(door, rooms=(rooms[0], rooms[1]))
        self._arrive(rooms[side])
        others = signs - rooms_next_door(self.door_map, left, 0) - {left}
        if len(others) != 1 or not self._is_bare(left, features):
            return False
        self._merge(left, others.pop(), features, belief)
        return True

    def _is_bare(self, room: int, features: FeatureTable) -> bool:
        """True when too few landmarks are of this room alone to make it one."""
        rows = features.rows
        own = (rows["room"] == room) & (rows["state"] == LANDMARK) & (rows["kind"] != int(CornerKind.JAMB))
        return int(own.sum()) < self.config.recognise_corners

    def _follow_candidates(self, features: FeatureTable, belief: Belief) -> None:
        """Driving through a gap that is not yet a door opens a room as well."""
        for candidate in self.door_map.candidates:
            frame = gap_frame(candidate.ends)
            ahead, beside = offset(frame.tolist(), belief.T_map_robot)
            passed = -1.0 < ahead < -self.config.doorway_m and beside < 0.0
            if passed and self.resolve(candidate.room) == self.current and are_landmarks(candidate.ids, features):
                here, there = rooms_beside(self.door_map, frame, self.config)
                room = there if here == self.current else self._open()
                pass_through(self.door_map, candidate, features, (self.current, room), self.config)
                self._arrive(room)
                return

    def _open(self) -> int:
        room = self.next_room
        self.rooms.append(room)
        self.next_room += 1
        self.newest = room
        return room

    def _recognise(self, seen: Sighting, features: FeatureTable, polygon_room: int) -> bool:
        """True when rooms merged or landmarks moved: landmarks of another room are misplaced, or the robot is there."""
        if self.in_doorway:
            return False
        taken_for, _ = self.parted.get(self.current, (UNKNOWN_ROOM, 0))  # it was given polygons of this room
        if polygon_room not in (UNKNOWN_ROOM, self.current, self.resolve(taken_for)):
            return self._note_other_room(polygon_room, seen.belief, self.config.recognise_m, features)
        match, beyond = seen.match, seen.corners.beyond
        ids = _on_this_side(match.ids, match.decision, seen.through, beyond, features.rows, self.current)
        if not len(ids):
            return False
        rooms = features.rows["room"][ids].tolist()
        if self._relabel(ids, rooms, features, seen.belief):
            return True
        other = self._majority(rooms)
        if other in (UNKNOWN_ROOM, self.current):
            return False
        return self._note_other_room(other, seen.belief, self.config.recognise_by_corners_m, features)

    def _relabel(self, ids: Ints, rooms: list[int], features: FeatureTable, belief: Belief) -> bool:
        """Move landmarks of other rooms to this one, where they are seen from; true when there were any.

        Those of the rooms next door were first seen through an unknown door, so that they were assigned to the robot's
        room at that time. If they are moved back, they are seen from both sides of a gap, and not through it: the gap
        does not separate rooms. Those of other rooms were first seen through two doors, and assigned to the room behind
        the first: they are moved where most of the landmarks recognised are of this room.
        """
        next_door = rooms_next_door(self.door_map, self.current, self.config.confirm_sightings)
        misplaced = [(i, room) for i, room in zip(ids.tolist(), rooms, strict=True) if room in next_door]
        far = self._far_off(ids, rooms, next_door)
        features.rows["room"][far] = self.current
        for i, room in misplaced:
            if self.previous_room.get(i) == self.current:
                self.seen_from_both.add((i, min(room, self.current), max(room, self.current)))
            self.previous_room[i], features.rows["room"][i] = room, self.current
        for room in sorted({room for _, room in misplaced}):
            if self._is_same_room(room):
                keep, drop = min(room, self.current), max(room, self.current)
                self._arrive(keep)
                self._merge(drop, keep, features, belief)
                break
        return bool(misplaced or far)

    def _far_off(self, ids: Ints, rooms: list[int], next_door: set[int]) -> list[int]:
        """The landmarks among `ids` of rooms that are not next door, where most of all are of this room."""
        if self._majority(rooms) != self.current:
            return []
        near = {UNKNOWN_ROOM, self.current, *next_door}
        return [i for i, room in zip(ids.tolist(), rooms, strict=True) if room not in near]

    def _is_same_room(self, room: int) -> bool:
        """True when enough landmarks are seen from both `room` and this one, and no two-faced door separates them."""
        pair = {room, self.current}
        seen = sum({first, second} == pair for _, first, second in self.seen_from_both)
        two_faced = any(door.other_face is not None and pair == set(door.rooms) for door in self.door_map.doors)
        return seen >= self.config.recognise_corners and not two_faced

    def _majority(self, rooms: list[int]) -> int:
        """The room that most of the landmarks recognised in this scan lie in, or UNKNOWN_ROOM."""
        if len(rooms) < self.config.recognise_corners:
            return UNKNOWN_ROOM
        likeliest = max(sorted(set(rooms)), key=rooms.count)
        return likeliest if rooms.count(likeliest) >= 0.75 * len(rooms) else UNKNOWN_ROOM

    def _note_other_room(self, other: int, belief: Belief, apart_m: float, features: FeatureTable) -> bool:
        """Count a sign that this is room `other`; two, seen from places apart, decide. True when rooms merged."""
        x, y = belief.T_map_robot[:2]
        before = [e for e in self.other_room_signs if e[0] == other]
        if any(np.hypot(e[1] - x, e[2] - y) >= apart_m for e in before):
            return self._become(other, features, belief)
        self.other_room_signs.append((other, float(x), float(y)))
        return False

    def _become(self, other: int, features: FeatureTable, belief: Belief) -> bool:
        """The robot is in `other`: the current room is that room if it is new or bare, else it was left unnoticed."""
        old = self.current
        self._arrive(other)
        if old != self.newest and not self._is_bare(old, features):
            return False
        self._merge(old, other, features, belief)
        return True

    def _merge(self, old: int, other: int, features: FeatureTable, belief: Belief) -> None:
        """Two rooms are one: `old` is `other` from now on."""
        self.newest = UNKNOWN_ROOM
        self.merged[old] = other
        features.rows["room"][features.rows["room"] == old] = other
        self.rooms.remove(old)
        doors = [self._with_rooms_resolved(door) for door in self.door_map.doors]
        passages = map(self._with_rooms_resolved, self.door_map.passages)
        self.door_map.passages = [one for one in passages if one.rooms[0] != one.rooms[1]]
        # a gap that leads from a room to itself is not a door: it is inside the room
        middles = self.door_map.frames(belief)[:, :2].tolist()
        self.door_map.inside += [(x, y) for d, (x, y) in zip(doors, middles, strict=True) if d.rooms[0] == d.rooms[1]]
        self.door_map.set_doors([door for door in doors if door.rooms[0] != door.rooms[1]])
        inside = self.door_map.inside
        self.door_map.candidates = [c for c in self.door_map.candidates if not is_at(c.ends, inside, self.config)]

    def _with_rooms_resolved(self, joins: Joins) -> Joins:
        first, second = map(self.resolve, joins.rooms)
        return replace(joins, rooms=(first, second))

    def resolve(self, room: int) -> int:
        """The room that `room` stands for after all merges."""
        return resolved(room, self.merged)


@compiled
def _doors_near(p_robot: Array, p_map: Array, ids: Ints, jambs: Ints, margin: float) -> Array:
    """(c,4) of the doors within 1 m and not farther aside than their posts and `margin`.

    The columns are the row in `jambs` (D,4), the distance of the robot in front of the door (towards its first room)
    and aside of its middle, and half the width; `p_map` (N,2), `ids` (N,) are the landmarks.
    """
    frames = door_frames(p_map, ids, jambs)
    near, count = np.empty((frames.shape[0], 4)), 0
    for d in range(frames.shape[0]):
        x, y, n_x, n_y, half = frames[d]
        dx, dy = p_robot[0] - x, p_robot[1] - y
        ahead, aside = dx * n_x + dy * n_y, dx * n_y - dy * n_x
        if abs(ahead) <= 1.0 and abs(aside) <= half + margin:
            near[count, 0], near[count, 1], near[count, 2], near[count, 3] = d, ahead, aside, half
            count += 1
    return near[:count]


@compiled
def _on_this_side(ids: Ints, decision: Ints, through: Ints, beyond: Ints, rows: Rows, current: int) -> Ints:
    """(c,) ids of the landmarks recognised on this side of all doors, but for jambs; (0,) when all are in `current`."""
    kept, count, elsewhere = np.empty(ids.shape[0], np.int64), 0, 0
    for i in range(ids.shape[0]):
        here = decision[i] == Decision.LANDMARK and through[i] < 0 and beyond[i] < 0
        if here and rows[ids[i]].kind != CornerKind.JAMB:
            kept[count] = ids[i]
            elsewhere += rows[ids[i]].room != current
            count += 1
    return kept[:count] if elsewhere > 0 else kept[:0]
