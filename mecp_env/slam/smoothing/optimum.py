"""The pose graph of a run, and its batch optimum: sparse Gauss-Newton with a robust kernel.

Poses are those of the laser, x, y, heading in the map frame (m, rad). An error is what is predicted minus what was
measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import splu
from scipy.special import chdtri

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import MecpError
from mecp_env.core.se2 import between, wrapped
from mecp_env.slam.messages import point_blocks

Part = tuple[csr_array, csr_array, Array]  # J (r,3n+2l), W (r,r), errors (r,)


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
        own = inverses(np.concatenate(list(map(point_blocks, R))))
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


def inverses(covs: Array) -> Array:
    """The inverses of covariances (...,d,d). Raises `SmoothingError` where one is singular."""
    try:
        return np.asarray(np.linalg.inv(covs), np.float64)
    except np.linalg.LinAlgError:
        raise SmoothingError("a covariance is singular") from None


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The optimum of a pose graph."""

    T_map_laser: Array  # (n,3) m, rad
    p_map: Array  # (l,2) m
    steps: int  # of Gauss-Newton that were taken
    odometry_scale: float  # by which the variances of the odometry were multiplied


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """The weights of factors, between 0 and 1."""

    sightings: Array  # (m,)
    odometry: Array  # (k,)
    odometry_scale: float = 1.0  # by which the variances of the odometry are multiplied


@dataclass(frozen=True, slots=True)
class Kernel:
    """The Cauchy kernel: a factor with a NIS of `width` gates counts half."""

    corner_gate: float
    motion_gate: float
    width: float

    @classmethod
    def at(cls, graph: PoseGraph, gate_probability: float | None) -> Kernel:
        """A kernel in which all factors of a graph count at least half; without a gate, in which they count fully."""
        if gate_probability is None:
            return cls(np.inf, np.inf, 1.0)
        corner_gate, motion_gate = chdtri([2, 3], 1.0 - gate_probability).tolist()
        corners, motions = nis_at(graph)
        most = max(corners.max(initial=0.0) / corner_gate, motions.max(initial=0.0) / motion_gate)
        return cls(corner_gate, motion_gate, max(most, 1.0))

    def weights(self, graph: PoseGraph) -> Weights:
        """The weights at the poses and landmarks of a graph."""
        corners, motions = nis_at(graph)
        expected = float(chdtri(3, 0.5))  # median of the NIS of a motion
        robust = self.motion_gate < np.inf and len(motions)
        scale = max(1.0, float(np.median(motions)) / expected) if robust else 1.0
        odometry = 1.0 / (scale + motions / (self.width * self.motion_gate))
        return Weights(1.0 / (1.0 + corners / (self.width * self.corner_gate)), odometry, scale)


def smooth(
    graph: PoseGraph, gate_probability: float | None = 0.99995, steps: int = 100, settled: float = 1e-4
) -> Smoothed:
    """The most likely poses and landmarks, given all factors of a graph at once.

    Gauss-Newton on the sparse normal equations, with the steps damped (Levenberg-Marquardt) where the cost would rise,
    until the poses move by less than `settled` (RMS of m and rad). Sightings and odometry have a Cauchy kernel, whose
    weights are found again in each step: a factor with a NIS at the gate of `gate_probability` counts half. The kernel
    begins so wide that every factor counts, and narrows tenfold per step, because the first poses jump where the
    estimator closed a loop, which is no fault of the odometry there. Where the median NIS of the odometry exceeds what
    its covariance predicts, all its variances are multiplied by the ratio. Without a gate (None), all weights are 1.
    Registrations and priors have no kernel. Raises `SmoothingError` where the poses have not settled after so many
    `steps`, or the equations have no solution.

    Source: Dellaert and Kaess, "Square root SAM", International Journal of Robotics Research 25, 2006; kernel: Yang et
    al., "Graduated non-convexity for robust spatial perception", IEEE Robotics and Automation Letters 5, 2020.
    """
    kernel, damping = Kernel.at(graph, gate_probability), 0.0
    for taken in range(1, steps + 1):
        weights = kernel.weights(graph)
        moved, change = stepped(graph, *system_at(graph, weights), damping)
        if change > settled and not cost_at(moved, weights) <= cost_at(graph, weights):
            damping = max(10.0 * damping, 1e-9)
            continue
        if change <= settled and kernel.width == 1.0:
            return Smoothed(moved.T_map_laser, moved.p_map, taken, weights.odometry_scale)
        graph, damping, kernel = moved, 0.1 * damping, replace(kernel, width=max(0.1 * kernel.width, 1.0))
    raise SmoothingError(f"poses still move by {settled:g} m or rad, or more, after {steps} steps")


