"""Where in the map a scan was taken, without any prior: hypotheses by polygon shape and by pairs of corners.

Each hypothesis is a pose that puts some corners of the scan onto landmarks. It is judged by all corners: how many lie
on a landmark with their descriptor, and how well. In an ambiguous place, where a pose elsewhere explains almost as many
almost as well, none is accepted.

Which of the poses that a search has found is the right one, if that is clear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import polar_to_points, wrapped
from mecp_env.slam.config import AssociationConfig, LocalisationConfig
from mecp_env.slam.messages import NO_IDS, Corners, MapView, Polygon

Complexes = NDArray[np.complex128]
OPEN_COV = np.diag([9.0, 9.0, 0.25])  # m^2, rad^2: next to no prior, the corners that are explained say the rest
LEAST_COV = 1e-12 * np.eye(2)  # m^2: it has an inverse, whatever a filter says


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Corners or landmarks with their descriptors, in the robot's or the map's frame."""

    p: Complexes  # (n,) m, x + iy
    cov: Array  # (n,2,2) m^2
    convex: Bools  # (n,)
    normals: Array  # (n,2) rad, of the faces before and after; nan: unseen


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """A pose at which the map explains a scan, and the corners that it explains."""

    T_map_robot: Array  # (3,)
    cov: Array  # (3,3) m, rad, of what is known but for the corners
    corners: Ints  # (c,)
    ids: Ints  # (c,) their landmarks
    off: float = 0.0  # how far the corners are off their landmarks, as so many that are not on theirs at all
    misfit: float = 0.0  # the same, and the corners that it leaves unexplained

    def differs_from(self, other: Located) -> bool:
        """True unless the two have pairs in common and pair no corner with different landmarks."""
        mine, others = (dict(zip(o.corners.tolist(), o.ids.tolist(), strict=True)) for o in (self, other))
        shared = mine.keys() & others.keys()
        return not shared or any(mine[corner] != others[corner] for corner in shared)


