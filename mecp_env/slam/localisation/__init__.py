"""Notice a wrong pose by what the map says about a scan, and find the right one again. Paper: none.

Beams that end in the middle of mapped floor contradict the pose. Pedestrians cause few of them, a wrong pose many.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import compose, inverse, wrap_angle
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import AssociationConfig, LocalisationConfig
from mecp_env.slam.localisation.relocalisation import NOWHERE, Hypothesis, LandmarkIndex, Located, clear_winner
from mecp_env.slam.messages import (
    NO_ID,
    Belief,
    Cell,
    Corners,
    MapView,
    Match,
    MergedScan,
    Polygon,
    Reason,
    SemanticGrid,
)
from mecp_env.slam.protocols import Filter

FREE, OCCUPIED, DOOR = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.DOOR)
REFUSED = int(Reason.REFUSED)
LEAST_POSE_COV = 1e-12 * np.eye(3)  # m^2, rad^2: what has an inverse, where the true pose is given


class Agreement(NamedTuple):
    """What the map says of a scan at a pose."""

    share: float  # of the beams in mapped space that end on a wall; nan where too few end there
    explained: float  # share of all beams that do; nan without any map
    least: float  # share below which the map contradicts the scan

    @property
    def contradicts(self) -> bool:
        """True when the map says that the scan was not taken there."""
        return self.share < self.least

    @property
    def is_strong(self) -> bool:
        """True when the beams agree so well that nothing else need be asked."""
        return self.share >= 0.5 * (1.0 + self.least)


class Evidence(NamedTuple):
    """What speaks for the pose at which a scan was taken."""

    said: Agreement
    recognised: float  # share of the corners that are landmarks; nan where too few are seen to tell
    sharp: bool  # they were recognised at a sharp prediction
    familiar: int = 0  # corners that are landmarks
    sudden: bool = False  # they are less than half as many as in the scan before: odometry may have failed
    many: bool = False  # so many were recognised together that they are no coincidence, even from a rough prediction
    vouched: bool = False  # it has agreed from scan to scan since the pose was sure, not long ago
    tracked: bool = False  # the scan agrees with those of a moment ago: the pose is right where it was then

    @property
    def is_strong(self) -> bool:
        """True for beams that agree well, and for a share of corners recognised at a sharp prediction, or many."""
        return self._is_recognised or self.said.is_strong

    @property
    def is_enough(self) -> bool:
        """True for strong evidence, and for beams that do not contradict while some corner is recognised."""
        some = self.recognised != 0.0 or self.said.least == 0.0  # a least share of 0 asks for nothing
        agrees = some and not self.said.contradicts
        return agrees or self.is_strong

    @property
    def is_silent(self) -> bool:
        """True where too few beams end in mapped space to tell, and no corner is recognised, or too few are seen."""
        return math.isnan(self.said.share) and not self.recognised > 0.0

    @property
    def share(self) -> float:
        """The larger share, of beams or of corners recognised so, if it is enough; else the smaller; nan: neither."""
        if self.is_enough:
            return max(self.said.share, self.recognised) if self._is_recognised else self.said.share
        return min(self.recognised, self.said.share) if self.recognised >= 0.0 else self.said.share

    @property
    def fits(self) -> bool:
        """True when nothing is odd: beams agree well, and corners are recognised where all is mapped, or just was."""
        return self.nearly_fits and (self._is_recognised or not self.sudden or self.said.least == 0.0)

    @property
    def nearly_fits(self) -> bool:
        """The same, whatever has become of the corners of the scan before: the pose is nearly right."""
        odd = self.recognised < self.said.least and self.said.explained >= 0.5 * (1.0 + self.said.least)
        new = math.isnan(self.said.share) and self.recognised != 0.0
        return self.said.least == 0.0 or self._is_recognised or new or (self.said.is_strong and not odd)

    def settles(self, tracked: bool) -> bool:
        """True when nothing else need be tried: all fits, or the scan was `tracked` and the corners are still there."""
        return self.fits or (tracked and not self.sudden)

    def beats(self, other: Evidence) -> bool:
        """True when this is strong, with more corners recognised than by the other, and no fewer beams that agree.

        No fewer of those in mapped space, and no fewer of all: a pose that moves beams off the map explains less.
        """
        fewer = self.said.share < other.said.share or self.said.explained < other.said.explained
        return self.is_strong and self.recognised > other.recognised and not fewer

    def followed(self, tracked: bool, vouched: bool) -> Evidence:
        """The same, with what the window of recent scans says."""
        return Evidence(*self[:6], vouched, tracked)

    def doubted(self) -> Evidence:
        """The evidence of a place that looks like another one: none."""
        return Evidence(self.said._replace(share=0.0), 0.0, sharp=False)

    @property
    def _is_recognised(self) -> bool:
        return (self.sharp or self.many) and self.recognised >= self.said.least


def agreement(beams: MergedScan, T_map_robot: Array, grid: SemanticGrid, reach_m: float, least: float) -> Agreement:
    """What the map says of a scan at this pose (3,): of beams up to `reach_m`, if a share of 1 - `least` is mapped."""
    if not grid.label.size:
        return Agreement(math.nan, math.nan, least)
    floor = grid.label, grid.origin, grid.resolution_m
    walls, floors, count = count_ends(beams.ranges, beams.bearings, beams.hit, T_map_robot, floor, reach_m)
    known = walls + floors > (1.0 - least) * count
    return Agreement(walls / (walls + floors) if known else math.nan, walls / max(count, 1), least)


@compiled
def count_ends(
    ranges: Array,
    bearings: Array,
    hit: Bools,
    T_map_robot: Array,
    floor: tuple[Bytes, Array, float],
    reach_m: float,
) -> tuple[int, int, int]:
    """How many hits end in or beside a cell of wall or door, how many two cells away from all but floor, and of all.

    Every fourth beam is asked, hits beyond `reach_m` are left out; `floor` is labels (H,W), origin and resolution of
    the grid.
    """
    label, origin, resolution = floor
    walls, floors, count = 0, 0, 0
    for i in range(0, ranges.shape[0], 4):
        if not hit[i] or ranges[i] > reach_m:
            continue
        count += 1
        angle = T_map_robot[2] + bearings[i]
        column = math.floor((T_map_robot[0] + ranges[i] * math.cos(angle) - origin[0]) / resolution)
        row = math.floor((T_map_robot[1] + ranges[i] * math.sin(angle) - origin[1]) / resolution)
        if not (2 <= row < label.shape[0] - 2 and 2 <= column < label.shape[1] - 2):
            continue
        wall = False
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                wall |= label[r, c] == OCCUPIED or label[r, c] == DOOR
        clear = not wall
        for r in range(row - 2, row + 3 if clear else row - 2):
            for c in range(column - 2, column + 3):
                clear &= label[r, c] == FREE
        walls, floors = walls + wall, floors + clear
    return walls, floors, count


@dataclass(slots=True, eq=False)
class PoseGuard:
    """Whether the robot is localised, as the map and the scans say.

    A scan that contradicts the map withholds all changes of filter and map; `scans` of them in a row, and the pose is
    searched for in the whole map. One that is found is trusted once so many scans more agree with it.
    """

    config: LocalisationConfig
    reach_m: float  # of what is compared with the grid, and between two landmarks of a pair
    pairing: AssociationConfig
    localised: bool = True
    doubts: int = 0  # scans in a row that contradict the map, and those that were searched with since then
    astray: int = 0  # those of them, in a row, that do not agree with the scans before either
    log_odds: float = 0.0  # of the pose being right, before its covariance is asked
    travelled: float = 0.0  # m that odometry reported since a scan agreed, until the pose was searched for
    turned: float = 0.0  # rad
    correction: Array = field(default_factory=lambda: np.zeros(3))  # (3,) moves the filter's pose to the one found
    agreed: int = 0  # scans that speak for it; 0: none was found
    unmapped: float = 0.0  # m of odometry since a beam ended in mapped space, while the pose was searched for
    resumed: int = 0  # searches that ended without a pose, and mapping went on
    unsure_from: int = NO_ID  # features from this id on were mapped since, and no earlier place was recognised
    familiar: int = 0  # landmarks that were recognised in the last trusted scan
    certain: bool = False  # correspondences are known

    def __post_init__(self) -> None:
        self.log_odds = self.config.sure

    @property
    def is_sure(self) -> bool:
        """True where nothing speaks against the pose since something last spoke for it."""
        return self.localised and not self.doubts

    def follow(self, odometry: Odometry) -> None:
        """Note how far the robot has moved until the pose is searched for, and from then on where nothing is mapped."""
        metres, turn = (sum(map(abs, column)) for column in odometry.increments.T.tolist())
        if self.localised:
            self.travelled, self.turned = self.travelled + metres, self.turned + turn
        else:
            self.unmapped += metres

    def ask(self, beams: MergedScan, belief: Belief, grid: SemanticGrid) -> Agreement:
        """What the map says of a scan at the pose of a belief."""
        return agreement(beams, belief.T_map_robot, grid, self.reach_m, self.config.explained_share)

    def slack(self) -> Array:
        """(3,3) covariance by which a predicted pose is wrong if odometry since the last trusted scan failed."""
        metres, turn = max(self.travelled, 0.0) + self.config.inlier_m, self.turned + self.config.inlier_m
        slack = np.zeros((3, 3))
        slack[0, 0] = slack[1, 1] = metres * metres
        slack[2, 2] = turn * turn
        return slack

    def update(self, estimate: Filter, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        """Correct a filter by pairs z[i] - ids[i]; loosen it before where these say that odometry has failed."""
        if self.config.explained_share and self._has_failed(estimate, z, R, ids):
            estimate.loosen(self.slack())
        estimate.update(z, R, ids, iterate=iterate)

    def _has_failed(self, estimate: Filter, z: Array, R: Array, ids: Ints) -> bool:
        """True where failed odometry is likelier than none, by Bayes' rule with the log-odds of a right pose."""
        return estimate.log_bayes_factor(z, R, ids, self.slack()) > 2.0 * self.config.sure

    def evidence(self, said: Agreement, match: Match, view: MapView, sharp: bool) -> Evidence:
        """What beams and corners say of the pose, after an association at a prediction that was `sharp` or not."""
        seen, found = len(match.ids), match.found
        if self.certain:
            refused = int(np.count_nonzero(match.reason == REFUSED))
            known = found / (found + refused) if found + refused else math.nan
            return Evidence(said, known, sharp, found, sudden=refused > found)
        before = self.familiar >= 2
        tells = seen >= self.config.least_corners - before and len(view.belief.ids) > 0
        share = found / seen if tells else math.nan
        sudden, many = before and tells and 2 * found < self.familiar, self.config.least_corners + self.config.margin
        return Evidence(said, share, sharp, found, sudden, many=found >= many)

    def trusts(self, evidence: Evidence) -> bool:
        """True when the scan may change the map: the robot is localised, and enough speaks for its pose.

        The map may be wrong where a track that is unbroken since the pose was sure contradicts it; one that begins
        elsewhere is that of a robot that was carried.
        """
        if not self.localised:
            self.unmapped = self.unmapped if math.isnan(evidence.said.share) else 0.0
            return False
        self._weigh(evidence.share)
        self._count_doubts(evidence)
        if not self.doubts:
            self.travelled, self.turned, self.familiar = 0.0, 0.0, evidence.familiar
        if self._gives_up(evidence.vouched):
            self.lose()
        return self.is_sure or (self.localised and evidence.vouched)

    def _count_doubts(self, evidence: Evidence) -> None:
        """A doubt stays until something speaks for the pose: a scan that does not contradict it may show new floor."""
        against = not evidence.is_enough
        settled = not against and not (self.doubts and evidence.is_silent)
        self.doubts = 0 if settled else self.doubts + against
        self.astray = 0 if settled or evidence.tracked else self.astray + against

    def _gives_up(self, vouched: bool) -> bool:
        return self.astray >= self.config.scans or (self.doubts >= self.patience and not vouched)

    @property
    def patience(self) -> int:
        """Scans that contradict the map and agree with those before them, but with none whose pose was sure."""
        return 2 * self.config.scans

    def lose(self, anywhere: bool = False) -> None:
        """The pose is wrong; `anywhere`: nothing is known of it, and no pose is near the prediction."""
        self.localised, self.log_odds, self.agreed, self.unmapped = False, -self.config.sure, 0, 0.0
        self.travelled = -math.inf if anywhere else self.travelled

    def trust(self) -> None:
        """The pose is right."""
        self.localised, self.log_odds, self.doubts, self.agreed = True, self.config.sure, 0, 0
        self.astray = 0
        self.travelled = self.turned = 0.0

    def search(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, beams: MergedScan, grid: SemanticGrid
    ) -> Located | None:
        """Where the robot is, once enough scans agree; None before, and in an ambiguous place."""
        if self.localised or not len(view.belief.ids):
            return None
        index, pose = self._index(view), view.belief.T_map_robot
        judge = partial(self._judge, corners=corners, beams=beams, grid=grid, predicted=pose)
        kept = judge(index.look_at(corners, compose(self.correction, pose))) if self.agreed else NOWHERE
        won = clear_winner([*map(judge, index.locate(corners, polygons))], self.config)
        self.agreed = self._count(kept, won)
        found = (won or kept).at
        self.correction = compose(found.T_map_robot, inverse(pose))
        if self.agreed <= self.config.scans:
            return None
        self.trust()
        return found

    def resumes(self, estimate: Filter, features: int) -> bool:
        """True when the search ends without a pose: mapping goes on where odometry says, and is unsure.

        Where the robot has driven so far on unmapped floor that it sees nothing of the map, with the covariance that
        the filter has. In a map of few landmarks after some scans, sooner where no search could succeed; the filter is
        loosened then by what odometry may have been wrong by. What is mapped from now on, after so many `features`, is
        marked. A robot that was put anywhere goes on searching.
        """
        self.doubts += 1
        if self.localised or self.travelled < 0.0:
            return False
        if self._is_hopeless(len(estimate.ids)):
            estimate.loosen(self.slack())
        elif self.unmapped <= self.reach_m:
            return False
        self.trust()
        self.resumed += 1
        self.unsure_from = features if self.unsure_from == NO_ID else self.unsure_from
        return True

    def _is_hopeless(self, landmarks: int) -> bool:
        """True where a search in a map of so few landmarks has taken long enough."""
        least = self.config.least_corners
        patience = self.patience * (2 if landmarks < least else 10)
        return landmarks < 2 * least and self.doubts >= patience

    def settle(self, match: Match) -> int:
        """`unsure_from` after a scan: what was mapped is sure once enough earlier landmarks are recognised."""
        sure = self.unsure_from == NO_ID
        if not sure and np.count_nonzero(match.ids[match.recognised()] < self.unsure_from) >= self.config.least_corners:
            self.unsure_from = NO_ID
        return self.unsure_from

    def is_clear(
        self,
        corners: Corners,
        polygons: tuple[Polygon, ...],
        view: MapView,
        beams: MergedScan,
        grid: SemanticGrid,
        belief: Belief,
    ) -> bool:
        """True when nothing else may be the pose of a belief, as failed odometry may have left it.

        A sharp prediction allows it: odometry need not have failed. Or a search by this scan alone finds it.
        """
        if self.certain or self._expects(view.belief, belief):
            return True
        judge = partial(self._judge, corners=corners, beams=beams, grid=grid, predicted=view.belief.T_map_robot)
        won = clear_winner([*map(judge, self._index(view).locate(corners, polygons))], self.config)
        off = math.dist(won.at.T_map_robot[:2], belief.T_map_robot[:2]) if won else math.inf
        return off < 2.0 * self.config.inlier_m

    def _expects(self, predicted: Belief, belief: Belief) -> bool:
        """True where a sharp prediction allows the pose of a belief."""
        off = belief.T_map_robot - predicted.T_map_robot
        off[2] = wrap_angle(off[2])
        nis = off @ np.linalg.solve(predicted.pose_cov + LEAST_POSE_COV, off)
        return self.pairing.is_sharp(predicted) and bool(nis <= chdtri(3, 1.0 - self.pairing.gate_probability))

    def is_same(self, evidence: Evidence, one: Belief, other: Belief) -> bool:
        """True when beams and corners agree with one pose, and the other is the same place: odometry has not failed.

        That a corner more is recognised there tells nothing: seen on a large floor, where another place explains a scan
        as well, the robot gave up a pose that was right to 2 cm.
        """
        x, y, heading = (one.T_map_robot - other.T_map_robot).tolist()
        agrees = evidence.said.is_strong and not evidence.sudden
        return agrees and max(math.hypot(x, y), abs(wrap_angle(heading))) <= self.config.inlier_m

    def _index(self, view: MapView) -> LandmarkIndex:
        return LandmarkIndex(view, self.config, self.reach_m, self.pairing)

    def _weigh(self, share: float) -> None:
        """Bayes' rule: each scan adds its log-likelihood ratio."""
        if not math.isnan(share):
            gain = self.config.weight * (share - self.config.explained_share)
            self.log_odds = min(max(self.log_odds + gain, -self.config.sure), self.config.sure)

    def _count(self, kept: Hypothesis, won: Hypothesis | None) -> int:
        """Scans that speak for the pose found, after one that says `kept` of it and has `won` as its own."""
        agreed = self.agreed if kept.is_sound(self.config) else 0
        if won is None:
            return agreed
        return agreed + 1 if agreed and not won.at.differs_from(kept.at) else 1

    def confidence(self, belief: Belief) -> float:
        """Probability that the position error is below `error_m`."""
        variance = 0.5 * float(belief.pose_cov[0, 0] + belief.pose_cov[1, 1])
        near = -math.expm1(-0.5 * self.config.error_m**2 / variance) if variance > 0.0 else 1.0
        return near / (1.0 + math.exp(-self.log_odds))

    def _judge(
        self, at: Located, corners: Corners, beams: MergedScan, grid: SemanticGrid, predicted: Array
    ) -> Hypothesis:
        """A pose with what the map says of the scan there; without a grid the corners speak alone.

        It is near when odometry that was wrong as much as it reported, and no more, is all between it and `predicted`.
        """
        said = agreement(beams, at.T_map_robot, grid, self.reach_m, self.config.explained_share)
        recognised = (len(corners) - at.misfit) / max(len(corners), 1)
        explained = recognised if math.isnan(said.explained) else said.explained
        (x, y, heading), slack = at.T_map_robot - predicted, self.config.inlier_m
        near = math.hypot(x, y) < self.travelled + slack and abs(wrap_angle(heading)) < self.turned + slack
        return Hypothesis(at, said.share, explained, recognised, near)
