"""The parts of the estimator, how they are made, and where it begins; `pipeline` is what happens in a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self, cast

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.slam.association import Associator, make_associator
from mecp_env.slam.checks import MatchError, check_match
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.custom import (
    BegunStep,
    CheckedFilter,
    UndoneOnError,
    check_belief,
    check_custom_match,
    check_part,
    is_ours,
    unchanged,
)
from mecp_env.slam.filters import Filter, FilterError, make_filter
from mecp_env.slam.filters.mounting import mount, robot_belief, robot_joint
from mecp_env.slam.filters.window import Divergence
from mecp_env.slam.grid import GridPainter
from mecp_env.slam.landmark_map import LandmarkMap
from mecp_env.slam.landmark_map.dynamic_objects import DynamicObjects, make_dynamic_objects
from mecp_env.slam.localisation import PoseGuard
from mecp_env.slam.map_file import MapStart, SlamMap, begin
from mecp_env.slam.messages import NO_ID, Belief, Corners, FeatureState, MapView, Match, Polygon, ScanFeatures
from mecp_env.slam.panorama import RecentScans
from mecp_env.slam.rooms import RoomGraphEstimator
from mecp_env.slam.rooms.doors import RoomLimits


@dataclass(slots=True, eq=False, init=False)
class SlamParts:
    """All that the estimator knows: one part a stage, each of which keeps what it has learnt."""

    config: SlamConfig
    filter: Filter
    associator: Associator
    divergence: Divergence
    map: LandmarkMap
    rooms: RoomGraphEstimator
    dynamic_objects: DynamicObjects
    grid: GridPainter
    recent: RecentScans
    guard: PoseGuard
    step_count: int

    def __init__(
        self,
        config: SlamConfig | dict[str, Any] | None = None,
        *,
        associator: Associator | None = None,
        filter: Filter | None = None,
    ) -> None:
        self.config = config = SlamConfig.parse(config)
        self.filter = make_filter(config.filter) if filter is None else filter
        self.associator = make_associator(config.association) if associator is None else associator
        check_part(self.filter, "filter", Filter)
        check_part(self.associator, "associator", Associator)
        mount(self.filter, config.sensor)
        self.divergence = Divergence(config.filter.diverged_sigma_m)
        self.map = LandmarkMap(config)
        self.rooms = RoomGraphEstimator(room_limits(config))
        self.dynamic_objects = make_dynamic_objects(config.dynamic_objects, config.sensor)
        self.grid = GridPainter(config.grid)
        self.recent = RecentScans(config)
        self.guard = PoseGuard(config.localisation, config.grid.paint_range_m, config.association)
        self.guard.certain = self.associator.certain
        self.step_count = 0

    @classmethod
    def from_map(
        cls, saved: SlamMap | str | Path, start: MapStart = "saved", sigmas: Sequence[float] = (0.5, 0.5, 0.25)
    ) -> Self:
        """A pipeline in a saved map, or in that of a file: it localises there and goes on mapping.

        `start`: "saved" continues to the bit as if it had never stopped; a pose x, y, heading (m, rad, map frame) is
        where the robot is, with the `sigmas` of its three numbers, by default those of a click on a map; "unknown"
        searches for the pose in the whole map, and maps nothing before. Raises `MapError` and `ConfigError`.
        """
        saved = saved if isinstance(saved, SlamMap) else SlamMap.load(saved)
        pipeline = saved.restore(cls)
        begin(pipeline, start, sigmas)
        return pipeline

    def save_map(self, path: str | Path) -> None:
        """Write everything that this pipeline knows into a file, whole or not at all. Raises `MapError`, `OSError`."""
        SlamMap.of(self).save(path)

    def export(self, **paths: str | PathLike[str] | None) -> list[Path]:
        """Write files as `SlamOutput.export` does, and `joint_covariance` (.npz or .csv) of pose and landmarks.

        Raises as it does.
        """
        from mecp_env.slam.export import EstimatedMap, Joint, save  # here, as a step writes none

        view = self.config.sensor
        belief, graph = robot_belief(self.filter.belief(), view), self.rooms.graph()

        def joint() -> Joint:
            return Joint(self.filter.ids.copy(), *robot_joint(self.filter, view))

        return save(EstimatedMap(belief, graph, self.grid.canvas.grid, joint), paths)

    def lose_pose(self) -> None:
        """The robot may be anywhere: its pose is searched for in the whole map, and nothing is mapped before."""
        self.guard.lose(anywhere=True)
        self.divergence.found = False
        self.map.forget_tracks(self.step_count, self.rooms.resolve)
        self.recent.forget(self.filter)

    def register(self, scan: ScanFeatures) -> bool:
        """Correct the prediction by the window of recent scans; True when a scan agrees with them."""
        with self.divergence:
            most = 0.25 * self.guard.slack()  # odometry that has failed is off by all that it reported, two sigmas
            return self.recent.register(scan, self.asked, self.guard.update, most, lost=not self.guard.localised)
        return False

    @property
    def is_ours(self) -> bool:
        """True without a custom part, which might raise an error in the middle of a step."""
        return is_ours(self.associator) and is_ours(self.filter) and self.config.polygon.is_ours

    def begin_step(self) -> BegunStep:
        """Count a step; a context in which an error of custom parts changes nothing, to be left before painting."""
        begun = BegunStep() if self.is_ours else UndoneOnError(self)
        self.step_count += 1
        return begun

    def believed(self, after: str, belief: Belief | None = None) -> Belief:
        """What the filter believes. Raises `FilterError` for a custom one whose belief is unsound `after` something."""
        belief = self.filter.belief() if belief is None else belief
        return belief if is_ours(self.filter) else self._sound(belief, self.filter, after)

    def watched(self) -> Belief:
        """What the filter believes; too large a sigma is a divergence, but where the pose is known to be unsure.

        The robot then maps on from where it was lost, and its sigma is what odometry may have been wrong by.
        """
        belief = self.filter.belief()
        return belief if self.guard.unsure_from != NO_ID else self.divergence.watch(belief)

    def correct(self, z: Array, R: Array, ids: Ints, iterate: bool) -> None:
        """Update the filter; a custom one that is unsound then stays as it was. Raises `FilterError`."""
        if is_ours(self.filter):
            self.guard.update(self.filter, z, R, ids, iterate)
            return
        tried = self.filter.copy()
        try:
            self.guard.update(cast("Filter", CheckedFilter(tried)), z, R, ids, iterate)
        except np.linalg.LinAlgError as error:
            raise FilterError(f"{type(tried).__name__}.update: {error}") from error
        self._sound(tried.belief(), tried, "update")
        self.filter = tried

    def _sound(self, belief: Belief, estimate: Filter, after: str) -> Belief:
        landmarks = np.flatnonzero(self.map.features.rows["state"] == FeatureState.LANDMARK)
        return check_belief(belief, landmarks, f"{type(estimate).__name__}.{after}")

    @property
    def asked(self) -> Filter:
        """The filter; a custom one is asked through a check of its answers."""
        return self.filter if is_ours(self.filter) else cast("Filter", CheckedFilter(self.filter))

    def ask_associator(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView) -> Match:
        """Its match. Raises `MatchError` for one of a custom associator that is unsound, or names what is not there."""
        if is_ours(self.associator):
            return self.associator.associate(corners, polygons, view, self.asked)
        name = f"{type(self.associator).__name__}.associate"
        with unchanged(self.associator, corners=corners, belief=view.belief, features=view.features):
            match = self.associator.associate(corners, polygons, view, self.asked.copy())
        try:
            check_match(match, len(corners), len(self.map.features))
            check_custom_match(match, self.map.features, len(polygons), len(self.map.polygons.polygons))
        except MatchError as error:
            raise MatchError(f"{name}: {error}") from None
        return match

    def visible_landmarks(self, p_map: Array) -> Ints:
        """Ids of the landmarks visible from `p_map` (2,), by eq. 1: every vertex of a polygon around it."""
        return self.map.polygons.visible_landmarks(p_map, self.filter.belief())


def room_limits(config: SlamConfig) -> RoomLimits:
    """The limits of rooms and doors that a configuration implies."""
    rooms = config.rooms
    of_others = config.tracks.sightings, config.corners.wall_thickness_m
    return RoomLimits(*of_others, rooms.doorway_m, config.grid.key_scan_m, rooms.recognise_corners, rooms.trail_places)
