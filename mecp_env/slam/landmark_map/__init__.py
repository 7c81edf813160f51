"""The map beside the filter's estimate: features, polygons, and the stages that extend and correct them (III-B).

Polygons are links to feature ids, with one room each, and a cap per room (Fig. 6).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import compress
from operator import attrgetter

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import inside_polygon
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.landmark_map.tracks import (
    PruneLimits,
    drop_tracks,
    find_duplicate,
    find_pruned,
    find_unconfirmed,
    track_corners,
)
from mecp_env.slam.messages import (
    Belief,
    CornerKind,
    FeatureState,
    FeatureTable,
    MapPolygon,
    MapView,
    Match,
    MergedScan,
    Polygon,
    PolygonGroup,
    RoomGraph,
    Segments,
    Sighting,
)
from mecp_env.slam.protocols import Filter, FilterError

Resolve = Callable[[int], int]  # room -> the room that it became by merges


@dataclass(slots=True, eq=False, init=False)
class LandmarkMap:
    """Tracks, landmarks and polygons. Each method but `view` is a stage that changes the map."""

    config: SlamConfig
    features: FeatureTable
    polygons: MapPolygonStore
    merged: dict[int, int]  # landmark that was merged -> landmark it became, before further merges

    def __init__(self, config: SlamConfig) -> None:
        self.config = config
        self.features = FeatureTable()
        self.merged = {}
        self.polygons = MapPolygonStore(config.association.polygons_per_room)

    def view(self, predicted: Belief, graph: RoomGraph, through: Ints, step: int, past: Ints | None = None) -> MapView:
        """What an associator may look at; `through` (n,) is the door that each corner is seen through."""
        return MapView(step, predicted, self.features, self.polygons.groups, graph, through, past)

    def track(self, seen: Sighting, graph: RoomGraph, wide: bool) -> tuple[Sighting, Ints]:
        """The sighting with an id for every corner that is kept, and the corners (c,) whose track is confirmed now.

        `wide`: the pose was predicted with so large a sigma that the next scan may miss tracks.
        """
        self.polygons.outdated |= drop_tracks(self.features, seen.step, self.config.tracks)
        match, confirmed = track_corners(self.features, seen, graph, self.config, wide)
        return seen.with_match(match), confirmed

    def forget_tracks(self, step: int, resolve: Resolve) -> None:
        """Drop all tracks and the polygons that they were vertices of: the robot was put elsewhere after `step`."""
        late = step + 1 + self.config.tracks.window_steps
        self.polygons.outdated |= drop_tracks(self.features, late, self.config.tracks)
        self.polygons.prune(self.features, resolve)

    def initialise(self, seen: Sighting, confirmed: Ints, landmark_filter: Filter) -> Sighting:
        """Augment the filter with the tracks confirmed now, by this sighting alone; the sighting with that belief.

        Those that find no room in a full filter are dropped, and counted there. Raises `FilterError` for an empty one
        that adds none.
        """
        if not len(confirmed):
            return seen
        z, R = seen.corners.measurements(confirmed)
        ids = seen.match.ids[confirmed]
        landmark_filter.augment(z, R, ids)
        accepted = np.array([landmark_filter.has(int(i)) for i in ids])
        if not (accepted.any() or len(landmark_filter.ids)):
            augment = f"{type(landmark_filter).__name__}.augment"
            raise FilterError(f"{augment}: it added none of the landmarks {ids.tolist()}")
        self.features.rows["state"][ids] = np.where(accepted, int(FeatureState.LANDMARK), int(FeatureState.DEAD))
        return replace(seen, belief=landmark_filter.belief())

    def link(self, polygons: tuple[Polygon, ...], seen: Sighting, graph: RoomGraph, moved: bool) -> None:
        """Link the polygons of this scan to their features; `moved`: features have changed their room (Fig. 6)."""
        self.polygons.outdated |= moved
        self.polygons.remember(polygons, seen.match, self.features, graph, seen.step)

    def merge(self, seen: Sighting, landmark_filter: Filter) -> tuple[Sighting, tuple[tuple[int, int], ...]]:
        """The sighting after a landmark of it is merged with another that is the same corner; ids kept and dropped."""
        merges = self.config.tracks.merge
        pair = find_duplicate(self.features, seen.belief, seen.match, self.config) if merges else None
        if pair is None or not self._may_merge(pair):
            return seen, ()
        keep, drop = pair
        landmark_filter.fuse(keep, drop)
        self.merged[drop] = keep
        rows = self.features.rows
        rows["state"][drop] = int(FeatureState.DEAD)
        rows["seen"][keep] += rows["seen"][drop]
        rows["last_step"][keep] = seen.step
        self.polygons.rename(keep, drop)
        match = replace(seen.match, ids=np.where(seen.match.ids == drop, keep, seen.match.ids))
        return replace(seen, match=match, belief=landmark_filter.belief()), (pair,)

    def _may_merge(self, pair: tuple[int, int]) -> bool:
        """False for the post of a door that is no landmark: to merge it with one would be an update."""
        kinds = self.features.rows["kind"][list(pair)]
        return self.config.association.use_posts or not (kinds == int(CornerKind.JAMB)).any()

    def prune(
        self, beams: MergedScan, segments: Segments, seen: Sighting, landmark_filter: Filter, resolve: Resolve
    ) -> tuple[Belief, Ints]:
        """Remove landmarks that scans show not to be there or do not confirm; the belief then, and their ids (m,)."""
        belief = seen.belief
        limits, gone = PruneLimits.of(self.config), np.empty(0, np.int64)
        if self.config.dynamic_objects.margin_m:
            gone = find_pruned(beams, segments, belief, self.features, seen.step, limits)
        unconfirmed = find_unconfirmed(self.features.rows, belief.ids, self.config.tracks.record, seen.step)
        gone = np.union1d(gone, unconfirmed) if len(unconfirmed) else gone
        if len(gone):
            landmark_filter.remove(gone)
            self.features.rows["state"][gone] = int(FeatureState.DEAD)
            self.polygons.outdated, belief = True, landmark_filter.belief()
        self.polygons.prune(self.features, resolve)  # of dead features, too, and after rooms and landmarks merged
        return belief, gone


DEAD = int(FeatureState.DEAD)
IDS, ROOM = attrgetter("ids"), attrgetter("room")


@dataclass(slots=True, eq=False)
class MapPolygonStore:
    """All polygons seen so far whose vertices are still alive."""

    most_per_room: int
    polygons: list[MapPolygon] = field(default_factory=list)
    groups: dict[int, PolygonGroup] = field(default_factory=dict)  # by cardinality; built again after a change
    row: dict[tuple[int, ...], int] = field(default_factory=dict)  # vertex ids -> index in `polygons`
    outdated: bool = False  # features died, merged or changed their room, or a room has too many polygons

    def remember(
        self, polygons: tuple[Polygon, ...], match: Match, features: FeatureTable, graph: RoomGraph, step: int
    ) -> None:
        """Add this scan's polygons whose vertices all have an id and are in this room, or note them seen again."""
        added = len(self.polygons)
        for polygon in () if graph.in_doorway else polygons:
            ring, intervals = np.empty(len(polygon.corners), np.int64), np.empty(polygon.intervals.shape)
            # Fig. 6: polygons of different rooms share no vertex
            if link(polygon.corners, match.ids, features.rows, graph.current, ring, polygon.intervals, intervals):
                self._note(ring, intervals, graph.current, step)
        if len(self.polygons) > added:
            count = [polygon.room for polygon in self.polygons].count(graph.current)
            self.outdated |= count > self.most_per_room

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

    def prune(self, features: FeatureTable, resolve: Callable[[int], int]) -> None:
        """Drop polygons with a dead vertex, in two rooms or there twice; per room the least seen above the cap.

        Nothing happens unless the store is `outdated`. `resolve` gives the room that a room became by merges.
        """
        if not self.outdated:
            return
        self.outdated = False
        rooms = self._resolve_rooms(resolve)
        renamed = len(self.row) < len(self.polygons)
        kept = are_whole(groups_of(self.polygons) if renamed else self.groups, np.array(rooms, np.int64), features)
        if renamed:
            self.polygons = without_doubles(list(compress(self.polygons, kept.tolist())))
            self.row = {tuple(polygon.ids.tolist()): i for i, polygon in enumerate(self.polygons)}
            self.groups = groups_of(self.polygons)
            rooms, kept = list(map(ROOM, self.polygons)), np.ones(len(self.polygons), np.bool_)
        leave_most_seen(kept, self.polygons, rooms, self.most_per_room)
        if not kept.all():
            self._keep(kept)

    def _resolve_rooms(self, resolve: Callable[[int], int]) -> list[int]:
        """Put the polygons into the rooms that theirs have become; the room of each."""
        named = list(map(ROOM, self.polygons))
        became = {room: resolve(room) for room in set(named)}
        if all(room == now for room, now in became.items()):
            return named
        self.polygons = [replace(polygon, room=became[polygon.room]) for polygon in self.polygons]
        return [became[room] for room in named]

    def visible_landmarks(self, p_map: Array, belief: Belief) -> Ints:
        """Ids of the landmarks visible from `p_map` (2,), by eq. 1: every vertex of a polygon around it."""
        x, y = p_map.tolist()
        whole = (polygon.ids for polygon in self.polygons if np.isin(polygon.ids, belief.ids).all())
        around = [ids for ids in whole if inside_polygon(x, y, belief.p_map[belief.rows(ids)])]
        return np.unique(np.concatenate([np.empty(0, np.int64), *around]))

    def rename(self, keep: int, drop: int) -> None:
        """Two ids are one corner: polygons that named `drop` now name `keep`."""
        self.outdated = True
        for i, polygon in enumerate(self.polygons):
            if drop not in polygon.ids.tolist():
                continue
            ring = np.where(polygon.ids == drop, keep, polygon.ids)
            intervals = np.empty_like(polygon.intervals)
            roll_to_least(ring, polygon.intervals, intervals)
            self.polygons[i] = replace(polygon, ids=ring, intervals=intervals)
            self.row = {}  # two may be one now: `prune` finds out

    def _keep(self, kept: Bools) -> None:
        """Forget the polygons that `kept` (P,) does not name."""
        chosen = kept.tolist()
        self.polygons = list(compress(self.polygons, chosen))
        self.row = dict(zip(compress(self.row, chosen), range(len(self.polygons)), strict=True))
        index = np.cumsum(kept) - 1
        for cardinality, group in list(self.groups.items()):
            still = kept[group.index]
            self.groups[cardinality] = PolygonGroup(index[group.index[still]], group.ids[still])
            if not still.any():
                del self.groups[cardinality]

    def _index_ring(self, ring: Ints) -> None:
        """Take in the ids of the last polygon of the list."""
        index, ids = np.array([len(self.polygons) - 1]), ring.reshape(1, -1)
        known = self.groups.get(len(ring))
        if known is not None:
            index, ids = np.concatenate((known.index, index)), np.concatenate((known.ids, ids))
        self.groups[len(ring)] = PolygonGroup(index, ids)


