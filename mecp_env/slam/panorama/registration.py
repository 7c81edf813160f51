"""Register the surfaces of a scan with those of past ones: nearest points, from point to line (Censi 2008, PLICP).

The prior of the pose holds what the surfaces leave open, as along a corridor; it is no part of the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.messages import MergedScan
from mecp_env.slam.panorama.surfaces import Surfaces

Prior = tuple[Array, Array]  # T_past_now (3,) and its covariance (3,3)


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

    @classmethod
    def of(cls, config: SlamConfig) -> RegistrationLimits:
        """The limits that a configuration implies."""
        facing = math.cos(math.radians(config.association.descriptor_deg))
        reach, least = (config.panorama.spacing_m, config.corners.line_m), config.segments.min_beams
        free = config.panorama.spacing_rad, config.corners.detail_m
        gate = float(chdtri(3, 1.0 - config.association.gate_probability))
        return cls(*reach, *free, facing, 4 * least, config.localisation.explained_share, least, gate)

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

    def is_sound(self, prior: Prior, limits: RegistrationLimits) -> bool:
        """True when nearly all points agree, and when most do and the prior allows for it."""
        if self.share >= limits.clear_share or self.share < limits.least_share:
            return self.share >= limits.clear_share
        return self.nis(prior, limits) < limits.gate

    def nis(self, prior: Prior, limits: RegistrationLimits) -> float:
        """Normalised innovation squared: how far it is from the prior, by the covariance of both."""
        off = self.T_past_now - prior[0]
        off[2] = wrap_angle(off[2])
        return float(off @ np.linalg.solve(prior[1] + self.cov(limits), off))

    def cov(self, limits: RegistrationLimits) -> Array:
        """(3,3) covariance of `T_past_now`: neighbouring points err together; large where nothing tells."""
        left_open = np.diag([limits.reach_m**-2, limits.reach_m**-2, limits.turn_rad**-2])
        return np.linalg.inv(self.information / limits.alike_beams + left_open).astype(np.float64)


def register(
    past: Surfaces, now: Surfaces, past_beams: MergedScan, prior: Prior, limits: RegistrationLimits
) -> Registration | None:
    """The registration with the largest lead; None where too few points meet, or too few of them agree.

    `prior` is T_past_now (3,) with its covariance (3,3); `past_beams` belong to the past scan in whose frame all is.
    Points on no flat surface are asked only where the others do not suffice, or say what the prior hardly allows:
    where a wall leaves the laser's range, or is seen at a glancing angle, they move with the robot.
    """
    flat = register_all(past.flat(), now.flat(), past_beams, prior, limits)
    if flat and flat.nis(prior, limits) < 0.5 * limits.gate:
        return flat
    found = [one for one in (register_all(past, now, past_beams, prior, limits), flat) if one]
    return min(found, key=lambda one: one.nis(prior, limits), default=None)


def register_all(
    past: Surfaces, now: Surfaces, past_beams: MergedScan, prior: Prior, limits: RegistrationLimits
) -> Registration | None:
    """As `register`, of all points alike."""
    if min(len(past), len(now)) < limits.least_pairs:
        return None
    known, found = (past, cKDTree(past.points)), list[Registration]()
    for turn in limits.turns:
        found += _from(prior[0] + [0.0, 0.0, turn], known, now, past_beams, prior, limits)
        best = max(found, key=lambda one: one.lead, default=None)
        if best and best.share >= limits.clear_share:
            break
    return best if best and best.is_sound(prior, limits) else None


def _from(
    T: Array,
    past: tuple[Surfaces, cKDTree],
    now: Surfaces,
    past_beams: MergedScan,
    prior: Prior,
    limits: RegistrationLimits,
) -> list[Registration]:
    """Gauss-Newton from a start, none where too few points meet; those that are paired come nearer with every step."""
    weight, spread = np.linalg.inv(prior[1]), 3.0 * math.sqrt(np.trace(prior[1]))
    near = max(limits.near_m, 3.0 * float(np.median(now.sigmas) + np.median(past[0].sigmas)))
    reach = max(min(spread, limits.reach_m), near)
    mine, information = np.empty(0, np.int64), np.zeros((3, 3))
    for _ in range(2 * math.ceil(math.log2(reach / near)) + 4):  # halved in two steps, then four more
        there = now.seen_from(T)
        mine, theirs = _pairs(past, there, reach, limits.facing)
        if len(mine) < limits.least_pairs:
            return []
        information, push = _normal_equations(past[0], there, (mine, theirs), T, reach)
        from_prior = T - prior[0]
        from_prior[2] = wrap_angle(from_prior[2])
        T = T - np.linalg.solve(information + weight, push + weight @ from_prior)
        reach = max(near, reach * math.sqrt(0.5))
    T[2] = wrap_angle(T[2])
    return [Registration(T, information, mine, _against(now.seen_from(T), mine, past_beams, limits.inside_m))]


def _against(there: Surfaces, paired: Ints, past_beams: MergedScan, inside_m: float) -> int:
    """How many points that are not paired lie on floor that the past scan saw free."""
    alone = np.delete(there.points, paired, axis=0)
    bearing = np.arctan2(alone[:, 1], alone[:, 0])
    inside = (bearing > past_beams.bearings[0]) & (bearing < past_beams.bearings[-1])
    seen = np.interp(bearing, past_beams.bearings, past_beams.ranges)
    return int((inside & (np.hypot(*alone.T) < seen - inside_m)).sum())


def _normal_equations(
    past: Surfaces, there: Surfaces, pairs: tuple[Ints, Ints], T: Array, reach_m: float
) -> tuple[Array, Array]:
    """J^T W J (3,3) and J^T W r (3,) of the distances along the normals, and in x and y where there are none."""
    mine, theirs = pairs
    normals = past.normals[theirs]
    loose = np.flatnonzero(~normals.any(axis=1))
    normals[loose] = 1.0, 0.0
    normals = np.concatenate((normals, np.broadcast_to([0.0, 1.0], (len(loose), 2))))
    rows = np.concatenate((np.arange(len(mine)), loose))
    sigmas = np.hypot(there.sigmas[mine], past.sigmas[theirs])[rows]
    off = (normals * (there.points[mine] - past.points[theirs])[rows]).sum(axis=1)
    arms = (there.points[mine] - T[:2])[rows]
    J = np.column_stack((normals, normals[:, 1] * arms[:, 0] - normals[:, 0] * arms[:, 1]))
    weights = 1.0 / (sigmas**2 + off**2 * (sigmas / np.maximum(sigmas, reach_m / 3.0)) ** 2)  # Cauchy
    return (J.T * weights) @ J, J.T @ (weights * off)


def _pairs(past: tuple[Surfaces, cKDTree], there: Surfaces, reach_m: float, facing: float) -> tuple[Ints, Ints]:
    """Points of now (p,) and the nearest of the past (p,), nearer than `reach_m`, whose surfaces face the same way."""
    surfaces, tree = past
    distance, at = tree.query(there.points, distance_upper_bound=reach_m)
    mine = np.flatnonzero(np.isfinite(distance))
    theirs: Ints = np.asarray(at)[mine]
    ours, other = there.normals[mine], surfaces.normals[theirs]
    loose = ~(ours.any(axis=1) & other.any(axis=1))
    alike = loose | ((ours * other).sum(axis=1) > facing)
    return mine[alike], theirs[alike]