def stepped(graph: PoseGraph, H: csc_array, g: Array, damping: float) -> tuple[PoseGraph, float]:
    """The graph after a step of Gauss-Newton, and the RMS change of the poses, m and rad."""
    n = len(graph.T_map_laser)
    if damping:
        H = csc_array(H + diags_array(damping * H.diagonal()))
    try:
        step = -splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(g)
    except RuntimeError as error:  # a pivot is exactly zero
        raise SmoothingError(f"the equations have no solution: {error}") from None
    if not np.isfinite(step).all():
        raise SmoothingError("the equations have no finite solution")
    poses, places = step[: 3 * n].reshape(n, 3), step[3 * n :].reshape(-1, 2)
    T_map_laser = graph.T_map_laser + poses
    T_map_laser[:, 2] = wrapped(T_map_laser[:, 2])
    return replace(graph, T_map_laser=T_map_laser, p_map=graph.p_map + places), float(np.sqrt(np.mean(poses**2)))


def nis(errors: Array, information: Array) -> Array:
    """(k,) normalised squares of errors (k,d)."""
    squares: Array = np.einsum("ki,kij,kj->k", errors, information, errors)
    return squares


def nis_at(graph: PoseGraph) -> tuple[Array, Array]:
    """NIS of each sighting (m,) alone, and of each motion by odometry (k,)."""
    seen, *_ = graph.sightings.errors(graph.T_map_laser, graph.p_map)
    moved, *_ = graph.odometry.errors(graph.T_map_laser)
    return nis(seen, graph.sightings.own), nis(moved, graph.odometry.information)


def cost_at(graph: PoseGraph, weights: Weights) -> float:
    """The weighted sum of squares e^T W e of all factors."""
    T, (known, off) = graph.T_map_laser, priors_of(graph)
    seen, *_ = graph.sightings.errors(T, graph.p_map)
    scaled = (np.sqrt(weights.sightings)[:, None] * seen).ravel()
    motions = nis(graph.odometry.errors(T)[0], graph.odometry.information)
    registered = nis(graph.registrations.errors(T)[0], graph.registrations.information)
    of_sightings = scaled @ (graph.sightings.information @ scaled)
    return float(of_sightings + weights.odometry @ motions + registered.sum() + off @ (known @ off))


def system_at(graph: PoseGraph, weights: Weights) -> tuple[csc_array, Array]:
    """The normal equations at the poses and landmarks of a graph: J^T W J (3n+2l,3n+2l) and J^T W e (3n+2l,)."""
    known, off = priors_of(graph)
    H, g = known, known @ off
    for J, W, e in (
        sightings_part(graph, weights),
        links_part(graph, graph.odometry, weights.odometry),
        links_part(graph, graph.registrations, np.ones(len(graph.registrations.start))),
    ):
        JW = J.T @ W
        H, g = H + JW @ J, g + JW @ e
    return csc_array(H), g


def sightings_part(graph: PoseGraph, weights: Weights) -> Part:
    """The sightings: a weight below 1 is a larger covariance of that corner, in the joint covariance of its scan."""
    seen = graph.sightings
    e, by_pose, by_point = seen.errors(graph.T_map_laser, graph.p_map)
    J = blocks([(3 * seen.pose, by_pose), (graph.first_of(seen.landmark), by_point)], graph.size)
    roots = diags_array(np.repeat(np.sqrt(weights.sightings), 2))
    return J, csr_array(roots @ seen.information @ roots), e.ravel()


def links_part(graph: PoseGraph, links: Links, weights: Array) -> Part:
    """Relative poses with their weights (k,)."""
    e, by_start, by_end = links.errors(graph.T_map_laser)
    J = blocks([(3 * links.start, by_start), (3 * links.end, by_end)], graph.size)
    first = 3 * np.arange(len(weights))
    W = blocks([(first, weights[:, None, None] * links.information)], e.size)
    return J, W, e.ravel()


def priors_of(graph: PoseGraph) -> tuple[csr_array, Array]:
    """The information (3n+2l,3n+2l) of the priors, and how far the unknowns are from them (3n+2l,)."""
    priors, off = graph.priors, np.zeros(graph.size)
    off[:3] = graph.T_map_laser[0] - priors.T_map_laser
    off[2] = wrapped(off[2])
    first = graph.first_of(priors.landmark)
    columns = np.concatenate([np.arange(3), (first[:, None] + [0, 1]).ravel()])
    off[columns[3:]] = (graph.p_map[priors.landmark] - priors.p_map).ravel()
    of_pose = blocks([(np.zeros(1, np.int64), priors.information[None])], graph.size)
    of_landmarks = blocks([(first, priors.landmark_information)], graph.size)
    rows = csr_array((np.ones(len(columns)), (columns, np.arange(len(columns)))), shape=(graph.size, len(columns)))
    return csr_array(rows @ vstack([of_pose, of_landmarks])), off


def blocks(parts: list[tuple[Ints, Array]], size: int) -> csr_array:
    """(k d,size) a sparse matrix with blocks (k,d,w) in rows one below the other, from columns (k,) on."""
    values, rows, columns, height = [], [], [], 0
    for first, of_part in parts:
        k, d, w = of_part.shape
        height = k * d
        values.append(of_part.ravel())
        rows.append(np.repeat(np.arange(height), w))
        columns.append((first[:, None, None] + np.broadcast_to(np.arange(w), (k, d, w))).ravel())
    where = np.concatenate(rows), np.concatenate(columns)
    return csr_array((np.concatenate(values), where), shape=(height, size))
