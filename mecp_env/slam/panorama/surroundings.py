"""Corners and beams around the robot: those of a scan, and on its blind side those of recent ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.array_types import Array, Bools, Ints
from mecp_env.core.quick import quick
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.slam.messages import (
    NO_ID,
    Corners,
    Decision,
    Doorways,
    Match,
    MergedScan,
    Polygon,
    Reason,
    ScanFeatures,
)
from mecp_env.slam.panorama.pose_marks import TURN
from mecp_env.slam.panorama.surfaces import Surfaces


@quick
@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """A scan, and what associator and polygon search see of the place: without past corners that of the scan itself."""

    scan: ScanFeatures
    corners: Corners  # (n,)
    beams: MergedScan
    wall: Bools  # (B,) which beams end on a wall
    now: Ints | None = None  # (m,) those of the corners that are of this scan; None: all
    ids: Ints | None = None  # (n,) features that the past corners are, NO_ID for those of this scan
    polygons: tuple[Polygon, ...] = ()  # of `corners`

    @classmethod
    def of(cls, scan: ScanFeatures) -> Surroundings:
        """Those of a scan alone."""
        return cls(scan, scan.corners, scan.beams, scan.wall)

    def with_polygons(self, polygons: tuple[Polygon, ...]) -> Surroundings:
        """The same with the polygons of its corners."""
        return Surroundings(self.scan, self.corners, self.beams, self.wall, self.now, self.ids, polygons)

    @property
    def place(self) -> tuple[Corners, MergedScan]:
        """All corners and all beams."""
        return self.corners, self.beams

    @property
    def shown(self) -> Corners | None:
        """The corners, if past ones are among them."""
        return None if self.now is None else self.corners

    @property
    def past(self) -> Ints | None:
        """(p,) the corners of recent scans, if there are any."""
        return None if self.now is None else np.setdiff1d(np.arange(len(self.corners)), self.now)

    def narrow(self, match: Match) -> Match:
        """The match of this scan's corners (m,) among that of all (n,)."""
        if self.now is None:
            return match
        ids, decision, reason = match.ids[self.now], match.decision[self.now], match.reason[self.now]
        return Match(ids, decision, reason, match.nis[self.now], match.polygon, match.known)

    def widen(self, match: Match) -> Match:
        """The match of all corners (n,), the past ones as they were matched then; `match` (m,) is that of this scan."""
        if self.now is None or self.ids is None:
            return match
        ids, nis = self.ids.copy(), np.full(len(self.ids), math.nan)
        decision, reason = np.full(len(ids), int(Decision.IGNORED)), np.full(len(ids), int(Reason.UNSEEN))
        ids[self.now], nis[self.now] = match.ids, match.nis
        decision[self.now], reason[self.now] = match.decision, match.reason
        return Match(ids, decision, reason, nis, match.polygon, match.known)

    def widen_column(self, column: Ints) -> Ints:
        """A column (n,) of numbers that this scan's corners (m,) have; -1 for the past ones."""
        if self.now is None:
            return column
        wide = np.full(len(self.corners), -1)
        wide[self.now] = column
        return wide


def moved_corners(corners: Corners, kept: Bools, T_now_past: Array, spread: Array) -> Corners:
    """Those of a past scan's corners that are `kept` (n,), as seen from now; `spread` (3,3) is that of T_now_past."""
    index = np.flatnonzero(kept)
    z, R = corners.measurements(index)
    before = polar_to_points(z)
    points = to_map(T_now_past, before)
    seen = np.column_stack((np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])))
    J, by_pose = np.zeros((2 * len(index), 2 * len(index))), np.empty((2 * len(index), 3))
    c, s = math.cos(T_now_past[2]), math.sin(T_now_past[2])
    for k, (p, q, (r, _)) in enumerate(zip(points, before, z, strict=True)):
        rows, far = slice(2 * k, 2 * k + 2), math.hypot(*p)
        to_polar = np.array([p / far, TURN @ p / far**2])
        J[rows, rows] = to_polar @ np.array([[c, -s], [s, c]]) @ np.column_stack((q / r, TURN @ q))
        by_pose[rows] = to_polar @ np.column_stack((np.eye(2), TURN @ (p - T_now_past[:2])))
    nothing = np.full(len(index), -1)
    marks = corners.kind[index], corners.convex[index], wrapped(corners.normals[index] + T_now_past[2])
    return Corners(seen, J @ R @ J.T + by_pose @ spread @ by_pose.T, *marks, nothing, corners.sites[index], NO_DOORS)


