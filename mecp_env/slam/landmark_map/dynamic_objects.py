"""Dynamic objects: what is where the map has seen free floor has moved there, and no corner of it is a landmark.

Differs from the paper: its world is static. Beams that end on floor seen free before, well away from all that is not
free, come from something that moved in since, if they are more than noise mixes at an edge; a line fitted to such beams
is not a wall, and none is painted where they end. In a static world every hit is on a wall, beside which the map has no
free floor: nothing is dynamic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.carriers import Array, Bools, Bytes, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import DynamicObjectsConfig, SensorModel
from mecp_env.slam.messages import (
    NO_ID,
    Belief,
    Cell,
    Corners,
    Decision,
    Match,
    MergedScan,
    Reason,
    Segments,
    SemanticGrid,
)

FREE, DOOR = int(Cell.FREE), int(Cell.DOOR)
NEW = int(Decision.NEW)


@dataclass(frozen=True, slots=True, eq=False)
class DynamicObjects:
    """The stage for a world where things move; beams (B,) are marked, None stands for none."""

    config: DynamicObjectsConfig
    noise: tuple[int, float]  # neighbours that it mixes of two surfaces, so many are no object; sigmas of a place

    def find(self, beams: MergedScan, belief: Belief, grid: SemanticGrid) -> Bools | None:
        """(B,) the beams that end on something on floor that the map has seen free."""
        if not grid.label.size:
            return None
        pose_cov, limits = np.ascontiguousarray(belief.pose_cov), self.config.record
        scan, floor = (beams.ranges, beams.bearings, beams.hit), (grid.label, grid.origin, grid.resolution_m)
        marked = mark_dynamic(*scan, belief.T_map_robot, pose_cov, floor, self.noise, limits)
        return whole_bodies(beams.ranges, beams.bearings, beams.hit, marked, limits) if len(marked) else None

    def reject(self, match: Match, corners: Corners, beams: MergedScan, dynamic: Bools | None) -> Match:
        """The match in which new corners near dynamic beams are ignored."""
        if dynamic is None or NEW not in match.decision.tolist():
            return match
        new = np.flatnonzero(match.decision == NEW)
        ends = polar_to_points(np.stack((beams.ranges[dynamic], beams.bearings[dynamic]), axis=1))
        offset = polar_to_points(corners.z[new])[:, None] - ends
        near = new[(np.hypot(offset[..., 0], offset[..., 1]) < self.config.margin_m).any(axis=1)]
        return match.assign(near, NO_ID, int(Decision.IGNORED), int(Reason.DYNAMIC)) if len(near) else match

    def without(self, beams: MergedScan, segments: Segments, dynamic: Bools | None) -> tuple[MergedScan, Segments]:
        """Beams and segments to paint: free floor up to dynamic objects, no wall there."""
        if dynamic is None:
            return beams, segments
        return replace(beams, hit=beams.hit & ~dynamic), without_dynamic(segments, dynamic)


class StaticWorld(DynamicObjects):
    """The paper's world, where nothing moves: the stage does nothing."""

    def find(self, beams: MergedScan, belief: Belief, grid: SemanticGrid) -> Bools | None:
        return None


def make_dynamic_objects(config: DynamicObjectsConfig, sensor: SensorModel) -> DynamicObjects:
    """The stage that `config` describes, with a laser."""
    return (DynamicObjects if config.margin_m else StaticWorld)(config, (sensor.edge_beams, sensor.noise_sigmas))


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
def mark_dynamic(
    ranges: Array,
    bearings: Array,
    hit: Bools,
    T_map_robot: Array,
    pose_cov: Array,
    floor: tuple[Bytes, Array, float],
    noise: tuple[int, float],
    config: Rows,
) -> Bools:
    """(B,) the hits in runs of beams that end on floor; (0,) without any.

    `floor` is the labels (H,W), the origin and the resolution of the grid; `noise` how many neighbours it mixes, which
    are no object, and the sigmas of the place of a hit by which the margin grows.
    """
    needed, last, dynamic, found = noise[0] + 1, -1, np.zeros(ranges.shape[0], np.bool_), False
    place = config[0].margin_m + noise[1] * math.sqrt(max(pose_cov[0, 0] + pose_cov[1, 1], 0.0))
    margin = place, noise[1] * math.sqrt(max(pose_cov[2, 2], 0.0))
    beams = ranges, bearings, hit
    for probe in range(needed - 1, ranges.shape[0], needed):  # a run of so many holds one of them
        if probe <= last or not ends_on_floor(beams, probe, T_map_robot, floor, margin):
            continue
        first, last = probe, probe
        while first > 0 and ends_on_floor(beams, first - 1, T_map_robot, floor, margin):
            first -= 1
        while last + 1 < ranges.shape[0] and ends_on_floor(beams, last + 1, T_map_robot, floor, margin):
            last += 1
        if last - first + 1 >= needed:
            dynamic[first : last + 1] = found = True
    return dynamic if found else dynamic[:0]


@compiled
def ends_on_floor(
    beams: tuple[Array, Array, Bools],
    beam: int,
    T_map_robot: Array,
    floor: tuple[Bytes, Array, float],
    margin: tuple[float, float],
) -> bool:
    """True when a beam hits something and all cells within a margin (m, and a share of the range) are known as free."""
    (ranges, bearings, hit), (label, origin, resolution) = beams, floor
    if not hit[beam]:
        return False
    far, heading = ranges[beam], T_map_robot[2] + bearings[beam]
    column = (T_map_robot[0] + far * math.cos(heading) - origin[0]) / resolution
    row = (T_map_robot[1] + far * math.sin(heading) - origin[1]) / resolution
    near = (margin[0] + far * margin[1]) / resolution
    low_r, high_r = math.floor(row - near), math.floor(row + near)
    low_c, high_c = math.floor(column - near), math.floor(column + near)
    if low_r < 0 or low_c < 0 or high_r >= label.shape[0] or high_c >= label.shape[1]:
        return False
    centre = label[math.floor(row), math.floor(column)]
    if centre != FREE and centre != DOOR:
        return False
    for r in range(low_r, high_r + 1):
        for c in range(low_c, high_c + 1):
            away2 = (c + 0.5 - column) ** 2 + (r + 0.5 - row) ** 2
            if label[r, c] != FREE and label[r, c] != DOOR and away2 < near * near:
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
