"""The polygons of the map: links to feature ids, a room each, a cap a room (III-B, Fig. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.data import Corners, FeatureState, FeatureTable, KnownPolygon, Match, Polygon, RoomGraph

Ints = NDArray[np.int64]


def remember_polygons(
    store: list[KnownPolygon],
    polygons: tuple[Polygon, ...],
    corners: Corners,
    match: Match,
    features: FeatureTable,
    graph: RoomGraph,
    period: int,
) -> None:
    """Add the polygons of this scan whose vertices all have an id and lie in one room, or note them seen again."""
    if graph.in_doorway:
        return
    for polygon in polygons:
        ids = match.ids[polygon.corners]
        if ids.min() >= 0 and len(set(ids.tolist())) == len(ids):
            _remember(store, ids, polygon.intervals, features, graph, period)


def _remember(
    store: list[KnownPolygon],
    ids: Ints,
    intervals: NDArray[np.float64],
    features: FeatureTable,
    graph: RoomGraph,
    period: int,
) -> None:
    rooms = {graph.resolve(int(room)) for room in features.room[ids]}
    if rooms != {graph.current}:  # Fig. 6: polygons of different rooms share no vertex
        return
    shift = int(np.argmin(ids))
    ring = np.concatenate((ids[shift:], ids[:shift]))
    known = next((p for p in store if np.array_equal(p.ids, ring)), None)
    if known is None:
        store.append(KnownPolygon(ring, _rolled(intervals, shift, len(ids)), graph.current, 1, period))
        return
    known.intervals = _rolled(intervals, shift, len(ids))
    known.seen += 1
    known.last_period = period


def _rolled(intervals: NDArray[np.float64], shift: int, k: int) -> NDArray[np.float64]:
    """Intervals with edge numbers counted from vertex `shift`."""
    rolled = intervals.copy()
    rolled[:, 0] = (rolled[:, 0] - shift) % k
    return rolled[np.argsort(rolled[:, 0], kind="stable")]


def prune(store: list[KnownPolygon], features: FeatureTable, graph: RoomGraph, most: int) -> None:
    """Drop polygons with a dead vertex or of two rooms, and of each room all but the `most` seen most often."""
    kept = [p for p in store if _whole(p, features, graph)]
    for room in {p.room for p in kept}:
        members = [p for p in kept if p.room == room]
        if len(members) > most:
            members.sort(key=lambda p: (p.seen, p.last_period))
            dropped = {id(p) for p in members[: len(members) - most]}
            kept = [p for p in kept if id(p) not in dropped]
    store[:] = kept


def _whole(polygon: KnownPolygon, features: FeatureTable, graph: RoomGraph) -> bool:
    polygon.room = graph.resolve(polygon.room)
    alive = (features.state[polygon.ids] != int(FeatureState.DEAD)).all()
    distinct = len(set(polygon.ids.tolist())) == len(polygon.ids)
    return bool(alive and distinct and all(graph.resolve(int(r)) == polygon.room for r in features.room[polygon.ids]))


def rename(store: list[KnownPolygon], keep: int, drop: int) -> None:
    """Two ids are one corner: polygons that named `drop` now name `keep`."""
    for polygon in store:
        ids = np.where(polygon.ids == drop, keep, polygon.ids)
        shift = int(np.argmin(ids))
        polygon.ids = np.concatenate((ids[shift:], ids[:shift]))
        polygon.intervals = _rolled(polygon.intervals, shift, len(ids))
