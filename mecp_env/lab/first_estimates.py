"""The filter `fej`: an EKF whose Jacobians are all taken at first estimates.

Turning and moving the map together with the robot changes no measurement. With the Jacobians of the plain EKF these
directions are lost: each is taken at another estimate, and what all of them leave unobserved has no heading. At first
estimates, every H and F leaves the same three directions: 1 for the heading, J p and J l_i for the position at its last
prediction and the landmarks when they were initialised; and two that move all.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.linalg import factor_lower, forward_rows, mirror_lower, solve_lower
from mecp_env.core.se2 import wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters.core import Ekf
from mecp_env.slam.filters.models import (
    change_chart,
    innovation_cov,
    linearise,
    project,
    propagate_plain,
    residual,
    retract,
)
from mecp_env.slam.filters.update import CONVERGED, apply_update, state_increment, take
from mecp_env.slam.filters.window import FAR, as_floats, centre_nis, finite, observations
from mecp_env.slam.protocols import FilterError

NO_NOISE = np.zeros((3, 3))


class FirstEstimateEkf(Ekf):
    """EKF-SLAM with first-estimates Jacobians (FEJ).

    `first` (3+2N,) has the order of the mean: the pose that the last prediction ended at, and each landmark as it was
    initialised. Jacobians are taken there, in iterated updates as well; the innovation is that of the estimate. Where
    first estimates are poor, so are the Jacobians.

    Source: Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators",
    International Journal of Robotics Research 29(5), 2010.
    """

    def __init__(self, config: FilterConfig) -> None:
        super().__init__(config)
        self.first: Array = np.zeros(3)

    def predict(self, odometry: Odometry) -> None:
        self._settle_pose()
        super().predict(odometry)
        self.first[:3] = self.mean[:3]

    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        z, R, ids = observations(z, R, ids)
        if len(ids) == 0:
            return
        steps = self.update_iterations if iterate else 1
        cost, W, xi = solved(self.state, self.first, self._slots(ids), z, R, steps)
        if math.isnan(cost) or not apply_update(self.state, self.slot_ids, W, xi, self.invariant):
            raise FilterError(f"update: covariance is not positive, or a number not finite ({len(ids)} measurements)")

    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        self._settle_pose()
        super().augment(z, R, ids)
        self.first = np.concatenate((self.first, self.mean[len(self.first) : self.size]))

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        z, R, ids = observations(z, R, ids)
        slots, nu = self._slots(ids), np.empty(2 * len(ids))
        A, a_heading = jacobian(self.first, slots)
        residual(z, predicted(self.mean, slots), A, a_heading, slots, np.zeros(self.size), nu)
        return nu, spread(self.state, self.size, A, a_heading, slots, R)[1]

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        z, R, slots = as_floats(z), as_floats(R), self._slots(ids)
        A, a_heading = jacobian(self.first, slots)
        H = np.concatenate((A, a_heading[:, :, None]), axis=2)  # by l - p and the heading
        HP = np.einsum("mri,mij->mrj", H, offset_covs(self.cov, slots))
        S, h = np.einsum("mrj,msj->rsm", HP, H), predicted(self.mean, slots)
        u, v = z[:, :1] - h[:, 0], wrapped(z[:, 1:] - h[:, 1])
        uu, uv, vv = (R[:, r, s, None] + S[r, s] for r, s in ((0, 0), (1, 0), (1, 1)))
        det = uu * vv - uv * uv
        near = (u * u < FAR * uu) & (v * v < FAR * vv) & (det > 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            nis: Array = np.where(near, (vv * u * u - 2.0 * uv * u * v + uu * v * v) / det, math.inf)
        return nis

    def joint_nis(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Least joint cost of the pairs; where it is iterated, with Jacobians at each step's estimate, as `ekf`."""
        if iterate:
            return super().joint_nis(z, R, ids, iterate)
        z, R, ids = observations(z, R, ids)
        cost, _, _ = solved(self.state, self.first, self._slots(ids), z, R, 1)
        return finite(cost, "joint_nis", self.window(ids), ids)

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        nu, S = self.innovation(z, R, ids)
        A, a_heading = jacobian(self.first, self._slots(ids))
        D = np.concatenate((-A, a_heading[:, :, None]), axis=2).reshape(-1, 3)  # by x, y, heading
        wider = S + np.einsum("ri,ij,sj->rs", D, pose_cov, D)
        if not (factor_lower(S) and factor_lower(wider)):
            raise FilterError("log_bayes_factor: innovation covariance is not positive")
        likelier = (solve_lower(S, nu) ** 2).sum() - (solve_lower(wider, nu) ** 2).sum()
        return float(likelier - 2.0 * np.log(np.diagonal(wider) / np.diagonal(S)).sum())

    def mean_of_gaussians_nis(self, z: Array, R: Array, ids: Ints, paper_S: bool = False) -> float:
        z, R, ids = observations(z, R, ids)
        part = take(self.state, self._slots(ids))
        if not paper_S:  # in coordinates without the heading's column, as those of the invariant error
            mean = part[0].copy()
            part[0, :3], part[0, 3:] = self.first[:3], self.first[3:].reshape(-1, 2)[self._slots(ids)].ravel()
            change_chart(part, len(mean), -1.0, True)
            part[0] = mean
        nis = centre_nis(part, ids, ids, z, R, not paper_S, paper_S)
        return finite(nis, "mean_of_gaussians_nis", self.window(ids), ids)

    def fuse(self, keep: int, drop: int) -> None:
        """Merge two landmarks that are one corner.

        Before, the first estimate of `drop` becomes that of `keep`: else their difference would say something of the
        heading.
        """
        kept, gone = 3 + 2 * self._slots(np.array([keep, drop]))
        self._move_first(gone, self.first[kept : kept + 2])
        super().fuse(keep, drop)

    def remove(self, ids: Ints) -> None:
        kept = np.setdiff1d(np.arange(self.count), self._slots(ids))
        super().remove(ids)
        self.first = np.concatenate((self.first[:3], self.first[3:].reshape(-1, 2)[kept].ravel()))

    def copy(self) -> Self:
        other = super().copy()
        other.first = self.first.copy()
        return other

    def set_pose(self, T_map_robot: Array, pose_cov: Array | None = None) -> None:
        super().set_pose(T_map_robot, pose_cov)
        self.first[:3] = self.mean[:3]

    def shift_pose(self, T_old_new: Array) -> None:
        self._settle_pose()
        super().shift_pose(T_old_new)
        self.first[:3] = self.mean[:3]

    def _settle_pose(self) -> None:
        """Take the Jacobians by the pose at its present estimate from now on: a prediction without motion."""
        propagate_plain(self.state, self.size, self.mean[1:3] - self.first[1:3], NO_NOISE)
        self.first[:3] = self.mean[:3]

    def _move_first(self, at: int, point: Array) -> None:
        """Put the first estimate of the landmark at number `at` to `point` (2,), as `_settle_pose` does the pose's."""
        dx, dy = point - self.first[at : at + 2]
        by_heading, cov, size = np.array([-dy, dx]), self.cov, self.size
        cov[at : at + 2, :size] += np.outer(by_heading, cov[0, :size])
        cov[:size, at : at + 2] += np.outer(cov[:size, 0], by_heading)
        mirror_lower(cov, size)
        self.first[at : at + 2] = point


