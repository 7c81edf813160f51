"""Errors of poses and points, and how well covariances and confidence predict them."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import to_map, wrap_angle
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.slam.protocols import Filter

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


def map_nees(truth: GroundTruth, log: AssociationLog, belief: Filter, T_map_world: Array) -> tuple[float, float]:
    """Mean NEES of the landmarks, and of the offset of two that were matched in one scan (2 expected of both).

    Those of no true corner are left out; nan where none is left.
    """
    still, corner = len(truth.outline.corners), log.corners_of(belief.ids)
    slots = np.flatnonzero((corner >= 0) & (corner < still))
    mean, cov = belief.marginal(belief.ids[slots])
    p_map = to_map(T_map_world, np.ascontiguousarray(truth.outline.corners.p_world[corner[slots]]))
    errors, m = mean[3:].reshape(-1, 2) - p_map, len(slots)
    blocks = cov[3:, 3:].reshape(m, 2, m, 2).transpose(0, 2, 1, 3)  # (m,m,2,2)
    step, _, feature, matched = log.rows[: log.used].T
    seen = np.zeros((int(step.max(initial=0)) + 1, m))
    rows, columns = np.nonzero((feature[:, None] == belief.ids[slots]) & (matched > 0)[:, None])
    seen[step[rows], columns] = 1.0
    together = np.triu(seen.T @ seen, 1) > 0  # both were matched in one scan
    a, b = np.nonzero(together & (corner[slots][:, None] != corner[slots]))  # duplicates are one corner
    offsets = blocks[a, a] + blocks[b, b] - blocks[a, b] - blocks[b, a]
    return mean_nees(errors, blocks[np.arange(m), np.arange(m)]), mean_nees(errors[a] - errors[b], offsets)
