"""The batch optimum of a pose graph: sparse Gauss-Newton with a robust kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import block_diag, coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.special import chdtri

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.errors import MecpError
from mecp_env.core.trajectories import wrapped
from mecp_env.slam.smoothing.graph import Links, PoseGraph


class SmoothingError(MecpError):
    """The optimum of a pose graph is not reached."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The optimum of a pose graph."""

    T_map_laser: Array  # (n,3) m, rad
    p_map: Array  # (l,2) m
    steps: int  # of Gauss-Newton that were taken
    odometry_scale: float  # by which the variances of the odometry were multiplied


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """The robust weights of factors, between 0 and 1."""

    sightings: Array  # (m,)
    odometry: Array  # (k,)
    odometry_scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The normal equations at one point."""

    H: csc_array  # (3n+2l,3n+2l) J^T W J
    g: Array  # (3n+2l,) J^T W e
    cost: float  # e^T W e


def smooth(
    graph: PoseGraph, gate_probability: float | None = 0.99995, steps: int = 100, settled: float = 1e-3
) -> Smoothed:
    """The most likely poses and landmarks, given all factors of a graph at once.

    Gauss-Newton on the sparse normal equations, with the steps damped (Levenberg-Marquardt) where the cost would rise,
    until no pose moves by more than `settled` (m and rad). Sightings and odometry have a Cauchy kernel, whose weights
    are found again in each step: a factor with a NIS at the gate of `gate_probability` counts half. Where the median
    NIS of the odometry exceeds what its covariance predicts, all its variances are multiplied by the ratio. Without a
    gate (None), all weights are 1. Registrations and priors have no kernel. Raises `SmoothingError` where the poses
    have not settled after so many `steps`, or the equations have no solution.

    Source: Dellaert and Kaess, "Square root SAM", International Journal of Robotics Research 25, 2006.
    """
    damping = 0.0
    for taken in range(1, steps + 1):
        weights = weights_at(graph, gate_probability)
        now = system_at(graph, weights)
        moved, largest = stepped(graph, now, damping)
        if largest > settled and not system_at(moved, weights).cost <= now.cost:
            damping = max(10.0 * damping, 1e-6)
            continue
        graph, damping = moved, 0.1 * damping if damping > 1e-6 else 0.0
        if largest <= settled:
            return Smoothed(graph.T_map_laser, graph.p_map, taken, weights.odometry_scale)
    raise SmoothingError(f"poses still move by more than {settled:g} m or rad after {steps} steps")


def stepped(graph: PoseGraph, now: System, damping: float) -> tuple[PoseGraph, float]:
    """The graph after a step of Gauss-Newton, and the largest change of a pose, m or rad."""
    n, H = len(graph.T_map_laser), now.H
    if damping:
        H = csc_array(H + diags_array(damping * H.diagonal()))
    try:
        step = -splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(now.g)
    except RuntimeError as error:  # a pivot is exactly zero
        raise SmoothingError(f"the equations have no solution: {error}") from None
    if not np.isfinite(step).all():
        raise SmoothingError("the equations have no finite solution")
    poses, places = step[: 3 * n].reshape(n, 3), step[3 * n :].reshape(-1, 2)
    T_map_laser = graph.T_map_laser + poses
    T_map_laser[:, 2] = wrapped(T_map_laser[:, 2])
    return replace(graph, T_map_laser=T_map_laser, p_map=graph.p_map + places), float(np.abs(poses).max())


def weights_at(graph: PoseGraph, gate_probability: float | None) -> Weights:
    """The weights of the Cauchy kernel at the poses and landmarks of a graph; 1 without a gate."""
    if gate_probability is None:
        return Weights(np.ones(len(graph.sightings.z)), np.ones(len(graph.odometry.start)))
    seen, *_ = graph.sightings.errors(graph.T_map_laser, graph.p_map)
    moved, *_ = graph.odometry.errors(graph.T_map_laser)
    corner_nis, motion_nis = nis(seen, graph.sightings.own), nis(moved, graph.odometry.information)
    corner_gate, motion_gate = chdtri([2, 3], 1.0 - gate_probability).tolist()
    scale = max(1.0, float(np.median(motion_nis)) / float(chdtri(3, 0.5))) if len(motion_nis) else 1.0
    odometry = 1.0 / (scale + motion_nis / motion_gate)  # 1 / scale for the variances, and that of the kernel
    return Weights(1.0 / (1.0 + corner_nis / corner_gate), odometry, scale)


def nis(errors: Array, information: Array) -> Array:
    """(k,) normalised squares of errors (k,d)."""
    squares: Array = np.einsum("ki,kij,kj->k", errors, information, errors)
    return squares


def system_at(graph: PoseGraph, weights: Weights) -> System:
    """The normal equations at the poses and landmarks of a graph."""
    T, n, size = graph.T_map_laser, len(graph.T_map_laser), 3 * len(graph.T_map_laser) + 2 * len(graph.p_map)
    parts = [
        sightings_part(graph, weights, size),
        links_part(graph.odometry, T, weights.odometry, size),
        links_part(graph.registrations, T, np.ones(len(graph.registrations.start)), size),
    ]
    H, g, cost = csr_array((size, size)), np.zeros(size), 0.0
    for J, e, W in parts:
        JW = J.T @ W
        H, g, cost = H + JW @ J, g + JW @ e, cost + float(e @ (W @ e))
    known, off = priors_of(graph, n, size)
    return System(csc_array(H + known), g + known @ off, cost + float(off @ (known @ off)))


Part = tuple[csr_array, Array, csr_array]  # J (r,3n+2l), errors (r,), W (r,r)


def sightings_part(graph: PoseGraph, weights: Weights, size: int) -> Part:
    """The sightings: a weight below 1 is a larger covariance of that corner, in the joint covariance of its scan."""
    seen, n = graph.sightings, len(graph.T_map_laser)
    e, by_pose, by_point = seen.errors(graph.T_map_laser, graph.p_map)
    J = blocks([(3 * seen.pose, by_pose), (3 * n + 2 * seen.landmark, by_point)], size)
    roots = diags_array(np.repeat(np.sqrt(weights.sightings), 2))
    return J, e.ravel(), csr_array(roots @ seen.information @ roots)


def links_part(links: Links, T_map_laser: Array, weights: Array, size: int) -> Part:
    """Relative poses with their weights (k,)."""
    e, by_start, by_end = links.errors(T_map_laser)
    J = blocks([(3 * links.start, by_start), (3 * links.end, by_end)], size)
    weighed = weights[:, None, None] * links.information
    W = block_diag([*weighed], format="csr") if len(weighed) else np.zeros((0, 0))
    return J, e.ravel(), csr_array(W)


def priors_of(graph: PoseGraph, n: int, size: int) -> tuple[csr_array, Array]:
    """The information (3n+2l,3n+2l) of the priors, and how far the unknowns are from them (3n+2l,)."""
    priors, off = graph.priors, np.zeros(size)
    off[:3] = graph.T_map_laser[0] - priors.T_map_laser
    off[2] = wrapped(off[2])
    columns = (3 * n + 2 * priors.landmark[:, None] + [0, 1]).ravel()
    off[columns] = (graph.p_map[priors.landmark] - priors.p_map).ravel()
    places = blocks([(3 * n + 2 * priors.landmark, priors.informations)], size)  # (2q,3n+2l)
    rows = coo_array((np.ones(len(columns)), (columns, np.arange(len(columns)))), shape=(size, len(columns)))
    first = blocks([(np.zeros(1, np.int64), priors.information[None])], size)
    first.resize((size, size))
    return csr_array(rows @ places + first), off


def blocks(parts: list[tuple[Ints, Array]], size: int) -> csr_array:
    """(k d,size) a sparse matrix with blocks (k,d,w) in rows one below the other, from columns (k,) on."""
    values, rows, columns = [], [], []
    for first, of_part in parts:
        k, d, w = of_part.shape
        values.append(of_part.ravel())
        rows.append(np.repeat(np.arange(k * d), w))
        columns.append((first[:, None, None] + np.broadcast_to(np.arange(w), (k, d, w))).ravel())
    count = parts[0][1].shape[0] * parts[0][1].shape[1]
    where = np.concatenate(rows), np.concatenate(columns)
    return csr_array(coo_array((np.concatenate(values), where), shape=(count, size)))
