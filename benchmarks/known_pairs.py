"""Drives with known correspondences: what every filter and the batch optimum get, and a filter that runs on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from benchmarks.drives import Drive, nees
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import between, compose, inverse, to_map, to_robot, wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import Filter, SubmapEkf, make_filter
from mecp_env.slam.frontend import front_end
from mecp_env.slam.messages import Belief

FLOOR = 1e-10  # m^2, rad^2, of a motion, so that its covariance is positive at rest
OUTLIER_2, OUTLIER_3 = float(chi2.ppf(0.999, 2)), float(chi2.ppf(1.0 - 1e-6, 3))
SLIP_SIGMAS = np.array([0.5, 0.1, 0.2])  # m, m, rad: what the batch optimum allows for in a step with slip


class Sighting(NamedTuple):
    """What the robot measured at one pose."""

    z: Array  # (n,2) m, rad
    R: Array  # (2n,2n)
    ids: Ints  # (n,) true landmarks, each once

    def part(self, chosen: Bools) -> Sighting:
        """Some of the measurements; `chosen` (n,) says which."""
        rows = np.repeat(chosen, 2)
        return Sighting(self.z[chosen], self.R[np.ix_(rows, rows)], self.ids[chosen])


class Motion(NamedTuple):
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


class Record(NamedTuple):
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


def polar(p_robot: Array) -> Array:
    """(n,2) m, rad: range and bearing of points (n,2)."""
    return np.stack([np.hypot(*p_robot.T), np.arctan2(p_robot[:, 1], p_robot[:, 0])], axis=1)


def cycle(estimate: Filter, sighting: Sighting, correct: Callable[[Sighting], Any]) -> None:
    """Correct a filter by the landmarks that it knows, and take in the others."""
    known = np.isin(sighting.ids, estimate.ids)
    if known.any():
        correct(sighting.part(known))
    estimate.augment(*sighting.part(~known))


Correct = Callable[[Filter, Sighting, Odometry | None], None]  # by known landmarks, after a motion or at the start


def filtered(record: Record, estimate: Filter, correct: Correct) -> Iterator[Belief]:
    """Run a filter on a record: predict, `correct`, take in new landmarks; what it believes after each pose."""
    estimate.set_pose(record.start, record.start_cov)
    for motion, sighting in zip([None, *record.motions], record.sightings, strict=True):
        odometry = motion.odometry if motion else None
        if odometry is not None:
            estimate.predict(odometry)
        if motion is not None and motion.lacking is not None:
            estimate.loosen(turned(motion.lacking, estimate.belief().T_map_robot[2]))
        cycle(estimate, sighting, lambda seen, moved=odometry: correct(estimate, seen, moved))
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
    T_world_map, config = drive.T_world_robot[0], drive.slam.filter
    corners = to_map(inverse(T_world_map), drive.truth.outline.corners.p_world)
    moving = [k for k, odometry in enumerate(drive.odometry) if odometry is not None or k == 0]  # the others: at rest
    path = between(T_world_map, np.array([drive.T_world_robot[k] for k in moving]))
    motions = [Motion.of_odometry(odometry, config) for odometry in drive.odometry if odometry is not None]
    if slips:
        steps = between(path[:-1], path[1:])
        motions = [with_slip(motion, step) for motion, step in zip(motions, steps, strict=True)]
    sightings = [seen(drive, k, to_robot(T, corners)) for k, T in zip(moving, path, strict=True)]
    sigmas = np.array([config.prior_sigma_m, config.prior_sigma_m, config.prior_sigma_rad])
    return Record(np.zeros(3), np.diag(sigmas**2), motions, sightings), path, corners


def with_slip(motion: Motion, T_true: Array) -> Motion:
    """The motion; where its covariance denies the true one (3,), that of the batch optimum allows for slip."""
    error = compose(inverse(motion.T), T_true)
    if error @ np.linalg.solve(motion.cov + FLOOR * np.eye(3), error) < OUTLIER_3:
        return motion
    return motion._replace(cov=motion.cov + np.diag(SLIP_SIGMAS**2))


def seen(drive: Drive, step: int, p_robot: Array) -> Sighting:
    """The corners of a scan that are true ones, without outliers; `p_robot` (m,2) are all true corners."""
    corners = front_end(drive.scans[step], drive.slam).corners
    true = drive.truth.identify(corners, drive.T_world_robot[step])
    row = np.flatnonzero((true >= 0) & (true < len(p_robot)))
    errors = corners.z[row] - polar(p_robot[true[row]])
    errors[:, 1] = wrapped(errors[:, 1])
    row = row[nees(errors, corners.R[row]) < OUTLIER_2]
    return Sighting(*corners.measurements(row), true[row])
