"""What association asks of a filter: tests of a window, the joint Gaussian of the pose and of some landmarks.

They are written once, for every filter: one that gives its window has them all.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple, Self

import numpy as np

from mecp_env.core.arrays import find_rows
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.linalg import block_of
from mecp_env.core.sensors import Odometry
from mecp_env.slam.filters.compatibility import centre_nis, joint_cost, log_bayes_factor, pairwise_nis
from mecp_env.slam.filters.models import change_chart, innovation
from mecp_env.slam.filters.update import take, world_belief
from mecp_env.slam.messages import NO_ID, Belief
from mecp_env.slam.protocols import FilterError

FLOAT, INT, contiguous = np.float64, np.int64, np.ascontiguousarray  # looked up 20 times a step


class Window(NamedTuple):
    """The joint Gaussian of the pose and of some landmarks: heading, x, y, l1x, l1y, ..."""

    state: Array  # (1+C,C) the mean in its first row, below it the covariance of its error; the first 3 + 2m count
    slot_ids: Ints  # (m,) ids of the landmarks, in the order of the state; more than were asked for may be there
    invariant: bool  # the error acts on pose and landmarks alike (`error_state`); False: it is added to the mean


class WindowFilter(ABC):
    """Base of every filter, and of a filter of your own: what is abstract here is all that it must have.

    Shapes, units and errors are those of the protocol `Filter`. `fuse`, `loosen` and `shift_pose` are asked for by the
    merging of landmarks, by failed odometry and by a laser off the robot's centre.
    """

    slot_ids: Ints  # (N,) ids in the order of the state; those below -1 are marks of past poses
    dropped: int = 0  # landmarks that found no room
    update_iterations: int = 1  # of the iterated joint test

    @property
    def ids(self) -> Ints:
        """(N,) ids of the landmarks in the order of their initialisation."""
        return self.slot_ids[self.slot_ids > NO_ID]

    def has(self, landmark: int) -> bool:
        """True when the filter holds a landmark, or a mark of a past pose, with this id."""
        return bool((self.slot_ids == landmark).any())

    @abstractmethod
    def window(self, ids: Ints, apart: bool = False) -> Window:
        """The Gaussian of the pose and at least the landmarks `ids` (m,); it is read, and not kept.

        `apart`: the covariance of one landmark with another may be missing. Raises `FilterError` for an unknown id, or
        leaves it out.
        """

    @abstractmethod
    def predict(self, odometry: Odometry) -> None:
        """Move the pose by the increments of one step."""

    @abstractmethod
    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        """Correct by a whole scan at once; `iterate` relinearises until it settles."""

    @abstractmethod
    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        """Take in new landmarks."""

    @abstractmethod
    def fuse(self, keep: int, drop: int) -> None:
        """Merge two landmarks: both are at one place, then `drop` is removed."""

    @abstractmethod
    def remove(self, ids: Ints) -> None:
        """Forget landmarks."""

    @abstractmethod
    def copy(self) -> Self:
        """An independent filter with the same state."""

    @abstractmethod
    def set_pose(self, T_map_robot: Array, pose_cov: Array | None = None) -> None:
        """The pose is this, independent of the landmarks; without a covariance it is exact."""

    @abstractmethod
    def loosen(self, pose_cov: Array) -> None:
        """Add a covariance (3,3) of x, y, heading to the pose."""

    @abstractmethod
    def shift_pose(self, T_old_new: Array) -> None:
        """The pose becomes that of a frame at T_old_new (3,) in the present one."""

    def belief(self) -> Belief:
        """Pose and landmarks with their own covariances, in world coordinates, without marks of past poses; a copy."""
        return belief_of(self.window(self.ids))

    def marginal(self, ids: Ints) -> tuple[Array, Array]:
        """Mean (3+2m,) x, y, heading, landmarks and covariance (3+2m,3+2m), world coordinates."""
        state, slot_ids, invariant = self.window(ids)
        part = take(state, slots_of(slot_ids, ids))
        size = part.shape[1]
        change_chart(part, size, 1.0, invariant)
        order = np.arange(size)
        order[:3] = 1, 2, 0
        return part[0, order], block_of(part[1:], order, order)

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        """nu (2n,) and S (2n,2n) of the pairs z[i] - ids[i]; z (n,2), R (2n,2n), ids (n,)."""
        z, R, ids = observations(z, R, ids)
        size, (state, slot_ids, invariant) = 2 * len(ids), self.window(ids)
        nu, S = np.empty(size), np.empty((size, size))
        if not innovation(state, slot_ids, ids, z, R, invariant, nu, S):
            slots_of(slot_ids, ids)
        return nu, S

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        """NIS (n,m) of every z (n,2), R (n,2,2) against every id (m,); inf where absurdly far."""
        z, R, ids = as_floats(z), as_floats(R), integers(ids)
        nis, (state, slot_ids, invariant) = np.empty((len(z), len(ids))), self.window(ids, apart=True)
        if not pairwise_nis(state, slot_ids, ids, z, R, invariant, nis):
            slots_of(slot_ids, ids)
        return nis

    def joint_nis(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Least cost (prior + residuals, 2n degrees of freedom) of the pairs over pose and map (derivations 3.2)."""
        z, R, ids = observations(z, R, ids)
        window = self.window(ids)
        steps = self.update_iterations if iterate else 1
        nis = joint_cost(window.state, window.slot_ids, ids, z, R, window.invariant, steps)
        return finite(nis, "joint_nis", window, ids)

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        """Twice the log of how much likelier the pairs are with a covariance (3,3) of x, y, heading more."""
        z, R, ids = observations(z, R, ids)
        window = self.window(ids)
        factor = log_bayes_factor(window.state, window.slot_ids, ids, z, R, window.invariant, as_floats(pose_cov))
        return finite(factor, "log_bayes_factor", window, ids)

    def mean_of_gaussians_nis(self, z: Array, R: Array, ids: Ints, paper_S: bool = False) -> float:
        """NIS (2 degrees of freedom) of the centre of the points z (k,2) against the landmarks' (III-B.1, eq. 2-3).

        Differs from the paper: S has the cross term of pose and map; `paper_S` leaves it out.
        """
        z, R, ids = observations(z, R, ids)
        window = self.window(ids)
        nis = centre_nis(window.state, window.slot_ids, ids, z, R, window.invariant, paper_S)
        return finite(nis, "mean_of_gaussians_nis", window, ids)


def belief_of(window: Window) -> Belief:
    """Pose and landmarks of a window in world coordinates, without marks of past poses."""
    state, slot_ids, invariant = window
    pose, pose_cov, count = np.empty(3), np.empty((3, 3)), len(slot_ids)
    p_map, covs = np.empty((count, 2)), np.empty((count, 2, 2))
    if world_belief(state, slot_ids, invariant, pose, pose_cov, p_map, covs):
        kept = slot_ids > NO_ID
        return Belief(pose, pose_cov, slot_ids[kept], p_map[kept], covs[kept])
    return Belief(pose, pose_cov, slot_ids.copy(), p_map, covs)


def finite(result: float, name: str, window: Window, ids: Ints) -> float:
    """The result of a test. Raises `FilterError` where it is nan: an unknown id, or S is not positive."""
    if math.isnan(result):
        slots_of(window.slot_ids, ids)
        raise FilterError(f"{name}: innovation covariance is not positive")
    return result


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
