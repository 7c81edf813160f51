"""Register the surfaces of a scan with those of past ones: nearest points, from point to line (Censi 2008, PLICP).

The prior of the pose holds what the surfaces leave open, as along a corridor; it is no part of the result.

The surfaces that a scan shows: points with the normals of what they are on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import inverse3, quadratic, solve3
from mecp_env.core.se2 import to_map, wrap_angle
from mecp_env.slam.config import SensorModel, SlamConfig
from mecp_env.slam.messages import MergedScan, Segments

Points = tuple[Array, Array, Array]  # points (n,2) m, normals (n,2) or 0, sigmas (n,) m: a `Surfaces` as a plain tuple
Prior = tuple[Array, Array]  # T_past_now (3,) and its covariance (3,3)


class Index(NamedTuple):
    """Points in square cells, row by row: those of cell i are `order[first[i]:first[i + 1]]`."""

    low: Array  # (2,) m, the least coordinates
    side_m: float  # of a cell
    columns: int
    rows: int
    first: Ints  # (rows * columns + 1,)
    order: Ints  # (n,)


@compiled
def index_of(points: Array) -> Index:
    """The cells of points (n,2), at least one; along the longer side there are as many as the root of n, and one."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(points.shape[0]):
        for axis in range(2):
            low[axis], high[axis] = min(low[axis], points[i, axis]), max(high[axis], points[i, axis])
    side_m = max(high[0] - low[0], high[1] - low[1]) / math.sqrt(points.shape[0])
    side_m = side_m if side_m > 0.0 else 1.0
    columns, rows = int((high[0] - low[0]) / side_m) + 1, int((high[1] - low[1]) / side_m) + 1
    cell, first = np.empty(points.shape[0], np.int64), np.zeros(rows * columns + 1, np.int64)
    for i in range(points.shape[0]):
        cell[i] = int((points[i, 1] - low[1]) / side_m) * columns + int((points[i, 0] - low[0]) / side_m)
        first[cell[i] + 1] += 1
    for i in range(rows * columns):
        first[i + 1] += first[i]
    order, free = np.empty(points.shape[0], np.int64), first.copy()
    for i in range(points.shape[0]):
        order[free[cell[i]]] = i
        free[cell[i]] += 1
    return Index(low, side_m, columns, rows, first, order)


@compiled
def nearest(points: Array, index: Index, x: float, y: float, reach_m: float) -> int:
    """The one of the indexed points that is nearest to (x, y), and nearer than `reach_m`; -1 without one.

    Rings of cells are looked at around that of (x, y), until the next one can only be farther.
    """
    best, square = -1, reach_m * reach_m
    column, row = math.floor((x - index.low[0]) / index.side_m), math.floor((y - index.low[1]) / index.side_m)
    for ring in range(math.ceil(reach_m / index.side_m) + 1):
        if (ring - 1) * index.side_m > math.sqrt(square):
            break
        for r in range(max(row - ring, 0), min(row + ring, index.rows - 1) + 1):
            step = 1 if abs(r - row) == ring else max(2 * ring, 1)  # between them, all columns or the two at the sides
            for c in range(column - ring, column + ring + 1, step):
                if not 0 <= c < index.columns:
                    continue
                for k in range(index.first[r * index.columns + c], index.first[r * index.columns + c + 1]):
                    i = index.order[k]
                    far = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2
                    if far < square:
                        best, square = i, far
    return best


@compiled
def paired(past: Points, index: Index, there: Points, reach_m: float, facing: float) -> Ints:
    """(n,) for each point now the nearest of the past, nearer than `reach_m`, if both face the same way; else -1."""
    points, normals, _ = there
    pairs = np.empty(points.shape[0], np.int64)
    for i in range(points.shape[0]):
        j = nearest(past[0], index, points[i, 0], points[i, 1], reach_m)
        pairs[i] = j
        if j >= 0:
            u, v, p, q = normals[i, 0], normals[i, 1], past[1][j, 0], past[1][j, 1]
            loose = (u == 0.0 and v == 0.0) or (p == 0.0 and q == 0.0)
            pairs[i] = j if loose or u * p + v * q > facing else -1
    return pairs


@compiled
def add_rows(
    past: Points, there: Points, pairs: Ints, T: Array, reach_m: float, information: Array, push: Array
) -> None:
    """Add J^T W J (3,3) and J^T W r (3,) of the distances along the normals, and in x and y where there are none."""
    (points, _, sigmas), (others, normals, past_sigmas), J = there, past, np.empty(3)
    for i in range(points.shape[0]):
        j = pairs[i]
        if j < 0:
            continue
        sigma = math.hypot(sigmas[i], past_sigmas[j])
        loose = normals[j, 0] == 0.0 and normals[j, 1] == 0.0
        for row in range(2 if loose else 1):
            J[0], J[1] = (1.0 - row, 1.0 * row) if loose else (normals[j, 0], normals[j, 1])
            J[2] = J[1] * (points[i, 0] - T[0]) - J[0] * (points[i, 1] - T[1])
            off = J[0] * (points[i, 0] - others[j, 0]) + J[1] * (points[i, 1] - others[j, 1])
            weight = 1.0 / (sigma**2 + (off * sigma / max(sigma, reach_m / 3.0)) ** 2)  # Cauchy
            for a in range(3):
                push[a] += J[a] * weight * off
                for b in range(3):
                    information[a, b] += J[a] * weight * J[b]