def solved(state: Array, first: Array, slots: Ints, z: Array, R: Array, iterations: int) -> tuple[float, Array, Array]:
    """Least prior + measurement cost over the error of the state, as `gauss_newton`, with H at first estimates.

    The cost, W = L^-1 H P (2m,w), S = L L^T, and the error xi (n,). The cost is nan where S is not positive or xi not
    finite.
    """
    xi = np.zeros(len(first))
    A, a_heading = jacobian(first, slots)
    W, S = spread(state, len(first), A, a_heading, slots, R)
    if not factor_lower(S):
        return math.nan, W, xi
    forward_rows(S, W)
    y, nu, x = np.empty(len(S)), np.empty(len(S)), np.empty(len(first))
    for _ in range(iterations):
        x[:] = state[0, : len(first)]
        retract(x, len(x), xi, False)
        residual(z, predicted(x, slots), A, a_heading, slots, xi, nu)
        y = solve_lower(S, nu)
        step = state_increment(W, y, xi)
        if not step < math.inf:
            return math.nan, W, xi
        if step < CONVERGED:
            break
    return float((y * y).sum()), W, xi


def offset_covs(cov: Array, slots: Ints) -> Array:
    """(m,3,3) covariance of l - p and the heading, for the landmarks at `slots` (m,)."""
    x, y = 3 + 2 * slots, 4 + 2 * slots
    covs = np.empty((len(slots), 3, 3))
    covs[:, 0, 0] = cov[x, x] - 2.0 * cov[1, x] + cov[1, 1]
    covs[:, 0, 1] = covs[:, 1, 0] = cov[x, y] - cov[1, y] - cov[2, x] + cov[1, 2]
    covs[:, 1, 1] = cov[y, y] - 2.0 * cov[2, y] + cov[2, 2]
    covs[:, 0, 2] = covs[:, 2, 0] = cov[0, x] - cov[0, 1]
    covs[:, 1, 2] = covs[:, 2, 1] = cov[0, y] - cov[0, 2]
    covs[:, 2, 2] = cov[0, 0]
    return covs


def jacobian(at: Array, slots: Ints) -> tuple[Array, Array]:
    """A (m,2,2) and a_heading (m,2) of `linearise` at a state (n,)."""
    m = len(slots)
    A, a_heading = np.empty((m, 2, 2)), np.empty((m, 2))
    linearise(at, slots, False, np.empty((m, 2)), A, a_heading)
    return A, a_heading


def predicted(at: Array, slots: Ints) -> Array:
    """Range and bearing (m,2) of landmarks as a state (n,) has them."""
    m = len(slots)
    h = np.empty((m, 2))
    linearise(at, slots, False, h, np.empty((m, 2, 2)), np.empty((m, 2)))
    return h


def spread(state: Array, n: int, A: Array, a_heading: Array, slots: Ints, R: Array) -> tuple[Array, Array]:
    """H P (2m,w) and S (2m,2m)."""
    HP, S = project(state[1:], n, A, a_heading, slots), np.empty((2 * len(slots), 2 * len(slots)))
    innovation_cov(HP, A, a_heading, slots, R, S)
    return HP, S
