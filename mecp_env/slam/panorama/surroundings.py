"""Corners and beams around the robot: those of a scan, and on its blind side those of recent ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints, carrier
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import quadratic
from mecp_env.core.se2 import as_bearings, polar_to_points, to_map
from mecp_env.slam.messages import (
    NO_DOORS,
    NO_ID,
    Corners,
    Decision,
    Match,
    MergedScan,
    Polygon,
    Reason,
    ScanFeatures,
)
from mecp_env.slam.panorama.registration import Surfaces


@carrier
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
    z, cov = moved_measurements(*corners.measurements(index), T_now_past, spread)
    nothing = np.full(len(index), -1)
    marks = corners.kind[index], corners.convex[index], as_bearings(corners.normals[index] + T_now_past[2])
    return Corners(z, cov, *marks, nothing, corners.sites[index], NO_DOORS)


@compiled
def moved_measurements(z: Array, R: Array, T_now_past: Array, spread: Array) -> tuple[Array, Array]:
    """Ranges and bearings z (n,2) and their covariance R (2n,2n) from a past pose, as seen from now.

    To the covariance comes that of T_now_past (3,), which is `spread` (3,3).
    """
    n = z.shape[0]
    moved, cov, J, by_pose = np.empty((n, 2)), np.empty((2 * n, 2 * n)), np.empty((n, 2, 2)), np.empty((n, 2, 3))
    points, heading = to_map(T_now_past, polar_to_points(z)), T_now_past[2]
    for k in range(n):
        x, y = points[k, 0], points[k, 1]
        far, c, s = math.hypot(x, y), math.cos(heading + z[k, 1]), math.sin(heading + z[k, 1])
        moved[k, 0], moved[k, 1] = far, math.atan2(y, x)
        for row, (u, v) in enumerate(((x / far, y / far), (-y / far**2, x / far**2))):  # d (range, bearing) / d point
            J[k, row, 0], J[k, row, 1] = u * c + v * s, z[k, 0] * (v * c - u * s)
            by_pose[k, row, 0], by_pose[k, row, 1] = u, v
            by_pose[k, row, 2] = v * (x - T_now_past[0]) - u * (y - T_now_past[1])
    for a in range(2 * n):
        k, mine = a // 2, J[a // 2, a % 2]
        for b in range(2 * n):
            j, other = b // 2, J[b // 2, b % 2]
            of_corners = quadratic(R[2 * k : 2 * k + 2, 2 * j : 2 * j + 2], mine, other)
            cov[a, b] = of_corners + quadratic(spread, by_pose[k, a % 2], by_pose[j, b % 2])
    return moved, cov


@compiled
def are_new(
    z: Array, T_now_past: Array, sight: tuple[float, float], taken: Array, near_m: float
) -> tuple[Bools, Array]:
    """Which corners z (n,2) of a past scan the present one cannot see, and their places (m,2) m, as seen from now.

    They lie outside of its `sight`, the first and the last bearing, and no nearer than `near_m` to places `taken`.
    """
    points, new, n = to_map(T_now_past, polar_to_points(z)), np.empty(z.shape[0], np.bool_), 0
    for k in range(z.shape[0]):
        x, y = points[k, 0], points[k, 1]
        bearing = math.atan2(y, x)
        new[k] = bearing < sight[0] or bearing > sight[1]
        for j in range(taken.shape[0]):
            new[k] = new[k] and math.hypot(x - taken[j, 0], y - taken[j, 1]) >= near_m
        if new[k]:
            points[n, 0], points[n, 1], n = x, y, n + 1
    return new, points[:n]


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
        far, meets = ranges_of(surfaces.points, blind, one_wall_m)
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


@compiled
def ranges_of(points: Array, bearings: Array, one_wall_m: float) -> tuple[Array, Bools]:
    """How far (B,) surfaces with points (n,2) are at rising bearings (B,), and where: between two of one wall."""
    n = points.shape[0]
    far, meets = np.zeros(bearings.shape[0]), np.zeros(bearings.shape[0], np.bool_)
    at, reach = np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1])
    order, left = np.argsort(at), -1
    for i in range(bearings.shape[0]):
        while left + 1 < n and at[order[left + 1]] <= bearings[i]:
            left += 1
        if not 0 <= left < n - 1:
            continue
        a, b = order[left], order[left + 1]
        meets[i] = math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]) < one_wall_m
        far[i] = reach[a] + (reach[b] - reach[a]) * (bearings[i] - at[a]) / (at[b] - at[a])
    return far, meets
