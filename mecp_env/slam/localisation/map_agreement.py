"""Whether the map agrees with a scan: beams that end on mapped walls, and beams that end on mapped floor."""

from __future__ import annotations

import math
from typing import NamedTuple

from mecp_env.core.carriers import Array, Bools, Bytes
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import Cell, MergedScan, SemanticGrid

FREE, OCCUPIED, DOOR = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.DOOR)


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