@compiled
def align(
    past: Points,
    index: Index,
    now: Points,
    start: Array,
    prior: tuple[Array, Array],
    reaches: tuple[float, float],
    limits: tuple[float, int],
) -> tuple[Array, Array, Bools]:
    """Gauss-Newton from a start T_past_now (3,): the pose, its information (3,3), and which points (n,) are paired.

    `prior` is T_past_now (3,) with the inverse (3,3) of its covariance, which is no part of the information. Pairs are
    no farther apart than `reaches`, at first and at last: halved in two steps, then four more. `limits` are the least
    cosine between the normals of a pair, and the least number of pairs; with fewer, none is paired.
    """
    T, (reach_m, near_m), (facing, least) = start.copy(), reaches, limits
    information, pairs = np.zeros((3, 3)), np.full(now[0].shape[0], -1)
    for _ in range(2 * math.ceil(math.log2(reach_m / near_m)) + 4):
        turn = np.array([0.0, 0.0, T[2]])
        there = to_map(T, now[0]), to_map(turn, now[1]), now[2]
        pairs = paired(past, index, there, reach_m, facing)
        if (pairs >= 0).sum() < least:
            pairs[:] = -1
            break
        off = T - prior[0]
        off[2] = wrap_angle(off[2])
        information, push = np.zeros((3, 3)), np.zeros(3)
        add_rows(past, there, pairs, T, reach_m, information, push)
        total = information + prior[1]
        for a in range(3):
            for b in range(3):
                push[a] += prior[1][a, b] * off[b]
        solve3(total, push)
        T -= push
        reach_m = max(near_m, reach_m * math.sqrt(0.5))
    T[2] = wrap_angle(T[2])
    return T, information, pairs >= 0


