"""The estimator, in the paper's order: extract features, find polygons, associate, filter, map (III)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.messages import Odometry, Scan
from mecp_env.slam.association import Associator, ignored, make_associator
from mecp_env.slam.checks import check_match, check_odometry, check_scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.filters import Filter, make_filter
from mecp_env.slam.filters.divergence import Divergence
from mecp_env.slam.filters.mounting import mount, predict_mounted, robot_belief
from mecp_env.slam.frontend.clustering import cluster_beams
from mecp_env.slam.frontend.corners import extract_corners
from mecp_env.slam.frontend.dense_scan import merge_sweeps
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.grid.painter import GridPainter
from mecp_env.slam.landmark_map.dynamic_objects import DynamicObjects, make_dynamic_objects
from mecp_env.slam.landmark_map.landmark_map import LandmarkMap
from mecp_env.slam.map_file import MapStart, SlamMap, begin
from mecp_env.slam.mecp.polygons import beams_on_walls, find_polygons
from mecp_env.slam.messages import Corners, MapView, Match, Polygon, Sighting, SlamOutput
from mecp_env.slam.rooms.room_graph import RoomGraphEstimator


@dataclass(slots=True, eq=False, init=False)
class SlamPipeline:
    """EKF-SLAM with MECP data association over odometry and laser scans.

    The map frame is the robot's pose at `start`. `config` may be a dict, or None for the defaults. `associator` and
    `filter` replace the parts that `config` names; upper bounds inject ground truth by them (`OracleAssociator`,
    `OraclePoseFilter`).
    """

    config: SlamConfig
    filter: Filter
    associator: Associator
    divergence: Divergence
    map: LandmarkMap
    rooms: RoomGraphEstimator
    dynamic_objects: DynamicObjects
    grid: GridPainter
    step_count: int

    def __init__(
        self,
        config: SlamConfig | dict[str, Any] | None = None,
        *,
        associator: Associator | None = None,
        filter: Filter | None = None,
    ) -> None:
        self.config = config = SlamConfig.parse(config)
        self.filter = filter or make_filter(config.filter)
        mount(self.filter, config.sensor)
        self.associator = associator or make_associator(config.association)
        self.divergence = Divergence(config.filter.diverged_sigma_m)
        self.map = LandmarkMap(config)
        self.rooms = RoomGraphEstimator(config.rooms)
        self.dynamic_objects = make_dynamic_objects(config.dynamic_objects)
        self.grid = GridPainter(config.grid)
        self.step_count = 0

    @classmethod
    def from_map(
        cls, saved: SlamMap | str | Path, start: MapStart = "saved", sigmas: Sequence[float] = (0.5, 0.5, 0.25)
    ) -> Self:
        """A pipeline in a saved map, or in that of a file: it localises there and goes on mapping.

        `start`: "saved" continues to the bit as if it had never stopped; a pose x, y, heading (m, rad, map frame) is
        where the robot is, with the `sigmas` of its three numbers, by default those of a click on a map. Raises
        `MapError` and `ConfigError`.
        """
        saved = saved if isinstance(saved, SlamMap) else SlamMap.load(saved)
        pipeline = saved.restore(cls)
        begin(pipeline, start, sigmas)
        return pipeline

    def save_map(self, path: str | Path) -> None:
        """Write everything that this pipeline knows into a file, whole or not at all. Raises `MapError`, `OSError`."""
        SlamMap.of(self).save(path)

    def start(self, scan: Scan) -> SlamOutput:
        """The output for a scan taken at rest: the first ones belong to the start pose, before any motion.

        Raises `SensorError` for an invalid scan, and `MatchError` for an invalid match of a custom associator. The
        estimator is unchanged after a `SensorError`.
        """
        check_scan(scan, self.config.sensor.field_of_view_rad)
        self.step_count += 1
        return self._observe(scan)

    def step(self, odometry: Odometry, scan: Scan) -> SlamOutput:
        """The output of one control step: the motion, then the scan at its end. Raises as `start` does."""
        check_odometry(odometry)
        check_scan(scan, self.config.sensor.field_of_view_rad)
        self.step_count += 1
        predict_mounted(self.filter, odometry, self.config.sensor)
        return self._observe(scan)

    def visible_landmarks(self, p_map: Array) -> Ints:
        """Ids of the landmarks visible from `p_map` (2,), by eq. 1: every vertex of a polygon around it."""
        return self.map.polygons.visible_landmarks(p_map, self.filter.belief())

    def _observe(self, scan: Scan) -> SlamOutput:
        config = self.config
        beams = merge_sweeps(scan, config.sensor)  # III-A.1, dense scan
        clusters = cluster_beams(beams, config.clustering, config.segments, config.sensor)  # III-A.1, data clustering
        segments = extract_segments(beams, clusters, config.segments, config.sensor)  # III-A.1, Ramer-Douglas-Peucker
        corners = extract_corners(beams, segments, config.corners, config.sensor)  # III-A.1, line intersections, ends
        predicted = self.filter.belief()
        corners, through = self.rooms.mark_beyond(corners.with_floor(config.filter.linearisation_sigma_m), predicted)
        polygons = find_polygons(corners, beams, config.polygon, beams_on_walls(clusters, beams))  # III-A.2
        view = self.map.view(predicted, self.rooms.graph(), through, self.step_count)
        associated, updated = self._localise(corners, polygons, view)  # III-B
        belief = self.divergence.watch(self.filter.belief())
        dynamic = self.dynamic_objects.find(beams, segments, belief, self.grid.canvas.grid)
        static = self.dynamic_objects.reject(updated, corners, beams, dynamic)
        seen = self._extend_map(Sighting(corners, static, through, belief, self.step_count), polygons)  # III-B.1
        belief, pruned = self.map.prune(beams, segments, seen, self.filter, self.rooms.resolve)
        self.rooms.forget(pruned)
        graph, matched = self.rooms.graph(), seen.match.ids[seen.match.recognised()]
        painted = self.dynamic_objects.without(beams, segments, dynamic)
        grid = self.grid.paint(belief, *painted, matched, self.map.polygons.polygons, graph)
        return SlamOutput(
            *(self.step_count, beams, segments, corners, polygons, associated, seen.match),
            *(robot_belief(belief, config.sensor), graph, tuple(self.map.polygons.polygons), grid),
            *(self.divergence.found, config.sensor.T_robot_laser),
        )

    def _localise(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView) -> tuple[Match, Match]:
        """The match of the associator, and the part of it that updated the filter; nothing where that diverges."""
        associated = updated = ignored(len(corners))
        with self.divergence:
            associated = self.associator.associate(corners, polygons, view, self.filter)
            check_match(associated, len(corners), len(view.features))
            config = self.config.association
            oldest = self.step_count - self.config.tracks.window_steps
            sure = self.dynamic_objects.reject_closures(associated, corners, view.features, self.filter, oldest)
            updated = self._update(corners, sure, iterate=not config.is_sharp(view.belief))
        return associated, updated

    def _update(self, corners: Corners, match: Match, iterate: bool) -> Match:
        """Update the filter with all recognised corners at once."""
        recognised = match.recognised()
        if len(recognised):
            z, R = corners.measurements(recognised)
            self.filter.update(z, R, match.ids[recognised], iterate=iterate)
        return match

    def _extend_map(self, seen: Sighting, polygons: tuple[Polygon, ...]) -> Sighting:
        """Tracks, landmarks, doors, rooms and polygons after this scan; the sighting with all its ids."""
        seen, confirmed = self.map.track(seen, self.rooms.graph())
        self.associator.remember(seen.match)
        seen = self.map.initialise(seen, confirmed, self.filter)
        moved = self.rooms.update(seen, self.map.features, self.map.polygons.polygons)
        self.map.link(polygons, seen, self.rooms.graph(), moved)
        with self.divergence:
            seen, merged = self.map.merge(seen, self.filter)
            self.rooms.rename(merged)
        return seen
