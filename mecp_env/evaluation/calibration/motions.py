"""Motions of the laser between scans of a log: by registration, beside what the odometry measured.

Scans by the stages of the estimator: surfaces for a registration, and the range noise about straight walls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import between, composed
from mecp_env.core.sensors import Scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend.clustering import beams_on_walls, cluster_beams
from mecp_env.slam.frontend.scan import merge_sweeps, restore_lost_beams
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import MergedScan, Segments
from mecp_env.slam.panorama.registration import RegistrationLimits, Surfaces, register_all, surfaces_of

SCANS = 60  # that tell the range noise, spread over a log
WIDE_M = 0.05  # range noise that straight walls are looked for with: with less than there is, they fall to pieces
LINE_BEAMS, LEAST_COSINE = 10, 0.7  # of a wall that tells the range noise: beams, and cosine of their incidence
TRIM = 2  # beams at each end of a line that may be on something else
STRAIGHT_SHARE = 0.9  # of the lines; the others may be no walls


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A scan as the registration takes it."""

    surfaces: Surfaces
    beams: MergedScan
    segments: Segments


def view(scan: Scan, config: SlamConfig) -> View:
    """The surfaces of a scan, by the stages of the estimator."""
    sensor = config.sensor
    beams = restore_lost_beams(merge_sweeps(scan, sensor), sensor)
    clusters = cluster_beams(beams, config.clustering, config.segments, sensor)
    segments = extract_segments(beams, clusters, config.segments, sensor)
    wall = beams_on_walls(clusters, beams)
    return View(surfaces_of(beams, segments, wall, sensor), beams, segments)


def range_noise(scan_at: Callable[[int], Scan], scans: int, config: SlamConfig) -> float:
    """m: the standard deviation of single beams about straight walls; nan where no wall is long enough.

    `scan_at` gives the scan of each of so many rows; `config` has the laser as far as it is known.
    """
    wide = config.model_copy(update={"sensor": config.sensor.model_copy(update={"range_sigma_m": WIDE_M})})
    rows = np.unique(np.linspace(0, scans - 1, min(SCANS, scans)).astype(np.int64)).tolist()
    variances = np.sort([variance for row in rows for variance in _variances(view(scan_at(row), wide))])
    kept = variances[: math.ceil(STRAIGHT_SHARE * len(variances))]
    return math.sqrt(float(kept.mean())) if len(kept) else math.nan


def _variances(seen: View) -> list[float]:
    """m^2: the variance of the ranges about each long line, as of a single beam."""
    beams, segments = seen.beams, seen.segments
    found, size = list[float](), len(beams.ranges)
    for (alpha, rho), first, last in zip(segments.line, segments.first, segments.last, strict=True):
        on = (segments.roll + np.arange(first + TRIM, last + 1 - TRIM)) % size
        cosine = np.cos(beams.bearings[on] - alpha)
        kept = beams.hit[on] & (cosine > LEAST_COSINE)
        on, cosine = on[kept], cosine[kept]
        if len(on) >= LINE_BEAMS:
            off = (beams.ranges[on] - rho / cosine) * np.sqrt(beams.count[on])
            design = np.column_stack((np.ones(len(on)), beams.bearings[on] - beams.bearings[on[0]]))
            off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
            found.append(float(off @ off) / (len(on) - 2))
    return found


