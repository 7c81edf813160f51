"""The filters `riekf` and `ekf`: state, ids and slots, and the calls of the compiled functions."""

from __future__ import annotations

import math
import warnings
from typing import Self

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.arrays import find_rows
from mecp_env.core.linalg import block_of, mirror_lower
from mecp_env.core.messages import Odometry
from mecp_env.core.se2 import compose
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters.compatibility import centre_nis, joint_cost, log_bayes_factor, pairwise_nis
from mecp_env.slam.filters.error_state import change_chart, propagate_invariant, propagate_plain
from mecp_env.slam.filters.landmarks import append, take, world_belief
from mecp_env.slam.filters.measurement import innovation
from mecp_env.slam.filters.motion import predict
from mecp_env.slam.filters.update import batch_update, merge_pair
from mecp_env.slam.messages import NO_ID, Belief
from mecp_env.slam.protocols import FilterError, FullFilterWarning

FLOAT, INT, contiguous = np.float64, np.int64, np.ascontiguousarray  # looked up 20 times a step
NO_LANDMARKS = np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))
PINNED_SIGMA = 1e-6  # m and rad: a pose that is known exactly
POSE_ORDER = np.array([2, 0, 1])  # heading, x, y of a pose x, y, heading


class LandmarkFilter:
    """Pose and point landmarks under one joint Gaussian. Internal order: heading, x, y, l1x, l1y, ...

    All state is plain: numbers and arrays. `state` (4+2C,3+2C) is preallocated for C landmarks: the mean in its first
    row, below it the covariance of the error that `error_state` defines; the leading `size` numbers are in use.
    """

    invariant: bool

    def __init__(self, config: FilterConfig) -> None:
        self.lateral_var = config.bumper_lateral_sigma_m**2
        self.heading_var = math.radians(config.bumper_heading_sigma_deg) ** 2
        self.merge_var = config.prior_sigma_m**2
        self.update_iterations = config.update_iterations
        self.max_landmarks = config.max_landmarks
        self.dropped = 0
        self.slot_ids: Ints = np.empty(0, np.int64)  # (N,) id of the landmark in each slot
        self.state: Array = np.zeros((4, 3))
        self.state[1:] = np.diag([config.prior_sigma_rad**2, config.prior_sigma_m**2, config.prior_sigma_m**2])

    @property
    def mean(self) -> Array:
        """(3+2C,) a view of the state."""
        mean: Array = self.state[0]
        return mean

    @property
    def cov(self) -> Array:
        """(3+2C,3+2C) a view of the state."""
        cov: Array = self.state[1:]
        return cov

    @property
    def count(self) -> int:
        """How many landmarks there are."""
        return len(self.slot_ids)

    @property
    def held(self) -> int:
        """Landmarks and marks of past poses, of which there is room for `max_landmarks`."""
        return self.count

    @property
    def size(self) -> int:
        """Numbers in the state: 3 + 2 N."""
        return 3 + 2 * self.count

    @property
    def ids(self) -> Ints:
        """(N,) ids of the landmarks in the order of their initialisation; marks of past poses, below -1, left out."""
        return self.slot_ids[self.slot_ids > NO_ID]

    def has(self, landmark: int) -> bool:
        """True when the filter holds a landmark with this id."""
        return bool((self.slot_ids == landmark).any())

    def predict(self, odometry: Odometry) -> None:
        """Move the pose by the increments of one step; a bumper contact adds lateral and heading variance."""
        slip = 1.0 if odometry.bumper else 0.0
        lateral_var, heading_var = slip * self.lateral_var, slip * self.heading_var
        increments, covs = as_floats(odometry.increments), as_floats(odometry.cov)
        predict(self.state, self.size, increments, covs, lateral_var, heading_var, self.invariant)

    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        """Correct by all pairs z[i] - ids[i] at once; z (n,2), R (2n,2n), ids (n,); FilterError: S is not positive."""
        z, R, ids = observations(z, R, ids)
        if len(ids) == 0:
            return
        steps = self.update_iterations if iterate else 1
        if not batch_update(self.state, self.slot_ids, ids, z, R, self.invariant, steps):
            self._refuse_unknown(ids)
            raise FilterError(f"update: covariance is not positive, or a number not finite ({len(ids)} measurements)")

    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        """Take in new landmarks z (n,2), R (2n,2n), ids (n,), each id once; without room the last ones are dropped.

        The first ones that are dropped are reported by a `FullFilterWarning`.
        """
        z, R, ids = observations(z, R, ids)
        room = min(len(ids), self.max_landmarks - self.held)
        if not self.dropped and room < len(ids):
            warnings.warn(f"{self.max_landmarks} landmarks: new ones are dropped", FullFilterWarning, stacklevel=2)
        self.dropped += len(ids) - room
        if room == 0:
            return
        if len(set(ids.tolist())) < len(ids) or any(map(self.has, ids.tolist())):
            raise FilterError(f"augment: ids {ids.tolist()} must be new and differ")
        self._reserve(self.count + room)
        append(self.state, self.size, z[:room], R, self.invariant)
        self.slot_ids = np.concatenate((self.slot_ids, ids[:room]))

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        """nu (2n,) and S (2n,2n) of the pairs z[i] - ids[i]; z (n,2), R (2n,2n), ids (n,)."""
        z, R, ids = observations(z, R, ids)
        size = 2 * len(ids)
        nu, S = np.empty(size), np.empty((size, size))
        if not innovation(*self._part(ids), ids, z, R, self.invariant, nu, S):
            self._refuse_unknown(ids)
        return nu, S

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        """NIS (n,m) of every z (n,2), R (n,2,2) against every id (m,); inf where absurdly far."""
        z, R, ids = as_floats(z), as_floats(R), integers(ids)
        nis = np.empty((len(z), len(ids)))
        if not pairwise_nis(*self._part(ids, apart=True), ids, z, R, self.invariant, nis):
            self._refuse_unknown(ids)
        return nis

    def joint_nis(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Least cost (prior + residuals, 2n degrees of freedom) of the pairs over pose and map (derivations 3.2)."""
        z, R, ids = observations(z, R, ids)
        nis = joint_cost(*self._part(ids), ids, z, R, self.invariant, self.update_iterations if iterate else 1)
        return self._finite(nis, "joint_nis", ids)

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        """Twice the log of how much likelier the pairs are with a covariance (3,3) of x, y, heading more."""
        z, R, ids = observations(z, R, ids)
        factor = log_bayes_factor(*self._part(ids), ids, z, R, self.invariant, as_floats(pose_cov))
        return self._finite(factor, "log_bayes_factor", ids)

    def mean_of_gaussians_nis(self, z: Array, R: Array, ids: Ints, paper_S: bool = False) -> float:
        """NIS (2 degrees of freedom) of the centre of the points z (k,2) against the landmarks' (III-B.1, eq. 2-3).

        Differs from the paper: S has the cross term of pose and map; `paper_S` leaves it out.
        """
        z, R, ids = observations(z, R, ids)
        nis = centre_nis(*self._part(ids), ids, z, R, self.invariant, paper_S)
        return self._finite(nis, "mean_of_gaussians_nis", ids)

    def marginal(self, ids: Ints) -> tuple[Array, Array]:
        """Mean (3+2m,) x, y, heading, landmarks and covariance (3+2m,3+2m), world coordinates."""
        state, slot_ids = self._part(ids)
        part = take(state, slots_of(slot_ids, ids))
        size = part.shape[1]
        change_chart(part, size, 1.0, self.invariant)
        order = np.arange(size)
        order[:3] = 1, 2, 0
        return part[0, order], block_of(part[1:], order, order)

    def fuse(self, keep: int, drop: int) -> None:
        """Merge two landmarks that are one corner: l_keep - l_drop = 0 within the prior's sigma, then `drop` goes."""
        kept, gone = self._slots(np.array([keep, drop]))
        if kept == gone:
            raise FilterError(f"fuse: {keep} with itself")
        if not merge_pair(self.state, self.slot_ids, kept, gone, self.merge_var, self.invariant):
            raise FilterError(f"fuse: covariance of {keep} - {drop} is not positive")
        self.remove(np.array([drop]))

    def remove(self, ids: Ints) -> None:
        """Forget the landmarks ids (m,)."""
        slots = self._slots(ids)
        kept, gone = np.setdiff1d(np.arange(self.count), slots), int(slots.min(initial=self.count))
        moved, first, cov = np.ravel(3 + 2 * kept[gone:, None] + [0, 1]), 3 + 2 * gone, self.cov
        end = first + len(moved)  # what stands before the first one that goes stays where it is
        self.mean[first:end], cov[:first, first:end] = self.mean[moved], cov[:first, moved]
        cov[first:end, :first], cov[first:end, first:end] = cov[moved, :first], cov[np.ix_(moved, moved)]
        self.slot_ids = self.slot_ids[kept]

    def belief(self) -> Belief:
        """Pose and landmarks with their own covariances, in world coordinates, without marks of past poses; a copy."""
        pose, pose_cov, count = np.empty(3), np.empty((3, 3)), self.count
        p_map, covs = np.empty((count, 2)), np.empty((count, 2, 2))
        if world_belief(self.state, self.slot_ids, self.invariant, pose, pose_cov, p_map, covs):
            kept = self.slot_ids > NO_ID
            return Belief(pose, pose_cov, self.slot_ids[kept], p_map[kept], covs[kept])
        return Belief(pose, pose_cov, self.slot_ids.copy(), p_map, covs)

    def pose(self) -> tuple[Array, Array]:
        """The pose (3,) and its covariance (3,3), as in `belief`."""
        pose, pose_cov = np.empty(3), np.empty((3, 3))
        world_belief(self.state, NO_LANDMARKS[0], self.invariant, pose, pose_cov, *NO_LANDMARKS[1:])
        return pose, pose_cov

    def copy(self) -> Self:
        """An independent filter with the same state; later changes of one do not touch the other."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)  # as `copy.copy`, in a tenth of the time
        other.state = self.state[: 1 + self.size, : self.size].copy()  # the rest is capacity
        return other

    def set_pose(self, T_map_robot: Array, pose_cov: Array | None = None) -> None:
        """The pose (3,) x, y, heading is this, with a covariance (3,3) or exactly, whatever it was before.

        It is independent of the landmarks, which keep mean and world covariance.
        """
        pose_cov = np.eye(3) * PINNED_SIGMA**2 if pose_cov is None else pose_cov
        size, cov = self.size, self.cov
        change_chart(self.state, size, 1.0, self.invariant)
        self.mean[:3] = T_map_robot[POSE_ORDER]
        cov[:3, :size] = 0.0
        cov[:size, :3] = 0.0
        cov[:3, :3] = pose_cov[np.ix_(POSE_ORDER, POSE_ORDER)]
        change_chart(self.state, size, -1.0, self.invariant)

    def loosen(self, pose_cov: Array) -> None:
        """Odometry may be wrong by a covariance (3,3) of x, y, heading more; landmarks stay as sure as they are."""
        noise = np.ascontiguousarray(pose_cov[np.ix_(POSE_ORDER, POSE_ORDER)])
        if self.invariant:
            propagate_invariant(self.state, self.size, noise)
        else:
            propagate_plain(self.state, self.size, np.zeros(2), noise)

    def shift_pose(self, T_old_new: Array) -> None:
        """The pose becomes that of a frame at T_old_new (3,) in the present one, fixed to it.

        The invariant error acts from the left and stays as it is; the plain one of the position takes in the heading's.
        """
        heading, x, y = self.mean[:3].tolist()
        new_x, new_y, new_heading = compose(np.array([x, y, heading]), T_old_new).tolist()
        self.mean[:3] = new_heading, new_x, new_y
        if not self.invariant:
            size, by_heading, cov = self.size, np.array([y - new_y, new_x - x]), self.cov
            cov[1:3, :size] += np.outer(by_heading, cov[0, :size])
            cov[:size, 1:3] += np.outer(cov[:size, 0], by_heading)
            mirror_lower(cov, size)

    def _part(self, ids: Ints, apart: bool = False) -> tuple[Array, Ints]:
        """A state with the pose and at least the landmarks `ids` (m,), and the ids in its slots.

        `apart`: the covariance of one landmark with another may be missing.
        """
        return self.state, self.slot_ids

    def _slots(self, ids: Ints) -> Ints:
        return slots_of(self.slot_ids, ids)

    def _refuse_unknown(self, ids: Ints) -> None:
        """Raise `FilterError` when one of the ids is unknown to this filter."""
        self._slots(ids)

    def _finite(self, nis: float, name: str, ids: Ints) -> float:
        if math.isnan(nis):
            self._refuse_unknown(ids)
            raise FilterError(f"{name}: innovation covariance is not positive")
        return nis

    def _reserve(self, landmark_count: int) -> None:
        """Make room for so many landmarks; it grows by doubling."""
        capacity = self.state.shape[1] // 2 - 1
        if landmark_count <= capacity:
            return
        size = 3 + 2 * min(max(landmark_count, 2 * capacity), self.max_landmarks)
        old, self.state = self.state, np.zeros((1 + size, size))
        self.state[: len(old), : old.shape[1]] = old


class RightInvariantEkf(LandmarkFilter):
    """EKF-SLAM on SE_{N+1}(2): chi = (R, p, l_1, ..., l_N), chi_true = exp(xi) chi.

    Differs from the paper: moving the whole map with the robot stays unobservable whatever the linearisation point,
    so that the covariance does not shrink by information that was never measured. The error propagates with
    F = I; the price is that noise of the heading touches every landmark (one O(N^2) pass per prediction).

    After an update P is not carried to the new mean by the group's Jacobian: tried on the ring of rooms, that turned
    the unobservable directions a little in every update and raised the NEES of lap 2 from 3.0 to 9.2.

    Source: Barrau and Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv:1510.06263, 2015.
    """

    invariant = True


class Ekf(LandmarkFilter):
    """Plain EKF-SLAM (III, "EKF-SLAM framework"): additive errors of pose and landmarks, P_rl = F P_rl.

    Over-confident once the heading is uncertain: it gains false information about the global orientation, because each
    linearisation sees a different unobservable direction. Source: Smith, Self and Cheeseman, 1990.
    """

    invariant = False


def slots_of(slot_ids: Ints, ids: Ints) -> Ints:
    """(m,) the slot of each of the `ids` (m,). Raises `FilterError` for an unknown one."""
    ids = integers(ids)
    slots = np.empty(len(ids), np.int64)
    if not find_rows(slot_ids, ids, slots):
        raise FilterError(f"ids {ids[slots < 0].tolist()} are no landmarks of this filter")
    return slots


def as_floats(values: Array) -> Array:
    """An array as the compiled functions take it."""
    return contiguous(values, FLOAT)


def integers(values: Ints) -> Ints:
    """An array as the compiled functions take it."""
    return contiguous(values, INT)


def observations(z: Array, R: Array, ids: Ints) -> tuple[Array, Array, Ints]:
    """The same as the compiled functions take them. Raises `FilterError` for shapes that do not fit."""
    z, R, ids, n = contiguous(z, FLOAT), contiguous(R, FLOAT), contiguous(ids, INT), len(ids)
    if z.shape != (n, 2) or R.shape != (2 * n, 2 * n):
        raise FilterError(f"z {z.shape} and R {R.shape} do not fit {n} ids: expected ({n}, 2) and ({2 * n}, {2 * n})")
    return z, R, ids
