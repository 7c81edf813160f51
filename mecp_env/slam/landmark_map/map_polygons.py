"""The polygons of the map: links to feature ids, a room each, a cap a room (III-B, Fig. 6)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.messages import FeatureState, FeatureTable, MapPolygon, Match, Polygon, Rings, RoomGraph

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

DEAD = int(FeatureState.DEAD)


@dataclass(slots=True, eq=False)
class PolygonStore:
    """All polygons seen so far whose vertices are still alive."""

    most_per_room: int
    polygons: list[MapPolygon] = field(default_factory=list)
    rings: dict[int, Rings] = field(default_factory=dict)  # by cardinality, for matching; made anew after a change
    row: dict[tuple[int, ...], int] = field(default_factory=dict)  # vertex ids -> index in `polygons`

    def remember(
        self,
        polygons: tuple[Polygon, ...],
        match: Match,
        features: FeatureTable,
        graph: RoomGraph,
        step: int,
    ) -> bool:
        """Add this scan's polygons whose vertices all have an id and lie in this room, or note them seen again.

        Says whether the room now has more of them than the cap.
        """
        added = len(self.polygons)
        for polygon in () if graph.in_doorway else polygons:
            ring, intervals = np.empty(len(polygon.corners), np.int64), np.empty_like(polygon.intervals)
            # Fig. 6: polygons of different rooms share no vertex
            if link(polygon.corners, match.ids, features.room, graph.current, ring, polygon.intervals, intervals):
                self._note(ring, intervals, graph.current, step)
        return len(self.polygons) > added and self._above_cap(graph.current)

    def _above_cap(self, room: int) -> bool:
        return sum(polygon.room == room for polygon in self.polygons) > self.most_per_room

    def _note(self, ring: Ints, intervals: Array, room: int, step: int) -> None:
        key = tuple(ring.tolist())
        if key not in self.row:
            self.row[key] = len(self.polygons)
            self.polygons.append(MapPolygon(ring, intervals, room, 1, step))
            self._index_ring(ring)
            return
        i = self.row[key]
        known = self.polygons[i]
        self.polygons[i] = MapPolygon(known.ids, intervals, known.room, known.seen + 1, step)

    def prune(self, features: FeatureTable, graph: RoomGraph) -> None:
        """Drop polygons with a dead vertex, of two rooms or there twice; of each room the least seen above the cap."""
        rooms = {room: graph.resolve(room) for room in {p.room for p in self.polygons}}
        sound = _whole(self.polygons, features, rooms)
        kept = {tuple(p.ids.tolist()): _in_room(p, rooms[p.room]) for p in compress(self.polygons, sound)}
        self.polygons = _seen_most(list(kept.values()), self.most_per_room)
        self._index()

    def rename(self, keep: int, drop: int) -> None:
        """Two ids are one corner: polygons that named `drop` now name `keep`."""
        for i, polygon in enumerate(self.polygons):
            if (polygon.ids == drop).any():
                ring = np.where(polygon.ids == drop, keep, polygon.ids)
                intervals = np.empty_like(polygon.intervals)
                roll_to_least(ring, polygon.intervals, intervals)
                self.polygons[i] = replace(polygon, ids=ring, intervals=intervals)

    def _index(self) -> None:
        rings = [polygon.ids.tolist() for polygon in self.polygons]
        self.row = {tuple(ring): i for i, ring in enumerate(rings)}
        self.rings = {}
        for cardinality in set(map(len, rings)):
            index = [i for i, ring in enumerate(rings) if len(ring) == cardinality]
            self.rings[cardinality] = Rings(np.array(index, np.int64), np.array([rings[i] for i in index], np.int64))

    def _index_ring(self, ring: Ints) -> None:
        """Take in the ids of the last polygon of the list."""
        index, ids = np.array([len(self.polygons) - 1]), ring.reshape(1, -1)
        known = self.rings.get(len(ring))
        if known is not None:
            index, ids = np.concatenate((known.index, index)), np.concatenate((known.ids, ids))
        self.rings[len(ring)] = Rings(index, ids)


@compiled
def link(corners: Ints, ids: Ints, room: Ints, current: int, ring: Ints, intervals: Array, rolled: Array) -> bool:
    """Write the feature ids (k,) of a scan's polygon, from the least, and its intervals (m,4) counted from there.

    False unless they differ and lie in the room `current`. `corners` (k,) are its vertices, `ids` (n,) those of the
    scan's corners, `room` (F,) that of each feature.
    """
    sound = True
    for v in range(corners.shape[0]):
        ring[v] = ids[corners[v]]
        sound = sound and ring[v] >= 0 and room[ring[v]] == current
        for u in range(v):
            sound = sound and ring[u] != ring[v]
    if sound:
        roll_to_least(ring, intervals, rolled)
    return sound


@compiled
def roll_to_least(ring: Ints, intervals: Array, rolled: Array) -> None:
    """Turn `ring` (k,) so that its least id is first, and write the intervals (m,4) with the edges counted from it."""
    k, m, shift, split = ring.shape[0], intervals.shape[0], 0, 0
    before = ring.copy()
    for v in range(1, k):
        if before[v] < before[shift]:
            shift = v
    for v in range(k):
        ring[v] = before[(v + shift) % k]
    while split < m and intervals[split, 0] < shift:
        split += 1
    for i in range(m):
        for column in range(4):
            rolled[i, column] = intervals[(i + split) % m, column]
        rolled[i, 0] = (rolled[i, 0] - shift) % k


def _seen_most(polygons: list[MapPolygon], most: int) -> list[MapPolygon]:
    """The polygons in order, of each room the `most` that were seen most often, then latest."""
    dropped: set[int] = set()
    for room, count in Counter(p.room for p in polygons).items():
        if count > most:
            members = sorted((p for p in polygons if p.room == room), key=lambda p: (p.seen, p.last_step))
            dropped.update(id(p) for p in members[: count - most])
    return [p for p in polygons if id(p) not in dropped]


def _whole(polygons: list[MapPolygon], features: FeatureTable, rooms: dict[int, int]) -> list[bool]:
    """Which polygons have vertices that differ, live and lie in the room that theirs has become."""
    if not polygons:
        return []
    ends = np.cumsum([len(p.ids) for p in polygons])
    now, whole = np.array([rooms[p.room] for p in polygons]), np.empty(len(polygons), np.bool_)
    find_whole(np.concatenate([p.ids for p in polygons]), ends, features.state, features.room, now, whole)
    found: list[bool] = whole.tolist()
    return found


def _in_room(polygon: MapPolygon, room: int) -> MapPolygon:
    return polygon if polygon.room == room else replace(polygon, room=room)


@compiled
def find_whole(ids: Ints, ends: Ints, state: Ints, room_of: Ints, rooms: Ints, whole: Bools) -> None:
    """Write which rings (P,) are whole in their `rooms` (P,); `ids` (n,) holds one after another, up to `ends` (P,)."""
    first = 0
    for p in range(ends.shape[0]):
        whole[p] = is_whole(ids[first : ends[p]], state, room_of, rooms[p])
        first = ends[p]


@compiled
def is_whole(ids: Ints, state: Ints, room_of: Ints, room: int) -> bool:
    """True when the vertices `ids` (k,) differ, live and lie in `room`; `state` and `room_of` (F,) are of features."""
    whole = True
    for v in range(ids.shape[0]):
        whole = whole and state[ids[v]] != DEAD and room_of[ids[v]] == room
        for u in range(v):
            whole = whole and ids[u] != ids[v]
    return whole