LEAST_M, LEAST_RAD = 1.0, math.radians(30.0)  # of the motion between two scans that are registered, typically
AT_REST, STILL = 0.1, 1e-4  # of both: a motion of the laser, and a step of the odometry, up to which there is none
MOST_M, MOST_RAD = 3.0, math.radians(75.0)  # beyond, too little of a scan is seen again
BLOCK, BLOCKS = 8, 32  # successive motions that are registered together, and how many such blocks
PRIOR_M, PRIOR_RAD, GROWTH = 0.05, math.radians(3.0), 0.15  # sigmas of a prior at rest, and how they grow with a motion


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Motions of the robot by odometry and of the laser by registration, between scans that follow each other."""

    measured: Array  # (n,3) m, rad: of the robot
    laser: Array  # (n,3) m, rad: of the laser, in its frame
    cov: Array  # (n,3,3) of `laser`, by the noise of single beams
    alike: float  # by which it grows where neighbouring beams err together
    tried: int  # pairs of scans that were compared
    stride: int  # scans from one end of a motion to the other

    def __len__(self) -> int:
        return len(self.measured)


def registered_motions(scan_at: Callable[[int], Scan], T_odom_robot: Array, config: SlamConfig) -> Motions:
    """The motions of blocks of scans that are spread over a log, with odometry poses (n,3).

    `scan_at` gives the scan of a row; `config` has the laser as far as it is known.
    """
    limits = RegistrationLimits.of(config)
    found, tried = list[tuple[Array, Array, Array]](), 0
    moving, stride = _moving_rows(T_odom_robot)
    for rows in _blocks(moving[::stride]):
        views = [view(scan_at(int(row)), config) for row in rows]
        steps = between(T_odom_robot[rows[:-1]], T_odom_robot[rows[1:]])
        tried += len(steps)
        found += _registered(views, steps, config.sensor.T_robot_laser, limits)
    measured, laser, cov = (np.array([one[k] for one in found]) for k in range(3))
    shapes = measured.reshape(-1, 3), laser.reshape(-1, 3), cov.reshape(-1, 3, 3)
    return Motions(*shapes, float(limits.alike_beams), tried, stride)


def _registered(
    views: list[View], steps: Array, T_robot_laser: Array, limits: RegistrationLimits
) -> list[tuple[Array, Array, Array]]:
    """Of each step (m,3) between views that can be registered: the step, the motion of the laser, its covariance."""
    single = replace(limits, alike_beams=1)  # what neighbouring beams have in common is no noise of the odometry
    T_laser, found = between(T_robot_laser, composed(steps, T_robot_laser)), list[tuple[Array, Array, Array]]()
    for step, expected, past, now in zip(steps, T_laser, views[:-1], views[1:], strict=True):
        prior = expected, _prior(step)
        one = register_all(past.surfaces, now.surfaces, past.beams, prior, limits) if _is_short(step) else None
        if one is not None and one.is_sound(prior, limits) and _size(one.T_past_now[None])[0] > AT_REST:
            found.append((step, one.T_past_now, one.cov(single)))
    return found


def _moving_rows(T_odom_robot: Array) -> tuple[Ints, int]:
    """Rows of scans without those at rest, and how many of them apart a motion is long enough.

    That is the same everywhere: by the odometry between two scans, its noise would select the motions.
    """
    size = _size(between(T_odom_robot[:-1], T_odom_robot[1:]))
    rows = np.concatenate(([0], 1 + np.flatnonzero(size > STILL)))
    ascending = np.sort(size[rows[1:] - 1])
    typical = ascending[np.searchsorted(np.cumsum(ascending), 0.5 * ascending.sum())] if len(ascending) else 1.0
    return rows, math.ceil(0.9 / float(typical))


def _size(motions: Array) -> Array:
    """(n,) of motions (n,3), 1 for one that is worth registering."""
    size: Array = np.hypot(motions[:, 0], motions[:, 1]) / LEAST_M + abs(motions[:, 2]) / LEAST_RAD
    return size


def _blocks(rows: Ints) -> list[Ints]:
    """Some blocks of rows (m,), spread evenly; in each the last of one motion is the first of the next."""
    firsts = np.arange(0, len(rows) - 1, BLOCK)
    spread = np.linspace(0, len(firsts) - 1, min(BLOCKS, len(firsts))).astype(np.int64)
    return [rows[first : first + BLOCK + 1] for first in firsts[spread]]


def _is_short(step: Array) -> bool:
    return math.hypot(*step[:2]) < MOST_M and abs(float(step[2])) < MOST_RAD


def _prior(step: Array) -> Array:
    """(3,3) covariance of a motion (3,) by odometry of which nothing is known."""
    metres, turn = math.hypot(*step[:2]), abs(float(step[2]))
    spread_m, spread_rad = PRIOR_M + GROWTH * metres, PRIOR_RAD + GROWTH * (math.sqrt(metres) + turn)
    prior: Array = np.diag([spread_m, spread_m, spread_rad]) ** 2
    return prior
