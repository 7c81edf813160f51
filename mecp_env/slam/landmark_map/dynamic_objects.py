"""Dynamic objects: what is where the map has seen free floor has moved there, and no corner of it is a landmark.

Differs from the paper: its world is static. A run of beams that end on floor seen free before, well away from all that
is not free, comes from something that moved in since; a line fitted to such beams is not a wall, and none is painted
where they end. In a static world every hit is on a wall, beside which the map has no free floor: nothing is dynamic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mecp_env.core.array_types import Array, Bools, Bytes, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.slam.config import DynamicObjectsConfig
from mecp_env.slam.landmark_map.tracks import room_unseen_since
from mecp_env.slam.messages import (
    NO_ID,
    Belief,
    Cell,
    Corners,
    Decision,
    FeatureTable,
    Match,
    MergedScan,
    Reason,
    Segments,
    SemanticGrid,
)
from mecp_env.slam.protocols import Filter

FREE, DOOR = int(Cell.FREE), int(Cell.DOOR)
NEW, RECOGNISED = int(Decision.NEW), int(Decision.LANDMARK)


@dataclass(frozen=True, slots=True, eq=False)
class DynamicObjects:
    """The stage for a world where things move; beams (B,) are marked, None stands for none."""

    config: DynamicObjectsConfig

    def reject_closures(
        self, match: Match, corners: Corners, features: FeatureTable, landmark_filter: Filter, oldest: int
    ) -> Match:
        """The match without loop closures by one corner that may be a side of a pedestrian, unless the pose is sure."""
        columns = match.ids, match.decision, match.nis
        doubtful = find_lone_closures(*columns, corners.z, features.rows, self.config.record, oldest)
        unsure = [c for c in doubtful.tolist() if not self._is_sure(corners, match.ids, c, landmark_filter)]
        return match.assign(unsure, NO_ID, int(Decision.IGNORED), int(Reason.AMBIGUOUS)) if unsure else match

    def _is_sure(self, corners: Corners, ids: Ints, corner: int, landmark_filter: Filter) -> bool:
        z, R = corners.measurements(np.array([corner]))
        _, S = landmark_filter.innovation(z, R, ids[corner : corner + 1])
        sure: bool = max(S[0, 0], z[0, 0] ** 2 * S[1, 1]) <= self.config.closure_sigma_m**2
        return sure

    def find(self, beams: MergedScan, belief: Belief, grid: SemanticGrid) -> Bools | None:
        """(B,) the beams that end on something on floor that the map has seen free."""
        if not grid.label.size:
            return None
        pose_cov, limits = np.ascontiguousarray(belief.pose_cov), self.config.record
        floor = grid.label, grid.origin, grid.resolution_m
        marked = mark_dynamic(beams.ranges, beams.bearings, beams.hit, belief.T_map_robot, pose_cov, floor, limits)
        return whole_bodies(beams.ranges, beams.bearings, beams.hit, marked, limits) if len(marked) else None

    def reject(self, match: Match, corners: Corners, beams: MergedScan, dynamic: Bools | None) -> Match:
        """The match in which new corners near dynamic beams are ignored."""
        if dynamic is None or not len(corners):
            return match
        near = near_dynamic(corners.z, match.decision, beams.ranges, beams.bearings, dynamic, self.config.record)
        return match.assign(near, NO_ID, int(Decision.IGNORED), int(Reason.DYNAMIC)) if len(near) else match

    def without(self, beams: MergedScan, segments: Segments, dynamic: Bools | None) -> tuple[MergedScan, Segments]:
        """Beams and segments to paint: free floor up to dynamic objects, no wall there."""
        if dynamic is None:
            return beams, segments
        return beams.with_hits(beams.hit & ~dynamic), without_dynamic(segments, dynamic)


class StaticWorld(DynamicObjects):
    """The paper's world, where nothing moves: the stage does nothing."""

    def reject_closures(
        self, match: Match, corners: Corners, features: FeatureTable, landmark_filter: Filter, oldest: int
    ) -> Match:
        return match

    def find(self, beams: MergedScan, belief: Belief, grid: SemanticGrid) -> Bools | None:
        return None


def make_dynamic_objects(config: DynamicObjectsConfig) -> DynamicObjects:
    """The stage that `config` describes."""
    return DynamicObjects(config) if config.margin_m else StaticWorld(config)


def without_dynamic(segments: Segments, dynamic: Bools) -> Segments:
    """The segments but for those of whose beams more than half are dynamic."""
    first, last = segments.first, segments.last
    before = np.concatenate(([False], dynamic, dynamic)).cumsum()  # dynamic beams before each; twice, as runs wrap
    kept = 2 * (before[last + segments.roll + 1] - before[first + segments.roll]) <= last - first + 1
    if kept.all():
        return segments
    places = segments.points[kept], segments.line[kept], segments.cov[kept]
    return Segments(*places, segments.cluster[kept], first[kept], last[kept], segments.roll)


