"""The mean of Gaussians of a polygon (eq. 2 and 3): vertices, centre and how far each scatters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.messages import Corners
from mecp_env.slam.protocols import Filter


@dataclass(frozen=True, slots=True, eq=False)
class Centre:
    """A polygon with the joint covariance of its vertices, and the Gaussian of its centre."""

    points: Array  # (k,2) m, vertices
    cov: Array  # (2k,2k) m^2, of all vertices

    @property
    def blocks(self) -> Array:
        """(k,2,2) m^2: the covariance of each vertex."""
        k = len(self.points)
        return self.cov.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)]

    @property
    def mean(self) -> Array:
        """(2,) m: the centre (eq. 2)."""
        return self.points.mean(axis=0)

    @property
    def mean_cov(self) -> Array:
        """(2,2) m^2: covariance of the centre (eq. 3), all cross terms of the vertices included."""
        k = len(self.points)
        return self.cov.reshape(k, 2, k, 2).sum(axis=(0, 2)) / k**2

    @property
    def variance_share(self) -> float:
        """Variance of the centre over the mean variance of the vertices: 1/k where those are independent."""
        vertex, centre = self.sigmas_m
        return (centre / vertex) ** 2

    @property
    def sigmas_m(self) -> tuple[float, float]:
        """Standard deviation of a vertex (root mean square) and of the centre, m along one axis."""
        vertex = math.sqrt(np.trace(self.blocks, axis1=1, axis2=2).mean() / 2.0)
        return vertex, math.sqrt(np.trace(self.mean_cov) / 2.0)


def in_the_map(belief: Filter, ids: Ints) -> Centre:
    """The polygon of landmarks `ids` (k,), in the frame of the map."""
    mean, cov = belief.marginal(ids)
    return Centre(mean[3:].reshape(-1, 2), cov[3:, 3:])


def in_the_scan(corners: Corners, index: Ints) -> Centre:
    """The polygon of corners `index` (k,) of one scan, in the frame of the robot."""
    z, R = corners.measurements(index)
    J = np.zeros((2 * len(z), 2 * len(z)))
    for i, (r, b) in enumerate(z.tolist()):
        c, s = math.cos(b), math.sin(b)
        J[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[c, -r * s], [s, r * c]]
    return Centre(polar_to_points(z), J @ R @ J.T)
