"""The estimator, in the paper's order: extract features, find polygons, associate, filter, map (III)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.messages import Odometry, Scan
from mecp_env.core.se2 import inside_polygon
from mecp_env.slam.association import ignored, make_associator
from mecp_env.slam.checks import check_match, check_odometry, check_scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.frontend.clustering import cluster_beams
from mecp_env.slam.frontend.corners import extract_corners
from mecp_env.slam.frontend.dense_scan import merge_sweeps
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.grid.painter import GridPainter
from mecp_env.slam.landmark_map.dynamic_objects import find_transient, passing, shun_transients, without_transients
from mecp_env.slam.landmark_map.map_polygons import PolygonStore
from mecp_env.slam.landmark_map.merging import find_duplicate
from mecp_env.slam.landmark_map.pruning import refuted
from mecp_env.slam.landmark_map.tracks import (
    ends_of_bodies,
    forget,
    mark_seen,
    record_sightings,
    room_unseen_since,
    with_closure,
)
from mecp_env.slam.mecp.polygons import beams_on_walls, find_polygons
from mecp_env.slam.messages import (
    NO_ID,
    Belief,
    Corners,
    Decision,
    FeatureState,
    FeatureTable,
    MapView,
    Match,
    MergedScan,
    Polygon,
    Reason,
    Segments,
    Sighting,
    SlamOutput,
)
from mecp_env.slam.protocols import Associator, Filter, FilterError
from mecp_env.slam.rooms.doors import forget_jambs, rename_jambs
from mecp_env.slam.rooms.room_graph import RoomGraphEstimator

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class SlamPipeline:
    """EKF-SLAM with MECP data association over odometry and laser scans.

    The map frame is the robot's pose when `start` is called. `step` takes one control step. `config` may be a dict.
    Both raise `SensorError` for a scan or a reading that is not what it must be; nothing is changed then. Set
    `associator` to an `Associator` of your own; `MatchError` names what is wrong with a match that it returns.
    """

    config: SlamConfig
    filter: Filter = field(init=False)
    associator: Associator = field(init=False)
    features: FeatureTable = field(init=False)
    polygons: PolygonStore = field(init=False)
    rooms: RoomGraphEstimator = field(init=False)
    grid: GridPainter = field(init=False)
    step_count: int = field(init=False, default=0)
    diverged: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        self.config = SlamConfig.parse(self.config)
        self.reset()

    def reset(self) -> None:
        """Forget everything: an empty map, the robot at its origin."""
        self.filter = make_filter(self.config.filter)
        self.associator = make_associator(self.config.association)
        self.features = FeatureTable()
        self.polygons = PolygonStore(self.config.association.polygons_per_room)
        self.rooms = RoomGraphEstimator(self.config.rooms)
        self.grid = GridPainter(self.config.grid)
        self.step_count = 0
        self.diverged = False

    def start(self, scan: Scan) -> SlamOutput:
        """The report of a scan taken at rest: the first ones belong to the start pose, before any motion."""
        check_scan(scan)
        self.step_count += 1
        return self._observe(scan)

    def step(self, odometry: Odometry, scan: Scan, *, T_map_robot: Array | None = None) -> SlamOutput:
        """The report of one control step: the motion, then the scan at its end.

        `T_map_robot`, the true pose, replaces the estimate where an upper bound is wanted.
        """
        check_odometry(odometry)
        check_scan(scan)
        self.step_count += 1
        self.filter.predict(odometry)
        if T_map_robot is not None:
            self.filter.set_pose(T_map_robot)
        return self._observe(scan)

    def visible_landmarks(self, p_map: Array) -> Ints:
        """Ids of the landmarks that can be seen from `p_map` (2,), by eq. 1: every vertex of a polygon around it."""
        belief = self.filter.belief()
        row = {landmark: i for i, landmark in enumerate(belief.ids.tolist())}
        visible: set[int] = set()
        for polygon in self.polygons.polygons:
            ids = polygon.ids.tolist()
            if all(i in row for i in ids):
                ring = np.ascontiguousarray(belief.p_map[[row[i] for i in ids]])
                visible.update(ids if inside_polygon(float(p_map[0]), float(p_map[1]), ring) else ())
        return np.array(sorted(visible), np.int64)

    def _observe(self, scan: Scan) -> SlamOutput:
        config = self.config
        beams = merge_sweeps(scan, config.sensor)  # III-A.1, dense scan
        clusters = cluster_beams(beams, config.clustering, config.segments, config.sensor)  # III-A.1
        segments = extract_segments(beams, clusters, config.segments, config.sensor)
        corners = extract_corners(beams, segments, config.corners, config.sensor)
        corners = corners.with_floor(config.filter.linearisation_sigma_m)
        predicted = self.filter.belief()
        corners, through = self.rooms.mark_beyond(corners, predicted)
        polygons = find_polygons(corners, beams, config.polygon, beams_on_walls(clusters, beams))  # III-A.2
        match = self._localise(corners, polygons, predicted, through)  # III-B
        belief = self._watched(self.filter.belief())
        # Differs from the paper: its world is static; what stands on floor seen free before moves, and is not mapped.
        transient = find_transient(beams, segments, belief, self.grid.canvas.grid, config.transients)
        match = shun_transients(match, corners, beams, transient)
        match, belief = self._grow_map(corners, polygons, match, through, belief)
        belief = self._without_refuted(beams, segments, belief)
        graph = self.rooms.graph()
        matched = match.ids[match.recognised()]
        standing, walls = passing(beams, transient), without_transients(segments, transient)
        grid = self.grid.paint(belief, standing, walls, matched, self.polygons.polygons, graph)
        return SlamOutput(
            self.step_count,
            beams,
            segments,
            corners,
            polygons,
            match,
            belief,
            graph,
            tuple(self.polygons.polygons),
            grid,
            self.diverged,
        )

    def _without_refuted(self, beams: MergedScan, segments: Segments, belief: Belief) -> Belief:
        """The belief without the landmarks that this scan refutes for good; what hung on them is forgotten."""
        gone = refuted(beams, segments, belief, self.features, self.step_count, self.config.transients)
        if not len(gone):
            return belief
        self.filter.remove(gone)
        self.features.state[gone] = int(FeatureState.DEAD)
        forget_jambs(self.rooms.book, gone)
        self.polygons.prune(self.features, self.rooms.graph())
        return self.filter.belief()

    def _localise(self, corners: Corners, polygons: tuple[Polygon, ...], predicted: Belief, through: Ints) -> Match:
        """Recognise corners and correct the filter by them; a covariance no longer positive means divergence."""
        try:
            return self._correct(corners, self._associate(corners, polygons, predicted, through))
        except FilterError:
            self.diverged = True
            return ignored(len(corners))

    def _associate(self, corners: Corners, polygons: tuple[Polygon, ...], predicted: Belief, through: Ints) -> Match:
        view = MapView(self.step_count, predicted, self.features, self.polygons.rings, self.rooms.graph(), through)
        match = self.associator.associate(corners, polygons, view, self.filter)
        return check_match(match, len(corners), len(self.features.state))

    def _correct(self, corners: Corners, match: Match) -> Match:
        """Update the filter with the corners recognised; a place not updated for a while makes it a closure."""
        match = self._without_bodies(corners, match)
        index = match.recognised()
        if not len(index):
            return match
        ids = match.ids[index]
        match = with_closure(match, self._is_closure(ids))
        z, R = corners.measurements(index)
        self.filter.update(z, R, ids, iterate=match.closure)
        return match

    def _without_bodies(self, corners: Corners, match: Match) -> Match:
        """The match without closures by one corner that may be a side of somebody, unless the pose is sure; in place.

        Differs from the paper: its world is static.
        """
        features, doubtful = self.features, np.empty(len(corners), np.int64)
        columns = features.room, features.state, features.last_step, self._oldest()
        count = ends_of_bodies((match.ids, match.decision, match.nis), corners.z, *columns, doubtful)
        for c in doubtful[:count]:
            z, R = corners.measurements(np.array([c]))
            _, S = self.filter.innovation(z, R, match.ids[c : c + 1])
            if max(S[0, 0], z[0, 0] ** 2 * S[1, 1]) > self.config.transients.closure_sigma_m**2:
                match.ids[c], match.decision[c], match.reason[c] = NO_ID, int(Decision.IGNORED), int(Reason.AMBIGUOUS)
        return match

    def _oldest(self) -> int:
        """The first step that counts as lately."""
        return self.step_count - self.config.filter.closure_gap_steps

    def _is_closure(self, ids: Ints) -> bool:
        """True when no landmark of some room among `ids` was updated for `closure_gap_steps`."""
        features, oldest = self.features, self._oldest()
        return room_unseen_since(ids, features.room, features.state, features.last_step, oldest)

    def _grow_map(
        self, corners: Corners, polygons: tuple[Polygon, ...], match: Match, through: Ints, belief: Belief
    ) -> tuple[Match, Belief]:
        """Tracks, landmarks, polygons, doors and rooms after this scan; the match with all its ids, and the belief."""
        dead = forget(self.features, self.step_count, self.config.tracks)
        room = self.rooms.current
        match, ripe = record_sightings(self.features, corners, match, belief, room, self.config.tracks)
        self._adopt(corners, match, ripe)
        self.associator.remember(match)
        mark_seen(self.features, match.ids, self.step_count)
        belief = self.filter.belief() if len(ripe) else belief
        seen = Sighting(corners, match, through, belief, self.step_count)
        moved = self.rooms.update(seen, self.features, self.polygons.polygons)
        graph = self.rooms.graph()
        crowded = self.polygons.remember(polygons, match, self.features, graph, self.step_count)
        pair = self._duplicate(match, belief)
        match = self._fuse(match, pair)
        if dead or moved or pair or crowded:
            self.polygons.prune(self.features, graph)
        return match, self.filter.belief() if pair else belief

    def _watched(self, belief: Belief) -> Belief:
        """The belief; one that is no longer worth anything is noted as divergence."""
        x, y = belief.pose_cov[0, 0], belief.pose_cov[1, 1]
        self.diverged |= not max(x, y) < self.config.filter.diverged_sigma_m**2
        return belief

    def _adopt(self, corners: Corners, match: Match, ripe: Ints) -> None:
        """Tracks seen often enough become landmarks, from this sighting alone: earlier ones were not kept.

        Those that find no room in a full filter are dropped, and counted there.
        """
        if len(ripe):
            z, R = corners.measurements(ripe)
            ids = match.ids[ripe]
            self.filter.augment(z, R, ids)
            accepted = np.array([self.filter.has(int(i)) for i in ids])
            self.features.state[ids] = np.where(accepted, int(FeatureState.LANDMARK), int(FeatureState.DEAD))

    def _duplicate(self, match: Match, belief: Belief) -> tuple[int, int] | None:
        """Two landmarks that are one corner, older and younger."""
        return find_duplicate(self.features, belief, match, self.config.tracks)

    def _fuse(self, match: Match, pair: tuple[int, int] | None) -> Match:
        """Make one landmark of two that are one corner; the match names the one that is kept."""
        if pair is None:
            return match
        keep, drop = pair
        try:
            self.filter.fuse(keep, drop)
        except FilterError:
            self.diverged = True
            return match
        self.features.state[drop] = int(FeatureState.DEAD)
        self.features.seen[keep] += self.features.seen[drop]
        self.features.last_step[keep] = self.step_count
        self.polygons.rename(keep, drop)
        rename_jambs(self.rooms.book, keep, drop)
        return replace(match, ids=np.where(match.ids == drop, keep, match.ids))
