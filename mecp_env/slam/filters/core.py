"""The filters `riekf` and `ekf`: state, ids and slots, and what changes them."""

from __future__ import annotations

import math
import warnings
from typing import Self

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.linalg import mirror_lower
from mecp_env.core.se2 import compose
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters.models import change_chart, predict, propagate_invariant, propagate_plain
from mecp_env.slam.filters.update import append, batch_update, merge_pair
from mecp_env.slam.filters.window import Window, WindowFilter, as_floats, belief_of, observations, slots_of
from mecp_env.slam.messages import Belief
from mecp_env.slam.protocols import FilterError, FullFilterWarning

PINNED_SIGMA = 1e-6  # m and rad: a pose that is known exactly
POSE_ORDER = np.array([2, 0, 1])  # heading, x, y of a pose x, y, heading


class LandmarkFilter(WindowFilter):
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
            slots_of(self.slot_ids, ids)
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

    def window(self, ids: Ints, apart: bool = False) -> Window:
        """The whole state, which is not copied."""
        return Window(self.state, self.slot_ids, self.invariant)

    def checked_window(self, ids: Ints, apart: bool = False) -> Window:
        """`window`, which is sound."""
        return self.window(ids, apart)

    def belief(self) -> Belief:
        return belief_of(Window(self.state, self.slot_ids, self.invariant))

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

    def _slots(self, ids: Ints) -> Ints:
        return slots_of(self.slot_ids, ids)

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
