"""Drives with known correspondences: what every filter and the batch optimum get, and a filter that runs on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.drives import Drive
from benchmarks.errors import nees
from benchmarks.rough_pose import front_end
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import compose, inverse, to_map, to_robot, wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import Filter, SubmapEkf, make_filter
from mecp_env.slam.messages import Belief

FLOOR = 1e-10  # m^2, rad^2, of a motion, so that its covariance is positive at rest
OUTLIER_2, OUTLIER_3 = float(chi2.ppf(0.999, 2)), float(chi2.ppf(1.0 - 1e-6, 3))
SLIP_SIGMAS = np.array([0.5, 0.1, 0.2])  # m, m, rad: what the batch optimum allows for in a step with slip


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What the robot measured at one pose."""

    z: Array  # (n,2) m, rad
    R: Array  # (2n,2n)
    ids: Ints  # (n,) true landmarks, each once

    def part(self, chosen: Bools) -> Sighting:
        """Some of the measurements; `chosen` (n,) says which."""
        rows = np.repeat(chosen, 2)
        return Sighting(self.z[chosen], self.R[np.ix_(rows, rows)], self.ids[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion to the next pose as it was measured."""

    odometry: Odometry  # for the filters
    T: Array  # (3,) the next pose in the frame of this one
    cov: Array  # (3,3) of x, y, heading, in the frame of the next pose (the twist of GTSAM)
    lacking: Array | None = None  # (3,3) the part of `cov` that is not in the odometry, and the filters know

    @classmethod
    def of_odometry(cls, odometry: Odometry, config: FilterConfig) -> Motion:
        """The motion and the noise that a filter predicts of it."""
        start = make_filter(config.model_copy(update={"kind": "ekf", "prior_sigma_m": 1e-9, "prior_sigma_rad": 1e-9}))
        start.predict(odometry)
        moved = start.belief()
        cov = turned(moved.pose_cov, -moved.T_map_robot[2]) + FLOOR * np.eye(3)
        return cls(odometry, moved.T_map_robot, cov)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A drive with known correspondences: what every filter and the batch optimum get."""

    start: Array  # (3,) the first pose
    start_cov: Array  # (3,3)
    motions: list[Motion]
    sightings: list[Sighting]  # at the first pose and after each motion


def turned(cov: Array, angle: float) -> Array:
    """(3,3) covariance of x, y, heading in axes that are turned by -angle."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ cov @ R.T


Correct = Callable[[Filter, Sighting, Odometry | None], None]  # by known landmarks, after a motion or at the start


def filtered(record: Record, estimate: Filter, correct: Correct) -> Iterator[Belief]:
    """Run a filter on a record: predict, `correct`, take in new landmarks; what it believes after each pose."""
    estimate.set_pose(record.start, record.start_cov)
    for motion, sighting in zip([None, *record.motions], record.sightings, strict=True):
        if motion is not None:
            estimate.predict(motion.odometry)
        if motion is not None and motion.lacking is not None:
            estimate.loosen(turned(motion.lacking, estimate.belief().T_map_robot[2]))
        known = np.isin(sighting.ids, estimate.ids)
        if known.any():
            correct(estimate, sighting.part(known), motion.odometry if motion else None)
        new = sighting.part(~known)
        estimate.augment(new.z, new.R, new.ids)
        yield estimate.belief()


def in_order(estimate: Filter) -> tuple[Array, Array]:
    """Landmarks (m,2) and their covariances (m,2,2) by ascending id, after a last synchronisation of submaps."""
    if isinstance(estimate, SubmapEkf):
        estimate.synchronise()
    belief = estimate.belief()
    order = np.argsort(belief.ids)
    return belief.p_map[order], belief.covs[order]


def measured(drive: Drive, slips: bool = False) -> tuple[Record, Array, Array]:
    """The record of a drive, its true path (n,3), and the true corners (m,2), in the frame of the first pose."""
    T_map_world = inverse(drive.T_world_robot[0])
    corners, config = to_map(T_map_world, drive.truth.outline.corners.p_world), drive.slam.filter
    motions, sightings, path = list[Motion](), list[Sighting](), list[Array]()
    for odometry, scan, T_world_robot in zip(drive.odometry, drive.scans, drive.T_world_robot, strict=True):
        if odometry is None and sightings:
            continue  # at rest
        T_map_robot = compose(T_map_world, T_world_robot)
        if odometry is not None:
            motion = Motion.of_odometry(odometry, config)
            motions.append(with_slip(motion, compose(inverse(path[-1]), T_map_robot)) if slips else motion)
        sightings.append(seen(drive, scan, T_world_robot, to_robot(T_map_robot, corners)))
        path.append(T_map_robot)
    sigmas = np.array([config.prior_sigma_m, config.prior_sigma_m, config.prior_sigma_rad])
    return Record(np.zeros(3), np.diag(sigmas**2), motions, sightings), np.array(path), corners


def with_slip(motion: Motion, T_true: Array) -> Motion:
    """The motion; where its covariance denies the true one (3,), that of the batch optimum allows for slip."""
    error = compose(inverse(motion.T), T_true)
    if error @ np.linalg.solve(motion.cov + FLOOR * np.eye(3), error) < OUTLIER_3:
        return motion
    return Motion(motion.odometry, motion.T, motion.cov + np.diag(SLIP_SIGMAS**2))


def seen(drive: Drive, scan: Any, T_world_robot: Array, p_robot: Array) -> Sighting:
    """The corners of a scan that are true ones, without outliers; `p_robot` (m,2) are all true corners."""
    corners = front_end(scan, drive.slam)[0]
    true = drive.truth.identify(corners, T_world_robot)
    row = np.flatnonzero((true >= 0) & (true < len(p_robot)))
    x, y = p_robot[true[row]].T
    errors = corners.z[row] - np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=1)
    errors[:, 1] = wrapped(errors[:, 1])
    blocks = np.array([corners.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in row]).reshape(-1, 2, 2)
    row = row[nees(errors, blocks) < OUTLIER_2]
    return Sighting(*corners.measurements(row), true[row])
