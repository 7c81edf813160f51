"""Errors of poses and points, and how well covariances and confidence predict them."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import wrap_angle

WRONG_M = 0.5  # a position error that is no longer small
BINS = 10  # of confidence


def nees(errors: Array, covs: Array) -> Array:
    """(n,) e^T P^-1 e of errors (n,m) with covariances (n,m,m)."""
    return np.asarray((errors * np.linalg.solve(covs, errors[:, :, None])[:, :, 0]).sum(axis=1))


def mean_nees(errors: Array, covs: Array) -> float:
    """Its mean; nan without any."""
    return float(nees(errors, covs).mean()) if len(errors) else float("nan")


def rms(errors: Array) -> float:
    """Root mean square of the lengths of errors (n,2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def sigma_ratio(covs: Array, best_covs: Array) -> float:
    """Median ratio of the sigma of a landmark to the best there is, from covariances (n,2,2) of both."""
    sigmas, best = (np.sqrt(np.trace(some, axis1=1, axis2=2)) for some in (covs, best_covs))
    return float(np.median(sigmas / best))


def off(T_map_robot: Array, truth: Array) -> tuple[float, float]:
    """Distance and turn between two poses (3,)."""
    x, y, heading = T_map_robot - truth
    return math.hypot(x, y), abs(wrap_angle(heading))


def roc_area(confidence: Array, error_m: Array) -> float:
    """Probability that a scan with a small error has more confidence than one with a large error; ties count half."""
    right, wrong = (np.sort(confidence[mask]) for mask in (error_m < WRONG_M, error_m >= WRONG_M))
    below = np.searchsorted(wrong, right, "left") + np.searchsorted(wrong, right, "right")
    return float(below.sum() / (2.0 * len(right) * len(wrong))) if len(right) and len(wrong) else math.nan


def calibration_error(confidence: Array, error_m: Array) -> float:
    """Mean difference of mean confidence and share of small errors in ten bins, weighted by their scans."""
    bins = np.minimum((confidence * BINS).astype(np.int64), BINS - 1)
    gap = np.bincount(bins, confidence - (error_m < WRONG_M), BINS)
    return float(np.abs(gap).sum() / len(confidence))
