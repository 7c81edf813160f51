"""The map beside the filter's estimate: features, polygons, and the stages that extend and correct them (III-B)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.carriers import Ints
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.landmark_map.map_polygons import MapPolygonStore
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
    MapView,
    MergedScan,
    Polygon,
    RoomGraph,
    Segments,
    Sighting,
)
from mecp_env.slam.protocols import Filter

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
        self.polygons.outdated |= drop_tracks(
            self.features, step + 1 + self.config.tracks.window_steps, self.config.tracks
        )
        self.polygons.prune(self.features, resolve)

    def initialise(self, seen: Sighting, confirmed: Ints, landmark_filter: Filter) -> Sighting:
        """Augment the filter with the tracks confirmed now, by this sighting alone; the sighting with that belief.

        Those that find no room in a full filter are dropped, and counted there.
        """
        if not len(confirmed):
            return seen
        z, R = seen.corners.measurements(confirmed)
        ids = seen.match.ids[confirmed]
        landmark_filter.augment(z, R, ids)
        accepted = np.array([landmark_filter.has(int(i)) for i in ids])
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
