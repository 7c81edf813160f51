"""The pose graph of a run: what is unknown, and the factors between the unknowns, each with its information matrix.

Poses are those of the laser, x, y, heading in the map frame (m, rad). An error is what is predicted minus what was
measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_diag, csr_array

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import MecpError
from mecp_env.core.se2 import between, wrapped


class SmoothingError(MecpError):
    """The optimum of a pose graph is not reached, or a covariance is singular."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Relative poses: of pose `end` in the frame of pose `start`."""

    start: Ints  # (k,) rows of the poses
    end: Ints  # (k,)
    T_start_end: Array  # (k,3) m, rad, as measured
    information: Array  # (k,3,3) inverse covariance of x, y, heading in the frame of `start`

    @classmethod
    def of(cls, links: Sequence[tuple[int, int, Array, Array]]) -> Links:
        """Those of start, end, relative pose (3,) and covariance (3,3) each."""
        if not links:
            return cls(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)))
        start, end, motions, covs = (np.array(column) for column in zip(*links, strict=True))
        return cls(start, end, motions, inverses(covs))

    def errors(self, T_map_laser: Array) -> tuple[Array, Array, Array]:
        """Errors (k,3) at poses (n,3), and their derivatives (k,3,3) by the start and by the end."""
        T_a, T_b = T_map_laser[self.start], T_map_laser[self.end]
        expected, by_end = between(T_a, T_b), np.zeros((len(T_a), 3, 3))
        c, s = np.cos(T_a[:, 2]), np.sin(T_a[:, 2])
        by_end[:, 0, 0], by_end[:, 0, 1], by_end[:, 1, 0], by_end[:, 1, 1], by_end[:, 2, 2] = c, s, -s, c, 1.0
        by_start = -by_end
        by_start[:, 0, 2], by_start[:, 1, 2] = expected[:, 1], -expected[:, 0]
        off = expected - self.T_start_end
        off[:, 2] = wrapped(off[:, 2])
        return off, by_start, by_end


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Ranges and bearings of landmarks; those of one scan are correlated."""

    pose: Ints  # (m,) rows of the poses
    landmark: Ints  # (m,) rows of the landmarks
    z: Array  # (m,2) m, rad
    information: csr_array  # (2m,2m) inverse of the joint covariance, a block per scan
    own: Array  # (m,2,2) inverse covariance of each one alone

    @classmethod
    def of(cls, scans: Sequence[tuple[int, Ints, Array, Array]]) -> Sightings:
        """Those of the row of the pose, rows of the landmarks (c,), z (c,2) and R (2c,2c) of each scan."""
        if not scans:
            empty, nothing = np.empty(0, np.int64), csr_array((0, 0), dtype=np.float64)
            return cls(empty, empty, np.empty((0, 2)), nothing, np.empty((0, 2, 2)))
        pose, landmark, z, R = zip(*scans, strict=True)
        information = csr_array(block_diag(list(map(inverses, R)), format="csr"))
        own = inverses(np.concatenate(list(map(own_blocks, R))))
        rows = np.repeat(pose, list(map(len, z)))
        return cls(rows, np.concatenate(landmark), np.concatenate(z), information, own)

    def errors(self, T_map_laser: Array, p_map: Array) -> tuple[Array, Array, Array]:
        """Errors (m,2) at poses (n,3) and landmarks (l,2); derivatives by the pose (m,2,3) and the landmark (m,2,2)."""
        T, offset = T_map_laser[self.pose], p_map[self.landmark] - T_map_laser[self.pose, :2]
        r = np.maximum(np.hypot(*offset.T), np.finfo(np.float64).eps)
        bearing = wrapped(np.arctan2(offset[:, 1], offset[:, 0]) - T[:, 2] - self.z[:, 1])
        (x, y), by_point = (offset / r[:, None]).T, np.empty((len(r), 2, 2))
        by_point[:, 0, 0], by_point[:, 0, 1], by_point[:, 1, 0], by_point[:, 1, 1] = x, y, -y / r, x / r
        turn = np.broadcast_to([[0.0], [-1.0]], (len(r), 2, 1))
        return np.stack([r - self.z[:, 0], bearing], axis=1), np.concatenate([-by_point, turn], axis=2), by_point


@dataclass(frozen=True, slots=True, eq=False)
class Priors:
    """What was known before the first scan: the first pose, and landmarks of an older map."""

    T_map_laser: Array  # (3,) of the first scan
    information: Array  # (3,3)
    landmark: Ints  # (q,) rows of the landmarks
    p_map: Array  # (q,2) m
    landmark_information: Array  # (q,2,2); landmarks count as independent of each other and of the pose


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses and landmarks to begin with, and all factors."""

    T_map_laser: Array  # (n,3) m, rad
    p_map: Array  # (l,2) m
    priors: Priors
    odometry: Links
    registrations: Links
    sightings: Sightings

    @property
    def size(self) -> int:
        """How many numbers are unknown: three per pose, then two per landmark."""
        return 3 * len(self.T_map_laser) + 2 * len(self.p_map)

    def first_of(self, landmark: Ints) -> Ints:
        """(m,) where the numbers of landmarks (m,), rows of `p_map`, begin."""
        return 3 * len(self.T_map_laser) + 2 * landmark


def own_blocks(R: Array) -> Array:
    """(c,2,2) the covariance of each measurement alone, from the joint one (2c,2c)."""
    c = np.arange(len(R) // 2)
    blocks: Array = R.reshape(len(c), 2, len(c), 2)[c, :, c]
    return blocks


def inverses(covs: Array) -> Array:
    """The inverses of covariances (...,d,d). Raises `SmoothingError` where one is singular."""
    try:
        return np.asarray(np.linalg.inv(covs), np.float64)
    except np.linalg.LinAlgError:
        raise SmoothingError("a covariance is singular") from None