class LandmarkIndex:
    """The landmarks of a map, their polygons and all pairs of them, for searches without a prior."""

    def __init__(self, view: MapView, config: LocalisationConfig, reach_m: float, pairing: AssociationConfig) -> None:
        belief, rows = view.belief, view.features.rows[view.belief.ids]
        self.config, self.tolerance = config, math.radians(pairing.descriptor_deg)
        self.nis_of_one = max(pairing.rival_gap, 1e-9)  # beyond that of noise: a corner so far off is not explained
        self.ids = belief.ids
        self.landmarks = Points(as_complex(belief.p_map), belief.covs, rows["convex"] > 0, rows["normals"])
        self.tree = KDTree(view.belief.p_map.reshape(-1, 2))
        both = self.tree.query_pairs(reach_m, output_type="ndarray").astype(np.int64)
        pairs = np.concatenate((both, both[:, ::-1]))
        length = np.abs(self.landmarks.p[pairs[:, 1]] - self.landmarks.p[pairs[:, 0]])
        order = np.argsort(length)
        self.pairs, self.length = pairs[order], length[order]  # (m,2) rows of `ids`, (m,) m, ascending
        self.polygons = {
            k: view.belief.rows(group.ids[np.isin(group.ids, self.ids).all(axis=1)]) for k, group in view.groups.items()
        }  # cardinality -> (C,k) rows of `ids`

    def locate(self, corners: Corners, polygons: tuple[Polygon, ...]) -> list[Located]:
        """The poses that enough corners of a scan speak for, the likeliest first."""
        seen = points_of(corners)
        found = [self._by_polygon(seen.p[polygon.corners]) for polygon in polygons]
        poses, row = self._verified(
            seen, most_voted(np.concatenate([*found, self._by_pairs(seen)]))[: self.config.most_hypotheses]
        )
        enough = np.flatnonzero(count_distinct(row) >= self.config.least_corners - 1).tolist()
        return sorted((self._located(seen, poses[h], row[h]) for h in enough), key=attrgetter("misfit"))

    def look_at(self, corners: Corners, T_map_robot: Array) -> Located:
        """What the map explains of a scan that was taken near this pose (3,)."""
        seen = points_of(corners)
        poses, row = self._verified(seen, T_map_robot[None])
        return self._located(seen, poses[0], row[0])

    def _located(self, seen: Points, pose: Array, row: Ints) -> Located:
        corners = np.flatnonzero(row >= 0)
        _, first = np.unique(row[corners], return_index=True)
        corners = corners[np.sort(first)]
        off = self._off(seen, pose, corners, row[corners])
        return Located(pose, OPEN_COV, corners, self.ids[row[corners]], off, len(seen.p) - len(corners) + off)

    def _off(self, seen: Points, pose: Array, corners: Ints, row: Ints) -> float:
        """How far the `corners` (c,) are off their landmarks: the NIS that noise does not explain, as shares."""
        off = moved(pose[None], seen.p[corners])[0] - self.landmarks.p[row]
        cov = turned(seen.cov[corners], pose[2]) + self.landmarks.cov[row] + LEAST_COV
        nu = np.stack((off.real, off.imag), axis=-1)[..., None]
        nis = (nu * np.linalg.solve(cov, nu)).sum(axis=(1, 2))
        beyond = np.maximum(nis - 2.0, 0.0)  # noise alone has 2 on the average
        return float(np.minimum(beyond / self.nis_of_one, 1.0).sum())

    def _by_polygon(self, ring: Complexes) -> Array:
        """Poses (h,3) that put the corners `ring` (k,) of a polygon onto a map polygon of the same shape."""
        k = len(ring)
        known = self.polygons.get(k)
        if known is None or not len(known):
            return np.empty((0, 3))
        turned = np.concatenate([np.roll(known, shift, axis=1) for shift in range(k)])
        at = self.landmarks.p[turned]
        pose = fit(np.broadcast_to(ring, at.shape), at, np.ones(at.shape, np.bool_))
        off = np.abs(moved(pose, ring) - at).max(axis=1)
        alike: Array = pose[off < self.config.inlier_m]
        return alike

    def _by_pairs(self, seen: Points) -> Array:
        """Poses (h,3) that put two corners onto two landmarks of the same distance and descriptors."""
        first, second = np.triu_indices(len(seen.p), 1)
        length = np.abs(seen.p[second] - seen.p[first])
        low = np.searchsorted(self.length, length - 0.5 * self.config.inlier_m)
        high = np.searchsorted(self.length, length + 0.5 * self.config.inlier_m)
        count = np.where(length > 4.0 * self.config.inlier_m, high - low, 0)  # a short one leaves the heading open
        rarest = np.argsort(count, kind="stable")
        rarest = rarest[np.cumsum(count[rarest]) <= self.config.most_hypotheses**2]
        count, low = count[rarest], low[rarest]
        i, j = np.repeat(first[rarest], count), np.repeat(second[rarest], count)
        offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        a, b = self.pairs[np.repeat(low, count) + offset].T
        there, here = self.landmarks.p[b] - self.landmarks.p[a], seen.p[j] - seen.p[i]
        heading = np.angle(there * here.conj())
        same = fits(seen, i, heading, self.landmarks, a, self.tolerance)
        same[same] = fits(seen, j[same], heading[same], self.landmarks, b[same], self.tolerance)
        i, j, a, b, heading = i[same], j[same], a[same], b[same], heading[same]
        middle = 0.5 * (self.landmarks.p[a] + self.landmarks.p[b])
        p = middle - 0.5 * (seen.p[i] + seen.p[j]) * np.exp(1j * heading)
        return np.stack((p.real, p.imag, heading), axis=1)

    def _verified(self, seen: Points, poses: Array) -> tuple[Array, Ints]:
        """Poses (h,3) fitted to all corners that they explain, and the landmark rows (h,n) of these, -1 for none."""
        row = np.full((len(poses), len(seen.p)), -1)
        for radius in (2.0 * self.config.inlier_m, self.config.inlier_m, self.config.inlier_m):
            row = self._explained(seen, poses, radius)
            at = self.landmarks.p[np.maximum(row, 0)]
            enough = (row >= 0).sum(axis=1) >= 2
            refined = fit(np.broadcast_to(seen.p, at.shape), at, row >= 0)
            poses = np.where(enough[:, None], refined, poses)
        return poses, row

    def _explained(self, seen: Points, poses: Array, radius: float) -> Ints:
        """(h,n) row of the nearest landmark with the descriptor of each corner within `radius`, or -1."""
        at = moved(poses, seen.p)
        query = np.stack((at.real, at.imag), axis=-1)
        most = min(4, len(self.ids))
        nearest = self.tree.query(query, k=most, distance_upper_bound=radius)[1]
        near: Ints = np.asarray(nearest).reshape(*at.shape, most)  # also of no hypothesis
        h, n, k = np.nonzero(near < len(self.ids))
        fitting = fits(seen, n, poses[h, 2], self.landmarks, near[h, n, k], self.tolerance)
        row = np.full(at.shape, -1)
        h, n, k = h[fitting][::-1], n[fitting][::-1], k[fitting][::-1]
        row[h, n] = near[h, n, k]  # written last: the nearest
        return row