@compiled
def find_lone_closures(ids: Ints, decision: Ints, nis: Array, z: Array, rows: Rows, config: Rows, oldest: int) -> Ints:
    """(c,) corners that alone recognise a room unseen since `oldest`, and may be one of the two sides of a pedestrian.

    That is a corner that fits its landmark badly, or that has another one, no landmark, as far away as a pedestrian is
    wide. `ids`, `decision`, `nis` (n,) are those of the match, z (n,2) of the corners.
    """
    limits, doubtful, count = config[0], np.empty(z.shape[0], np.int64), 0
    for c in range(z.shape[0]):
        alone, beside = decision[c] == RECOGNISED, nis[c] > limits.closure_nis
        for k in range(z.shape[0] if alone else 0):
            if decision[k] == RECOGNISED:
                alone &= k == c or rows[ids[k]].room != rows[ids[c]].room
                continue
            square = z[c, 0] ** 2 + z[k, 0] ** 2 - 2.0 * z[c, 0] * z[k, 0] * math.cos(z[c, 1] - z[k, 1])
            beside |= limits.width_m[0] ** 2 < square < limits.width_m[1] ** 2
        if alone and beside and room_unseen_since(ids[c : c + 1], rows, oldest):
            doubtful[count] = c
            count += 1
    return doubtful[:count]


@compiled
def mark_dynamic(
    ranges: Array,
    bearings: Array,
    hit: Bools,
    T_map_robot: Array,
    pose_cov: Array,
    floor: tuple[Bytes, Array, float],
    config: Rows,
) -> Bools:
    """(B,) the hits in runs of beams that end on floor; (0,) without any.

    `floor` is the labels (H,W), the origin and the resolution of the grid.
    """
    limits, dynamic, found = config[0], np.zeros(ranges.shape[0], np.bool_), False
    x, y, heading = T_map_robot
    place_sigma = math.sqrt(max(pose_cov[0, 0] + pose_cov[1, 1], 0.0))
    turn_sigma, run = math.sqrt(max(pose_cov[2, 2], 0.0)), 0
    for i in range(ranges.shape[0]):
        sigma = place_sigma + ranges[i] * turn_sigma
        on_floor = hit[i]
        if on_floor:
            p_x, p_y = x + ranges[i] * math.cos(heading + bearings[i]), y + ranges[i] * math.sin(heading + bearings[i])
            on_floor = is_floor(floor, p_x, p_y, limits.margin_m + limits.sigmas * sigma)
        run = run + 1 if on_floor else 0
        if run >= limits.beams:
            found = True
            for k in range(limits.beams):
                dynamic[i - k] = True
    return dynamic if found else dynamic[:0]


@compiled
def is_floor(floor: tuple[Bytes, Array, float], x: float, y: float, margin: float) -> bool:
    """True when every cell within `margin` of (x, y) is known to be free."""
    label, origin, resolution = floor
    column, row, near = (x - origin[0]) / resolution, (y - origin[1]) / resolution, margin / resolution
    low_r, high_r, low_c, high_c = math.floor(row - near), math.floor(row + near), 0, 0
    low_c, high_c = math.floor(column - near), math.floor(column + near)
    if low_r < 0 or low_c < 0 or high_r >= label.shape[0] or high_c >= label.shape[1]:
        return False
    centre = label[math.floor(row), math.floor(column)]
    if centre != FREE and centre != DOOR:
        return False
    for r in range(low_r, high_r + 1):
        for c in range(low_c, high_c + 1):
            if label[r, c] != FREE and label[r, c] != DOOR and math.hypot(c + 0.5 - column, r + 0.5 - row) < near:
                return False
    return True


@compiled
def whole_bodies(ranges: Array, bearings: Array, hit: Bools, marked: Bools, config: Rows) -> Bools:
    """(B,) the marked beams, and those beside each run of them that end near its middle: the rim of the same body."""
    size, whole = ranges.shape[0], marked.copy()
    for i in range(size):
        if not marked[i] or marked[i - 1]:
            continue
        count, x, y = 0, 0.0, 0.0
        while count < size and marked[(i + count) % size]:
            k = (i + count) % size
            x, y = x + ranges[k] * math.cos(bearings[k]), y + ranges[k] * math.sin(bearings[k])
            count += 1
        x, y = x / count, y / count
        for step in (-1, 1):
            k = (i + (count if step > 0 else -1)) % size
            while (
                hit[k]
                and not whole[k]
                and math.hypot(ranges[k] * math.cos(bearings[k]) - x, ranges[k] * math.sin(bearings[k]) - y)
                < config[0].body_m
            ):
                whole[k] = True
                k = (k + step) % size
    return whole


@compiled
def near_dynamic(z: Array, decision: Ints, ranges: Array, bearings: Array, dynamic: Bools, config: Rows) -> Ints:
    """(c,) the corners z (n,2) still NEW that lie near the end of a dynamic beam (B,)."""
    clearance, near, count = 0.5 * config[0].width_m[1], np.empty(z.shape[0], np.int64), 0
    for i in range(z.shape[0]):
        for k in range(ranges.shape[0] if decision[i] == NEW else 0):
            if not dynamic[k]:
                continue
            square = z[i, 0] ** 2 + ranges[k] ** 2 - 2.0 * z[i, 0] * ranges[k] * math.cos(z[i, 1] - bearings[k])
            if square < clearance * clearance:
                near[count] = i
                count += 1
                break
    return near[:count]
