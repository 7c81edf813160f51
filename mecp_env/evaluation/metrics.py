"""Metrics of an episode, measured on ground truth. The agent receives them through `info` only."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.intervals import budget_m
from mecp_env.core.se2 import compose, inverse, to_map
from mecp_env.evaluation import metric_arrays
from mecp_env.evaluation.ground_truth import (
    NO_OBSTACLES,
    DynamicObstacles,
    GroundTruth,
    MapQuality,
    cells_at,
    correct_coverage,
    covers,
    door_error,
    doors_found,
    grid_iou,
    rooms_found,
)
from mecp_env.evaluation.metric_arrays import LostWatch
from mecp_env.slam.messages import Belief
from mecp_env.slam.output import SlamOutput

NEVER = 2**40  # a step that never comes
SWEEP_STEP_M = 0.4  # the visible area is computed again after this motion
MAP_STEPS = 25  # the map is compared with ground truth this often; rooms and doors also when one is new


@dataclass(slots=True, eq=False)
class AssociationLog:
    """Pairs of true corner and feature, scan by scan (derivations 3.4)."""

    true_corners: int
    votes: NDArray[np.int32] = field(init=False)  # (F,G) how often feature f was seen as true corner g
    features: Ints = field(init=False)  # (F,2) majority so far or -1; step in which it became a landmark, or NEVER
    counts: Ints = field(init=False)  # (4,) TP, FP, FN, TN by the majority at the time
    rows: Ints = field(init=False)  # (capacity,4) step, true corner or -1, feature or -1, matched to a landmark
    used: int = 0

    def __post_init__(self) -> None:
        self.votes = np.zeros((64, self.true_corners), np.int32)
        self.features = np.tile(np.array([-1, NEVER]), (64, 1))
        self.counts = np.zeros(4, np.int64)
        self.rows = np.zeros((1024, 4), np.int64)

    def record(self, output: SlamOutput, truth: Ints) -> None:
        """Add a scan whose corners have the true identities `truth` (n,)."""
        match, landmarks = output.match, output.belief.ids
        rows = self._new_rows(len(match.ids))
        rows[:, 1] = truth
        scan = match.ids, match.decision, landmarks, output.step
        most = metric_arrays.score_scan(self.votes, self.features, rows, self.counts, *scan)
        if most >= len(self.features):
            self._reserve(most)
            metric_arrays.score_scan(self.votes, self.features, rows, self.counts, *scan)

    def duplicates(self, landmarks: Ints) -> int:
        """How many of the landmarks (N,) are of a true corner that another landmark is of already."""
        corners = self.features[landmarks, 0]
        known = corners[corners >= 0].tolist()
        return len(known) - len(set(known))

    def corners_of(self, landmarks: Ints) -> Ints:
        """(N,) the true corner that each of the landmarks (N,) is of, -1 for one that was never seen at any."""
        known = landmarks < len(self.features)
        return np.where(known, self.features[np.where(known, landmarks, 0), 0], -1)

    def final_counts(self) -> Ints:
        """(4,) TP, FP, FN, TN of all scans by what each feature turned out to be."""
        step, truth, feature, matched = self.rows[: self.used].T
        real, hit = truth >= 0, matched.astype(np.bool_)
        identity, since = self.features.T
        first = np.full(self.true_corners + 1, NEVER)  # step of the first landmark of each true corner
        np.minimum.at(first, identity, since)
        right = real & (feature >= 0) & (identity[feature] == truth)
        missed = real & (first[truth] < step) & ~((feature >= 0) & (since[feature] < step))  # a post is only named
        return np.array([(hit & right).sum(), (hit & ~right).sum(), (~hit & missed).sum(), (~hit & ~missed).sum()])

    def _reserve(self, most: int) -> None:
        """Make room for features up to the id `most`."""
        while len(self.features) <= most:
            self.votes = np.concatenate([self.votes, np.zeros_like(self.votes)])
            self.features = np.concatenate([self.features, np.full_like(self.features, (-1, NEVER))])

    def _new_rows(self, count: int) -> Ints:
        """The next rows (count,4) at the end of the log, still to be written."""
        first, self.used = self.used, self.used + count
        if self.used > len(self.rows):
            self.rows = np.concatenate([self.rows, np.zeros_like(self.rows)])
        return self.rows[first : self.used]


@dataclass(slots=True, eq=False)
class EpisodeMetrics:
    """The ground-truth metrics of one episode, updated every step; plain state."""

    T_world_map: Array  # (3,) true pose at reset: origin of the map frame
    T_map_robot: Array  # (3,) true pose in the map frame
    seen: Bools  # (H,W) free cells the robot has seen
    association: AssociationLog
    max_steps: int = 1  # limit of the episode, for means over it
    swept_from: Array = field(default_factory=lambda: np.full(2, np.inf))  # (2,) m, world
    seen_cells: int = 0
    seen_over_steps: int = 0  # sum of `seen_cells` over the control steps
    new_cells: int = 0  # seen for the first time in this step
    steps: int = 0
    contacts: int = 0  # steps with a contact
    metres: float = 0.0
    pose_error_m: float = 0.0
    heading_error_rad: float = 0.0
    nees: float = 0.0  # of the pose, 3 degrees of freedom
    lost: LostWatch = field(default_factory=LostWatch)
    squared_error_sum: float = 0.0
    worst_error_m: float = 0.0
    nees_sum: float = 0.0
    rooms: tuple[int, int] = (0, 0)  # found, false
    doors: tuple[int, int] = (0, 0)  # found, false
    quality: MapQuality = field(default_factory=MapQuality)
    compared_rooms: tuple[int, ...] = ()
    compared_doors: int = 0
    visited_by_obstacles: Bools = field(
        default_factory=lambda: np.zeros((0, 0), np.bool_)
    )  # (H,W) visited by dynamic obstacles

    @classmethod
    def begin(
        cls, truth: GroundTruth, T_world_robot: Array, obstacles: DynamicObstacles = NO_OBSTACLES, max_steps: int = 1
    ) -> EpisodeMetrics:
        """The metrics of an episode of at most `max_steps` from the true pose (3,) with dynamic obstacles."""
        log = AssociationLog(len(truth.outline.corners) + len(obstacles.corners))
        return cls(T_world_robot.copy(), np.zeros(3), np.zeros_like(truth.free), log, max_steps)

    def look(
        self, truth: GroundTruth, T_world_robot: Array, output: SlamOutput, obstacles: DynamicObstacles = NO_OBSTACLES
    ) -> None:
        """Update with the SLAM output at the true pose (3,) with dynamic obstacles."""
        self.T_map_robot = self.in_map(T_world_robot)
        self._sweep(truth, T_world_robot)
        self.association.record(output, truth.identify(output.corners, T_world_robot, obstacles))
        self._mark_obstacles(truth, obstacles.walking)
        self._compare_pose(output.belief)
        self.compare_map(truth, output, due=output.step % MAP_STEPS == 0)

    def move(self, truth: GroundTruth, increments: Array, contact: bool) -> None:
        """Count one control step: the true increments (M,2) of the body and whether it touched something."""
        self.steps += 1
        self.seen_over_steps += self.seen_cells
        self.contacts += contact
        metres = 0.0
        for distance in increments[:, 0].tolist():
            metres += abs(distance)
        self.metres += metres
        self.quality.drive(metres, budget_m(truth.free_cells * metric_arrays.CELL_M**2))

    def coverage(self, truth: GroundTruth) -> float:
        """Share of the true free area that the robot has seen."""
        return self.seen_cells / truth.free_cells

    def misplaced_m2(self, truth: GroundTruth) -> float:
        """m^2 of the floor that the robot has seen, but that the map did not have in its place when last compared."""
        share = max(0.0, self.coverage(truth) - self.quality.correct_coverage)
        return share * truth.free_cells * metric_arrays.CELL_M**2

    def over_limits(self, truth: GroundTruth) -> dict[str, float]:
        """Mean coverage and correct coverage over the step limit, and the latter over the metres of `budget_m`.

        After the last step they hold: a mean until now would favour an episode that ends early with little.
        """
        left, quality = max(0, self.max_steps - self.steps), self.quality
        most_m = budget_m(truth.free_cells * metric_arrays.CELL_M**2)
        seen = self.seen_over_steps + left * self.seen_cells
        over_steps = quality.over_steps + left * quality.correct_coverage
        over_metres = quality.over_metres + (most_m - quality.metres) * quality.correct_coverage
        return {
            "coverage_over_steps": seen / (self.max_steps * truth.free_cells),
            "correct_coverage_over_steps": over_steps / self.max_steps,
            "correct_coverage_over_metres": over_metres / most_m,
        }

    def in_map(self, T_world_robot: Array) -> Array:
        """A pose (3,) of the world in the map frame."""
        return compose(inverse(self.T_world_map), T_world_robot)

    def _sweep(self, truth: GroundTruth, T_world_robot: Array) -> None:
        self.new_cells = 0
        x, y, _ = T_world_robot.tolist()
        if not truth.sees_all_around or math.dist(self.swept_from.tolist(), (x, y)) >= SWEEP_STEP_M:
            self.swept_from = np.array([x, y])
            self.new_cells = int(truth.sweep(T_world_robot, self.seen))
            self.seen_cells += self.new_cells

    def _mark_obstacles(self, truth: GroundTruth, walking: Array) -> None:
        """Record the dynamic obstacles (n,3) m: position and radius."""
        if not len(walking):
            return
        if not self.visited_by_obstacles.size:
            self.visited_by_obstacles = np.zeros_like(truth.free)
        metric_arrays.mark_discs(self.visited_by_obstacles, truth.corner, walking)

    def landmarks_on_movers(self, truth: GroundTruth, belief: Belief) -> int:
        """How many landmarks lie within 0.15 m of where something that moves has been, and never were a true corner.

        An upper bound: a corner misjudged on a wall that people pass counts, too.
        """
        if not self.visited_by_obstacles.size or not len(belief.ids):
            return 0
        p_world = to_map(self.T_world_map, np.ascontiguousarray(belief.p_map))
        nameless = self.association.features[belief.ids, 0] < 0
        cells = self.visited_by_obstacles
        return int(cells_at(cells, truth.corner, metric_arrays.CELL_M, p_world[nameless], False).sum())

    def map_error(self, truth: GroundTruth, belief: Belief) -> tuple[float, int]:
        """RMSE (m) of the landmarks from their true corners, 0 without one, and how many are of no true corner.

        Corners of boxes, which move, count for neither. Measured in the map frame, which is where the robot believed to
        start: nothing is fitted, so that a map that slides off counts.
        """
        corner, true = self.association.corners_of(belief.ids), truth.outline.corners.p_world
        fixed = (corner >= 0) & (corner < len(true))
        away = to_map(self.T_world_map, np.ascontiguousarray(belief.p_map))[fixed] - true[corner[fixed]]
        rmse = math.sqrt(float(np.mean(np.hypot(away[:, 0], away[:, 1]) ** 2))) if fixed.any() else 0.0
        return rmse, int((corner < 0).sum())

    def _compare_pose(self, belief: Belief) -> None:
        errors = metric_arrays.pose_errors(self.T_map_robot, belief.T_map_robot, belief.pose_cov)
        self.pose_error_m, self.heading_error_rad, self.nees = errors
        self.lost.look(self.pose_error_m, self.heading_error_rad)
        self.squared_error_sum += self.pose_error_m**2
        self.nees_sum += self.nees
        self.worst_error_m = max(self.worst_error_m, self.pose_error_m)

    def compare_map(self, truth: GroundTruth, output: SlamOutput, due: bool) -> None:
        """Compare rooms and doors with ground truth when one is new, and the whole map when `due`."""
        if due:
            self.quality.correct_coverage = correct_coverage(truth.floor_and_walls, output.grid, self.T_world_map)
            self.quality.map_error_m, _ = self.map_error(truth, output.belief)
        if due or output.graph.rooms != self.compared_rooms:
            self.compared_rooms = output.graph.rooms
            self.rooms = rooms_found(truth, output, self.T_world_map)
        if due or len(output.graph.doors) != self.compared_doors:
            self.compared_doors = len(output.graph.doors)
            self.doors = doors_found(truth, output, self.T_world_map)

    def summary(self, truth: GroundTruth, output: SlamOutput) -> dict[str, float]:
        """The metrics of the episode until now; lengths in metres, NEES of 3 degrees of freedom (3 expected)."""
        tp, fp, fn, _ = (int(count) for count in self.association.final_counts())
        rooms, rooms_false = rooms_found(truth, output, self.T_world_map)
        doors, doors_false = doors_found(truth, output, self.T_world_map)
        polygon_cover, grid_cover = covers(truth, output.grid, self.T_world_map)
        map_rmse_m, landmarks_false = self.map_error(truth, output.belief)
        looks = max(1, output.step)
        return {
            "periods": self.steps,
            "metres": self.metres,
            "contacts": self.contacts,
            "coverage": self.coverage(truth),
            "correct_coverage": correct_coverage(truth.floor_and_walls, output.grid, self.T_world_map),
            **self.over_limits(truth),
            "free_area_m2": truth.free_cells * metric_arrays.CELL_M**2,
            "rooms": len(truth.outline.rooms),
            "rooms_found": rooms,
            "rooms_false": rooms_false,
            "doors": len(truth.outline.doors),
            "doors_found": doors,
            "doors_false": doors_false,
            "door_error_m": door_error(truth, output, self.T_world_map),
            "polygon_cover": polygon_cover,
            "grid_cover": grid_cover,
            "grid_iou": grid_iou(truth, output.grid, self.T_world_map),
            "pose_rmse_m": math.sqrt(self.squared_error_sum / looks),
            "pose_error_final_m": self.pose_error_m,
            "pose_error_worst_m": self.worst_error_m,
            "heading_error_final_rad": self.heading_error_rad,
            "nees_mean": self.nees_sum / looks,
            "lost": self.lost.is_lost(output.diverged),
            "map_rmse_m": map_rmse_m,
            "landmarks": len(output.belief.ids),
            "landmarks_false": landmarks_false,
            "duplicates": self.association.duplicates(output.belief.ids),
            "landmarks_on_movers": self.landmarks_on_movers(truth, output.belief),
            "association_precision": share(tp, fp),
            "association_recall": share(tp, fn),
            "association_false": fp,
            "association_pairs": tp + fp,
        }


def figures(metrics: EpisodeMetrics, truth: GroundTruth, output: SlamOutput) -> dict[str, float]:
    """The metrics of this step, cheap enough for every step; association counts use the majority until now."""
    tp, fp, fn, tn = metrics.association.counts.tolist()
    return {
        "coverage": metrics.coverage(truth),
        "correct_coverage": metrics.quality.correct_coverage,  # every 25 steps
        **metrics.over_limits(truth),
        "map_error_m": metrics.quality.map_error_m,  # every 25 steps
        "pose_error_m": metrics.pose_error_m,
        "heading_error_rad": metrics.heading_error_rad,
        "nees": metrics.nees,
        "landmarks": len(output.belief.ids),
        "duplicates": metrics.association.duplicates(output.belief.ids),
        "association_tp": tp,
        "association_fp": fp,
        "association_fn": fn,
        "association_tn": tn,
        "rooms": len(truth.outline.rooms),
        "rooms_found": metrics.rooms[0],
        "rooms_false": metrics.rooms[1],
        "doors": len(truth.outline.doors),
        "doors_found": metrics.doors[0],
        "doors_false": metrics.doors[1],
        "contacts": metrics.contacts,
        "metres": metrics.metres,
    }


def share(part: int, rest: int) -> float:
    """part / (part + rest); 1 where there is neither."""
    return part / (part + rest) if part + rest else 1.0