def points_of(corners: Corners) -> Points:
    """The corners of a scan, robot frame."""
    scale = np.stack((np.ones(len(corners)), corners.z[:, 0]), axis=1)  # along and across the ray
    cov = turned(scale[:, :, None] * corners.R * scale[:, None, :], corners.z[:, 1])
    return Points(as_complex(polar_to_points(corners.z)), cov, corners.convex, corners.normals)


def turned(cov: Array, angle: Array | float) -> Array:
    """Covariances (n,2,2) in a frame in which they are turned by an angle each (n,), or by one."""
    c, s = np.cos(angle), np.sin(angle)
    turn: Array = np.moveaxis(np.array(((c, -s), (s, c))), (0, 1), (-2, -1))
    again: Array = turn @ cov @ turn.swapaxes(-1, -2)
    return again


def as_complex(points: Array) -> Complexes:
    """Points (n,2) as numbers (n,)."""
    numbers: Complexes = points[:, 0] + 1j * points[:, 1]
    return numbers


def moved(poses: Array, p_robot: Complexes) -> Complexes:
    """Points (n,) of the robot's frame in the map's, at each pose (h,3): (h,n)."""
    turned: Complexes = np.exp(1j * poses[:, 2])[:, None] * p_robot
    return turned + as_complex(poses)[:, None]


def fit(here: Complexes, there: Complexes, used: Bools) -> Array:
    """Poses (h,3) that move the points `here` (h,n) onto `there` (h,n) with the least squares of those `used` (h,n)."""
    total = np.maximum(used.sum(axis=1, keepdims=True), 1)
    a, b = ((used * p).sum(axis=1, keepdims=True) / total for p in (here, there))
    heading = np.angle((used * (there - b) * (here - a).conj()).sum(axis=1))
    p = b[:, 0] - a[:, 0] * np.exp(1j * heading)
    return np.stack((p.real, p.imag, heading), axis=1)


def fits(seen: Points, i: Ints, heading: Array, known: Points, j: Ints, tolerance: float) -> Bools:
    """(h,) whether corner i[h], turned by heading[h], has the descriptor of landmark j[h]; as in `gating`."""
    off = np.abs(wrapped(seen.normals[i] + heading[:, None] - known.normals[j]))
    unseen = np.isnan(off)
    same: Bools = (seen.convex[i] == known.convex[j]) & (unseen | (off <= tolerance)).all(axis=1) & ~unseen.all(axis=1)
    return same