@compiled
def link(corners: Ints, ids: Ints, rows: Rows, current: int, ring: Ints, intervals: Array, rolled: Array) -> bool:
    """Write the feature ids (k,) of a scan's polygon, from the least, and its intervals (m,4) counted from there.

    False unless they differ and are in the room `current`. `corners` (k,) are its vertices, `ids` (n,) those of the
    scan's corners.
    """
    sound = True
    for v in range(corners.shape[0]):
        ring[v] = ids[corners[v]]
        sound = sound and ring[v] >= 0 and rows[ring[v]].room == current
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


def leave_most_seen(kept: Bools, polygons: list[MapPolygon], rooms: list[int], most: int) -> None:
    """Take off the mark `kept` (P,) in place: each room keeps the `most` polygons seen most often, then latest."""
    for room, count in Counter(compress(rooms, kept.tolist())).items():
        if count > most:
            members = [i for i in np.flatnonzero(kept).tolist() if rooms[i] == room]
            members.sort(key=lambda i: (polygons[i].seen, polygons[i].last_step))
            kept[members[: count - most]] = False


def are_whole(groups: dict[int, PolygonGroup], rooms: Ints, features: FeatureTable) -> Bools:
    """(P,) whether all vertices of each polygon live and lie in its one of the `rooms` (P,)."""
    state, room, whole = features.rows["state"], features.rows["room"], np.ones(len(rooms), np.bool_)
    for group in groups.values():
        wrong = (state[group.ids] == DEAD) | (room[group.ids] != rooms[group.index, None])
        whole[group.index] = ~wrong.any(axis=1)
    return whole


def without_doubles(polygons: list[MapPolygon]) -> list[MapPolygon]:
    """Without those that name a vertex twice; of those with the same vertices the last one, in place of the first."""
    rings = {tuple(polygon.ids.tolist()): polygon for polygon in polygons}
    return [polygon for ring, polygon in rings.items() if len(set(ring)) == len(ring)]


def groups_of(polygons: list[MapPolygon]) -> dict[int, PolygonGroup]:
    """The polygons by how many vertices they have."""
    members = defaultdict[int, list[int]](list)
    for i, polygon in enumerate(polygons):
        members[len(polygon.ids)].append(i)
    return {
        cardinality: PolygonGroup(np.array(index), np.array([polygons[i].ids for i in index]))
        for cardinality, index in sorted(members.items())
    }
