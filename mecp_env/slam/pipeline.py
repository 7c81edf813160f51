"""The estimator, in the paper's order: extract features, find polygons, associate, filter, map (III)."""

from __future__ import annotations

from mecp_env.core.sensors import Odometry, Scan
from mecp_env.slam.association import ignored
from mecp_env.slam.checks import check_odometry, check_scan
from mecp_env.slam.custom import BegunStep
from mecp_env.slam.filters.mounting import predict_mounted, robot_belief
from mecp_env.slam.frontend import front_end
from mecp_env.slam.grid.key_scans import seen_floor
from mecp_env.slam.localisation import Evidence
from mecp_env.slam.mecp import find_structure
from mecp_env.slam.messages import Belief, Corners, Decision, MapView, Match, Reason, ScanFeatures, Sighting
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.panorama.surroundings import Surroundings
from mecp_env.slam.parts import SlamParts

Attempt = tuple[Match, Match, Evidence]  # of the associator, what updated the filter, and what speaks for the pose


class SlamPipeline(SlamParts):
    """EKF-SLAM with MECP data association over odometry and laser scans.

    The map frame is the robot's pose at `start`. `config` may be a dict, or None for the defaults. `associator` and
    `filter` replace the parts that `config` names; upper bounds inject ground truth by them (`OracleAssociator`,
    `OraclePoseFilter`).
    """

    __slots__ = ()

    def start(self, scan: Scan) -> SlamOutput:
        """The output for a scan taken at rest: the first ones belong to the start pose, before any motion.

        Raises `SensorError` for an invalid scan, `MatchError` for an invalid match of a custom associator, and
        `FilterError` for an unsound belief of a custom filter. After these, the estimator is as it was before.
        """
        check_scan(scan, self.config.sensor.field_of_view_rad)
        return self._observe(scan, self.begin_step())

    def step(self, odometry: Odometry, scan: Scan) -> SlamOutput:
        """The output of one control step: the motion, then the scan at its end. Raises as `start` does."""
        check_odometry(odometry)
        check_scan(scan, self.config.sensor.field_of_view_rad)
        with self.begin_step() as begun:
            predict_mounted(self.filter, odometry, self.config.sensor)
            self.guard.follow(odometry)
        return self._observe(scan, begun)

    def _observe(self, scan: Scan, begun: BegunStep) -> SlamOutput:
        with begun:
            scanned = front_end(scan, self.config)  # III-A.1
            tracked = self.register(scanned)
            untouched, predicted, graph = self.filter, self.believed("predict"), self.rooms.graph()
            corners, through = self.rooms.mark_beyond(scanned.corners, predicted)
            corners = self._with_linearisation(corners, predicted)
            around = self.recent.around(scanned.with_corners(corners), graph, self.map.features, self.filter)
            around = around.with_polygons(find_structure(*around.place, self.config.polygon, around.wall))  # III-A.2
            view = self.map.view(predicted, graph, around.widen_column(through), self.step_count, around.past)
            associated, updated, evidence = self._localise(around, view, tracked)  # III-B
            belief, still = self.watched(), None
            if self.guard.trusts(evidence.followed(tracked, self.recent.vouched)):
                seen = Sighting(corners, updated, through, belief, self.step_count)
                match, belief, still = self._map_scan(around, seen, evidence.sharp)  # III-B.1
            else:
                self.filter = untouched
                match, belief = self._relocalise(around, view)
        graph = self.rooms.graph()
        if still is not None:
            floor, landmarks = seen_floor(still.beams, self.config.sensor), match.ids[match.recognised()]
            self.grid.paint(belief, floor, still.segments, landmarks, self.map.polygons.polygons, graph)
        return SlamOutput(
            *(self.step_count, scanned.beams, scanned.segments, corners, around.polygons, associated, match),
            *(robot_belief(belief, self.config.sensor), graph, tuple(self.map.polygons.polygons)),
            *(self.grid.canvas.grid, self.divergence.found, self.config.sensor.T_robot_laser),
            *(self.guard.confidence(belief), self.guard.localised, around.shown),
            *(self.guard.settle(match), self.grid.scans.T_map_robot, self.grid.scans.room),
        )

    def _with_linearisation(self, corners: Corners, predicted: Belief) -> Corners:
        """The corners with what one linearisation at the prediction neglects; at a rough one the update is iterated."""
        once = self.config.filter.second_order and self.config.association.is_sharp(predicted)
        return corners.with_linearisation(predicted.pose_cov) if once else corners

    def _localise(self, around: Surroundings, view: MapView, tracked: bool) -> Attempt:
        """The match of the associator, the part of it that updated the filter, and what speaks for the pose.

        Where the prediction does not fit the map, a copy of the filter is updated; where little speaks for the pose
        even then, another one that assumes that odometry has failed, unless the scan was `tracked` from recent ones.
        """
        predicted, sharp = self.filter, self.config.association.is_sharp(view.belief)
        match = self._associate(around, view)
        said = self.guard.ask(around.scan.beams, view.belief, self.grid.canvas.grid)
        expected = self.guard.evidence(said, match, view, sharp)
        if expected.fits or not self.guard.localised:
            return match, self._update(around.scan.corners, match, iterate=not sharp), expected
        self.filter = predicted.copy()
        first = self._attempt(around, view, match, sharp)
        if first[2].settles(tracked):
            return first
        tried, self.filter = self.filter, predicted.copy()
        self.filter.loosen(self.guard.slack())
        again = self._attempt(around, view, self._associate(around, view.at(self.filter.belief())), sharp=False)
        if not again[2].beats(first[2]) or self.guard.is_same(first[2], tried.belief(), self.filter.belief()):
            self.filter = tried
            return first
        if not (first[2].nearly_fits or self._is_clear(around, view)):
            return *again[:2], again[2].doubted()
        self.recent.forget(self.filter)
        return again

    def _attempt(self, around: Surroundings, view: MapView, match: Match, sharp: bool) -> Attempt:
        """Update the filter with a match; the match, what updated the filter, and what speaks for the pose."""
        updated = self._update(around.scan.corners, match, iterate=not sharp)
        said = self.guard.ask(around.scan.beams, self.filter.belief(), self.grid.canvas.grid)
        return match, updated, self.guard.evidence(said, match, view, sharp)

    def _is_clear(self, around: Surroundings, view: MapView) -> bool:
        """True when the prediction allows the pose of the filter, or a search by this scan alone finds it."""
        beams, grid = around.scan.beams, self.grid.canvas.grid
        return self.guard.is_clear(around.corners, around.polygons, view, beams, grid, self.filter.belief())

    def _associate(self, around: Surroundings, view: MapView) -> Match:
        """The match of the associator; nothing while the pose is searched for."""
        if not self.guard.localised:
            return ignored(len(around.scan.corners), Reason.NOT_LOCALISED)
        with self.divergence:
            return around.narrow(self.ask_associator(around.corners, around.polygons, view))
        return ignored(len(around.scan.corners), Reason.NOT_LOCALISED)

    def _update(self, corners: Corners, match: Match, iterate: bool) -> Match:
        """Update the filter with all recognised corners at once; the match, or nothing where the filter diverges."""
        recognised = match.recognised()
        with self.divergence:
            if len(recognised):
                self.correct(*corners.measurements(recognised), match.ids[recognised], iterate)
            return match
        return ignored(len(corners), Reason.NOT_LOCALISED)

    def _relocalise(self, around: Surroundings, view: MapView) -> tuple[Match, Belief]:
        """Search for the pose, as long as it is not trusted; what the scan was matched to, and the belief then."""
        match = ignored(len(around.corners), Reason.NOT_LOCALISED)
        found = self.guard.search(around.corners, around.polygons, view, around.scan.beams, self.grid.canvas.grid)
        if found is not None or self.guard.resumes(self.filter, len(self.map.features)):
            self.recent.forget(self.filter)
        if found is not None:
            match = match.assign(found.corners, found.ids, int(Decision.LANDMARK), int(Reason.RELOCALISED))
            self.filter.set_pose(found.T_map_robot, found.cov)
            self._update(around.scan.corners, around.narrow(match), iterate=True)
            self.rooms.arrive_at(found.ids, self.map.features)
            self.map.forget_tracks(self.step_count, self.rooms.resolve)
        self.recent.remember(around.scan, around.narrow(match), self.rooms.graph(), self.filter, self.guard.is_sure)
        return around.narrow(match), self.filter.belief()

    def _map_scan(self, around: Surroundings, seen: Sighting, sharp: bool) -> tuple[Match, Belief, ScanFeatures]:
        """Landmarks, rooms and polygons after this scan; its match with all ids, the belief, and what is still."""
        beams, segments = around.scan.beams, around.scan.segments
        dynamic = self.dynamic_objects.find(beams, seen.belief, self.grid.canvas.grid)
        static = self.dynamic_objects.reject(seen.match, seen.corners, beams, dynamic)
        seen = self._extend_map(seen.with_match(static), around, wide=not sharp)
        belief, pruned = self.map.prune(beams, segments, seen, self.filter, self.rooms.resolve)
        self.rooms.forget(pruned, seen.belief)
        painted = self.dynamic_objects.without(beams, segments, dynamic)
        still = ScanFeatures(*painted, around.scan.corners, around.scan.wall)
        self.recent.remember(still, seen.match, self.rooms.graph(), self.filter, self.guard.is_sure)
        return seen.match, self.believed("augment, fuse or remove", belief), still

    def _extend_map(self, seen: Sighting, around: Surroundings, wide: bool) -> Sighting:
        """Tracks, landmarks, doors, rooms and polygons after this scan; the sighting with all its ids."""
        seen, confirmed = self.map.track(seen, self.rooms.graph(), wide)
        self.associator.remember(around.widen(seen.match))
        seen = self.map.initialise(seen, confirmed, self.filter)
        moved = self.rooms.update(seen, self.map.features, self.map.polygons.polygons)
        self.map.link(around.polygons, seen.with_match(around.widen(seen.match)), self.rooms.graph(), moved)
        with self.divergence:
            seen, merged = self.map.merge(seen, self.filter)
            self.rooms.rename(merged)
        return seen