def most_voted(poses: Array) -> Array:
    """(h,3) one pose of each cell of 0.3 m and 0.1 rad that has some, the cells with most first."""
    cells = np.round(poses / [0.3, 0.3, 0.1]).astype(np.int64)
    _, first, votes = np.unique(cells, axis=0, return_index=True, return_counts=True)
    return poses[first[np.argsort(-votes, kind="stable")]]


def count_distinct(row: Ints) -> Ints:
    """(h,) how many different values not below 0 each line of `row` (h,n) has."""
    ordered = np.sort(row, axis=1)
    first: Ints = (np.diff(ordered, axis=1, prepend=-1) > 0).sum(axis=1)
    return first


class Hypothesis(NamedTuple):
    """A pose that some corners speak for, and what all beams say of it."""

    at: Located
    share: float  # of the beams in mapped space that agree, nan: nothing is mapped there
    explained: float  # share of all beams, or of the corners, that the map explains
    recognised: float  # share of the corners that it puts on a landmark, less by how far they are off
    near: bool  # failed odometry may be all that is between it and the prediction

    def is_sound(self, config: LocalisationConfig) -> bool:
        """True when the map explains enough of the scan, and contradicts little of it.

        A pose that failed odometry does not explain needs as many of the corners as of the beams: another room of about
        the same size explains most walls, and few corners.
        """
        least = config.explained_share
        explains = self.explained >= least and (self.near or self.recognised >= least)
        return explains and not self.share < least

    def lies(self, config: LocalisationConfig) -> bool:
        """True when most corners that it puts near a landmark lie on it: elsewhere, they are centimetres beside it."""
        return self.at.off <= (1.0 - config.explained_share) * len(self.at.corners)

    def may_be(self, other: Hypothesis, config: LocalisationConfig) -> bool:
        """True when the robot may as well be at the `other` pose: nearly as many corners, or more beams, speak for it.

        In a room that looks the same turned around, as many lie near a landmark there, but hardly one lies on it.
        """
        as_many = len(other.at.corners) > len(self.at.corners) - config.margin
        return (as_many and other.recognised >= config.explained_share) or other.share > self.share


NOWHERE = Hypothesis(Located(np.zeros(3), np.zeros((3, 3)), NO_IDS, NO_IDS), 0.0, -1.0, 0.0, near=False)


def clear_winner(hypotheses: list[Hypothesis], config: LocalisationConfig) -> Hypothesis | None:
    """The likeliest pose, if it explains enough of the scan and no other pose may be the right one.

    Another may be that nearly as many corners fit nearly as well, or that agrees better with what is mapped there. A
    near pose that explains the scan as well as any needs to fear other near ones only: odometry that fails is likelier
    than a robot that is carried off, and a place that was seen just now has few landmarks yet.
    """
    best, *others = _candidates(hypotheses, config) or [NOWHERE]
    enough = len(best.at.corners) + best.near >= config.least_corners
    rivals = (one for one in others if best.may_be(one, config))
    clear = enough and best.is_sound(config) and not any(best.at.differs_from(one.at) for one in rivals)
    return best if clear else None


def _candidates(hypotheses: list[Hypothesis], config: LocalisationConfig) -> list[Hypothesis]:
    """The poses that the map does not contradict; the near ones alone, if they explain the scan nearly as well as any.

    Nearly: by a tenth of what a pose may leave unexplained. In a corridor of equal bays some other often explains a few
    beams more. A near one whose corners lie beside their landmarks is no better than others: the robot was carried to a
    room of nearly the same size, and seems not to have moved.
    """
    possible = [one for one in hypotheses if not one.share < config.explained_share]
    most = max((one.explained for one in possible), default=0.0)
    as_well = most - 0.1 * (1.0 - config.explained_share)
    return [one for one in possible if one.near and one.explained >= as_well and one.lies(config)] or possible