@compiled
def count_against(points: Array, alone: Bools, bearings: Array, ranges: Array, inside_m: float) -> int:
    """How many of the points (n,2) that are `alone` lie on floor that a scan with these beams (B,) saw free."""
    against = 0
    for i in range(points.shape[0]):
        bearing = math.atan2(points[i, 1], points[i, 0])
        if not (alone[i] and bearings[0] < bearing < bearings[-1]):
            continue
        k = np.searchsorted(bearings, bearing)
        share = (bearing - bearings[k - 1]) / (bearings[k] - bearings[k - 1])
        seen = ranges[k - 1] + share * (ranges[k] - ranges[k - 1])
        against += math.hypot(points[i, 0], points[i, 1]) < seen - inside_m
    return against


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Points on surfaces, in the frame of a laser."""

    points: Array  # (n,2) m
    normals: Array  # (n,2) of length 1, towards the laser; 0 for a point on no flat surface
    sigmas: Array  # (n,) m, of a point along its normal, or in any direction

    def seen_from(self, T_a_b: Array) -> Surfaces:
        """The same surfaces, of frame b, in frame a; T_a_b (3,)."""
        turn = np.array([0.0, 0.0, T_a_b[2]])
        return replace(self, points=to_map(T_a_b, self.points), normals=to_map(turn, self.normals))

    @property
    def plain(self) -> tuple[Array, Array, Array]:
        """The fields, as the compiled functions take them."""
        return self.points, self.normals, self.sigmas

    def flat(self) -> Surfaces:
        """Those on flat surfaces."""
        on = self.normals.any(axis=1)
        return Surfaces(self.points[on], self.normals[on], self.sigmas[on])

    def __len__(self) -> int:
        return len(self.points)


def surfaces_of(beams: MergedScan, segments: Segments, wall: Bools, sensor: SensorModel) -> Surfaces:
    """The points where the beams that `wall` (B,) names end, with the normals of the segments that they are on.

    A normal fitted to a few beams is too noisy: along a corridor, thousands of them tell a motion that nobody made.
    """
    scan = beams.ranges, beams.bearings, beams.hit & wall, beams.hit, beams.count
    lines = segments.line, segments.first, segments.last, segments.roll
    least_m = max(sensor.range_sigma_m, sensor.least_range_sigma_m)
    noise = float(least_m), float(sensor.range_sigma_share), float(sensor.noise_sigmas)
    return Surfaces(*_surfaces(scan, lines, noise))


@compiled
def _surfaces(
    scan: tuple[Array, Array, Bools, Bools, Ints],
    lines: tuple[Array, Ints, Ints, int],
    noise: tuple[float, float, float],
) -> tuple[Array, Array, Array]:
    """See `surfaces_of`: points, normals and sigmas; the third of `scan` are the hits that are on a wall.

    `noise`: the least standard deviation of a raw range (m), the share of the range, the number of standard deviations.
    """
    (ranges, bearings, solid, hit, count), (line, first, last, roll) = scan, lines
    size, (least_m, of_range, sigmas_apart) = ranges.shape[0], noise
    points, normals, sigmas, n = np.empty((size, 2)), np.zeros((size, 2)), np.empty(size), 0
    for i in range(line.shape[0]):
        for position in range(first[i], last[i] + 1):
            beam = (roll + position) % size
            normals[beam, 0], normals[beam, 1] = -math.cos(line[i, 0]), -math.sin(line[i, 0])
    for beam in range(size):
        flat = normals[beam, 0] != 0.0 or normals[beam, 1] != 0.0
        if not (solid[beam] or (hit[beam] and flat)):
            continue
        points[n, 0], points[n, 1] = ranges[beam] * math.cos(bearings[beam]), ranges[beam] * math.sin(bearings[beam])
        normals[n, 0], normals[n, 1] = normals[beam, 0], normals[beam, 1]
        sigma = max(least_m, of_range * ranges[beam]) / math.sqrt(max(count[beam], 1))
        sigmas[n] = sigma if flat else sigmas_apart * sigma  # another scan may have hit the same thing beside it
        n += 1
    return points[:n].copy(), normals[:n].copy(), sigmas[:n].copy()


def joined_surfaces(parts: Sequence[Surfaces]) -> Surfaces:
    """All surfaces of at least one part, in one frame."""
    points, normals, sigmas = zip(*((part.points, part.normals, part.sigmas) for part in parts), strict=True)
    return Surfaces(np.concatenate(points), np.concatenate(normals), np.concatenate(sigmas))


@dataclass(frozen=True, slots=True)
class RegistrationLimits:
    """What a registration takes from the configuration of the estimator."""

    reach_m: float  # two points that are paired are no farther apart, at first; at last
    near_m: float
    turn_rad: float  # off the prior's heading, that is tried at most
    inside_m: float  # a point so far in front of what the past scan saw is on floor that was free
    facing: float  # cosine of the angle between the normals of two points that are paired, at least
    least_pairs: int
    least_share: float  # of the points that agree
    alike_beams: int  # neighbours whose errors are one
    gate: float  # NIS of a registration against its prior
    sure: float  # log-odds that the prior is right, before a scan says otherwise

    @classmethod
    def of(cls, config: SlamConfig) -> RegistrationLimits:
        """The limits that a configuration implies."""
        facing = math.cos(math.radians(config.association.descriptor_deg))
        reach, least = (config.panorama.spacing_m, config.corners.line_m), config.segments.min_beams
        free = config.panorama.spacing_rad, config.corners.detail_m
        gate = float(chdtri(3, 1.0 - config.association.gate_probability))
        share, sure = config.localisation.explained_share, config.localisation.sure
        return cls(*reach, *free, facing, 4 * least, share, least, gate, sure)

    @property
    def clear_share(self) -> float:
        """The share that leaves nothing to try."""
        return 1.0 - 0.25 * (1.0 - self.least_share)

    @property
    def turns(self) -> Array:
        """(7,) rad: off the prior's heading, tried in turn; the nearest first."""
        return self.turn_rad / 3.0 * np.array([0, 1, -1, 2, -2, 3, -3])


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where a scan was taken, in the frame of a past one."""

    T_past_now: Array  # (3,)
    information: Array  # (3,3) of x, y, heading, as if every point told something of its own
    paired: Ints  # (p,) points of the scan that lie on a past surface
    against: int  # how many others lie on floor that was free

    @property
    def lead(self) -> int:
        """By how many points more agree than do not."""
        return len(self.paired) - self.against

    @property
    def share(self) -> float:
        """Of the points that agree or do not, those that agree."""
        return len(self.paired) / (len(self.paired) + self.against)

    def score(self, prior: Prior, limits: RegistrationLimits) -> float:
        """The logarithm of its odds: a group of neighbours that agree or do not counts one, the prior as a Gaussian."""
        return self.lead / limits.alike_beams - 0.5 * self.nis(prior, limits)

    def is_clear(self, prior: Prior, limits: RegistrationLimits) -> bool:
        """True when it leaves nothing to try: nearly all points agree, and the prior allows for it well."""
        return self.share >= limits.clear_share and self.nis(prior, limits) < 0.5 * limits.gate

    def is_allowed(self, prior: Prior, limits: RegistrationLimits) -> bool:
        """True when most points agree, and the prior allows for it."""
        return self.share >= limits.least_share and self.nis(prior, limits) < limits.gate

    def is_sound(self, prior: Prior, limits: RegistrationLimits) -> bool:
        """True when the prior allows for it, and when nearly all points agree, whatever the prior says."""
        return self.share >= limits.clear_share or self.is_allowed(prior, limits)

    def is_possible(self, prior: Prior, limits: RegistrationLimits) -> bool:
        """True when most points agree where the prior expects it: no sign of another place."""
        return self.lead > 0 and self.nis(prior, limits) < 0.5 * limits.gate

    def nis(self, prior: Prior, limits: RegistrationLimits) -> float:
        """Normalised innovation squared: how far it is from the prior, by the covariance of both."""
        off = self.T_past_now - prior[0]
        off[2] = wrap_angle(off[2])
        return float(quadratic(inverse3(prior[1] + self.cov(limits)), off, off))

    def cov(self, limits: RegistrationLimits) -> Array:
        """(3,3) covariance of `T_past_now`: neighbouring points err together; large where nothing tells."""
        left_open = np.diag([limits.reach_m**-2, limits.reach_m**-2, limits.turn_rad**-2])
        cov: Array = inverse3(self.information / limits.alike_beams + left_open)
        return cov


def register(
    past: Surfaces, now: Surfaces, past_beams: MergedScan, prior: Prior, limits: RegistrationLimits
) -> Registration | None:
    """The best registration, sound or not; None where too few points meet.

    `prior` is T_past_now (3,) with its covariance (3,3); `past_beams` belong to the past scan in whose frame all is.
    Points on no flat surface are asked only where the others do not suffice, or say what the prior hardly allows:
    where a wall leaves the laser's range, or is seen at a glancing angle, they move with the robot.
    """
    flat = _sound(register_all(past.flat(), now.flat(), past_beams, prior, limits), prior, limits)
    if flat and flat.nis(prior, limits) < 0.5 * limits.gate:
        return flat
    told = () if flat is None else (flat.T_past_now,)
    every = register_all(past, now, past_beams, prior, limits, told)
    return _sound(every, prior, limits) or flat or every


def _sound(found: Registration | None, prior: Prior, limits: RegistrationLimits) -> Registration | None:
    return found if found and found.is_sound(prior, limits) else None


def likelier(
    kept: Registration | None,
    free: Registration | None,
    prior: Prior,
    failed: Prior,
    limits: RegistrationLimits,
) -> Registration | None:
    """A registration that the `prior` allows, or one by which odometry `failed`; None where neither is sound.

    `failed`: the prior with all by which odometry may have been wrong. That it was is `limits.sure` less likely.
    """
    kept = kept if kept and kept.is_allowed(prior, limits) else None
    if free is None or not free.is_clear(failed, limits):
        return kept
    least = max(kept.score(prior, limits), 0.0) if kept else 0.0
    return free if free.score(failed, limits) - limits.sure > least else kept


def register_all(
    past: Surfaces,
    now: Surfaces,
    past_beams: MergedScan,
    prior: Prior,
    limits: RegistrationLimits,
    told: Sequence[Array] = (),
) -> Registration | None:
    """As `register`, of all points alike; poses that something else has `told` are tried beside turns of the prior."""
    if min(len(past), len(now)) < limits.least_pairs:
        return None
    known, found, best = (past, index_of(past.points)), list[Registration](), None
    for start in (*told, *(prior[0] + [0.0, 0.0, turn] for turn in limits.turns)):
        found += _from(start, known, now, past_beams, prior, limits)
        best = max(found, key=lambda one: one.score(prior, limits), default=None)
        if best and best.is_clear(prior, limits):
            break
    return best


def _from(
    T: Array,
    past: tuple[Surfaces, Index],
    now: Surfaces,
    past_beams: MergedScan,
    prior: Prior,
    limits: RegistrationLimits,
) -> list[Registration]:
    """Gauss-Newton from a start, none where too few points meet; those that are paired come nearer with every step."""
    spread = 3.0 * math.sqrt(np.trace(prior[1]))
    near = max(limits.near_m, 3.0 * float(np.median(now.sigmas) + np.median(past[0].sigmas)))
    reaches, known = (max(min(spread, limits.reach_m), near), near), (prior[0], inverse3(prior[1]))
    pairing = limits.facing, limits.least_pairs
    T, information, meets = align(past[0].plain, past[1], now.plain, T, known, reaches, pairing)
    if not meets.any():
        return []
    points, beams = to_map(T, now.points), (past_beams.bearings, past_beams.ranges)
    against = count_against(points, ~meets, *beams, limits.inside_m)
    return [Registration(T, information, np.flatnonzero(meets), against)]
