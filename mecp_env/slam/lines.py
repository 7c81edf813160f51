"""Kernels for the maximum-likelihood line (alpha, rho) through averaged beams, with its covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.noise import Noise
from mecp_env.slam.stretches import scatter

Array = NDArray[np.float64]
ITERATIONS = 2
OUTLIER2 = 16.0  # squared sigmas beyond which a beam loses weight
STEEPEST = 0.035  # cosine of the largest incidence (88 degrees) for which a ray still meets its line


@kernel
def rough_line(sums: Array, first: int, last: int) -> tuple[float, float]:
    """alpha and rho (>= 0) of the total-least-squares line through positions first to last."""
    n = last - first + 1
    sxx, sxy, syy = scatter(sums, first, last)
    alpha = 0.5 * math.atan2(2.0 * sxy, sxx - syy) + 0.5 * math.pi
    x, y = (sums[last + 1, 0] - sums[first, 0]) / n, (sums[last + 1, 1] - sums[first, 1]) / n
    rho = x * math.cos(alpha) + y * math.sin(alpha)
    return (alpha, rho) if rho >= 0.0 else (alpha + math.pi, -rho)


@kernel
def fit_line(
    polar: Array, points: Array, stretch: tuple[int, int], start: tuple[float, float], noise: Noise
) -> tuple[float, float, float, float, float, float]:
    """alpha, rho, their variances and covariance (aa, ar, rr) and the chi-square: Gauss-Newton from `start`.

    The residual r cos(theta - alpha) - rho has the variance sigma_r^2 cos^2 + (r sin sigma_theta)^2. The coordinate
    along the wall is taken from the line, not from the noisy range: with the measured one short oblique faces
    come out centimetres too long. aa is inf when the beams do not carry a line.
    """
    alpha, rho = start
    haa, har, hrr, cost = 1.0, 0.0, 1.0, 0.0
    for _ in range(ITERATIONS):
        ca, sa = math.cos(alpha), math.sin(alpha)
        haa, har, hrr, ga, gr, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(stretch[0], stretch[1] + 1):
            ahead, r = points[i, 0] * ca + points[i, 1] * sa, polar[i, 0]
            cosine = ahead / r
            if cosine < STEEPEST:
                continue
            along = rho * (points[i, 1] * ca - points[i, 0] * sa) / ahead  # rho tan(theta - alpha)
            residual = ahead - rho
            variance = ((noise.range_m * cosine) ** 2 + (along * noise.bearing) ** 2) / polar[i, 2]
            weight = 1.0 / max(variance, residual * residual / OUTLIER2)
            haa, har, hrr = haa + weight * along * along, har - weight * along, hrr + weight
            cost += weight * residual * residual
            ga, gr = ga + weight * along * residual, gr - weight * residual
        determinant = haa * hrr - har * har
        if not determinant > 1e-9 * haa * hrr:
            return alpha, rho, math.inf, 0.0, math.inf, cost
        alpha -= (hrr * ga - har * gr) / determinant
        rho -= (haa * gr - har * ga) / determinant
    determinant = haa * hrr - har * har
    return alpha, rho, hrr / determinant, -har / determinant, haa / determinant, cost
