"""Errors of poses and points, and how well their covariances tell them."""

from __future__ import annotations

import numpy as np

from mecp_env.core.carriers import Array


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