NO_DOORS = Doorways(np.empty((0, 2), np.int64), np.empty(0), np.empty(0, np.bool_))


def wrapped(angles: Array) -> Array:
    """The angles in (-pi, pi]."""
    return -np.remainder(math.pi - angles, 2.0 * math.pi) + math.pi


def surround(
    scan: ScanFeatures, past: Sequence[tuple[Corners, Ints]], walls: Sequence[Surfaces], one_wall_m: float
) -> Surroundings:
    """A scan with what recent ones show on its blind side, the newest first.

    `past` are corners, each with the ids (k,) of features; between two points of `walls` that are nearer than
    `one_wall_m` there is wall.
    """
    joined, order = in_order_of_bearing([scan.corners, *(part for part, _ in past)])
    ids = np.concatenate([np.full(len(scan.corners), NO_ID), *(known for _, known in past)])[order]
    now = np.flatnonzero(order < len(scan.corners))
    return Surroundings(scan, joined, *all_around(scan, walls, one_wall_m), now, ids)


def in_order_of_bearing(parts: Sequence[Corners]) -> tuple[Corners, Ints]:
    """The corners of several messages as one, and which of them (n,) each is; doorways are those of the first."""
    z = np.concatenate([part.z for part in parts])
    order = np.argsort(z[:, 1], kind="stable")
    cov, at = np.zeros((2 * len(z), 2 * len(z))), 0
    for part in parts:
        cov[at : at + 2 * len(part), at : at + 2 * len(part)] = part.cov
        at += 2 * len(part)
    rows = (2 * order[:, None] + [0, 1]).ravel()
    kind, convex, normals, beyond, sites = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("kind", "convex", "normals", "beyond", "sites")
    )
    doorways = replace(parts[0].doorways, jambs=np.argsort(order)[parts[0].doorways.jambs])
    marks = kind, convex, normals, beyond, sites
    return Corners(z[order], np.ascontiguousarray(cov[np.ix_(rows, rows)]), *marks, doorways), order


def all_around(scan: ScanFeatures, walls: Sequence[Surfaces], one_wall_m: float) -> tuple[MergedScan, Bools]:
    """The beams all around, and which of them (B,) end on a wall; on the blind side as far as the past has seen."""
    beams, step = scan.beams, scan.beams.step
    before = np.arange(beams.bearings[0] - step, -math.pi, -step)[::-1]
    blind = np.concatenate((before, np.arange(beams.bearings[-1] + step, math.pi, step)))
    ranges, found = np.full(len(blind), beams.max_range_m), np.zeros(len(blind), np.bool_)
    for surfaces in walls:
        far, meets = ranges_of(surfaces, blind, one_wall_m)
        new = meets & ~found
        ranges[new], found = far[new], found | new
    ring = np.argsort(np.concatenate((beams.bearings, blind)), kind="stable")
    around = replace(
        beams,
        ranges=np.concatenate((beams.ranges, ranges))[ring],
        bearings=np.concatenate((beams.bearings, blind))[ring],
        hit=np.concatenate((beams.hit, found))[ring],
        count=np.concatenate((beams.count, np.ones(len(blind), np.int64)))[ring],
    )
    return around, np.concatenate((scan.wall, found))[ring]


def ranges_of(surfaces: Surfaces, bearings: Array, one_wall_m: float) -> tuple[Array, Bools]:
    """How far (B,) the surfaces are at bearings (B,), and where there are any: between two points of one wall."""
    if len(surfaces) == 0:
        return np.zeros(len(bearings)), np.zeros(len(bearings), np.bool_)
    at = np.arctan2(surfaces.points[:, 1], surfaces.points[:, 0])
    order = np.argsort(at)
    points, at = surfaces.points[order], at[order]
    apart = np.append(np.hypot(*np.diff(points, axis=0).T), np.inf)
    left = np.searchsorted(at, bearings, side="right") - 1
    meets = (left >= 0) & (apart[left] < one_wall_m)
    return np.interp(bearings, at, np.hypot(*points.T)), meets
