"""Filters on Victoria Park, with known correspondences, against the batch optimum of the whole record.

A car drove 4 km among 151 trees; 6,969 poses, 3,640 measurements. The record is read from `shared/data/logs`, where its
terms are. `landmark_rms_m` is the distance of a filter's trees from those of the batch optimum, nothing fitted, and
`sigma_ratio` the median over trees of how sure the filter is of a tree, relative to the batch optimum. `path_rms_m` is
the distance of the pose after each step from that of the batch optimum, which knows the rest of the drive too. Updates
are iterated where the estimator would; `once`: never. `chi2` is the cost of the batch optimum, as expected from
`freedom`, its degrees of freedom.
"""

from __future__ import annotations

import math
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.batch import Optimum, optimum
from benchmarks.common import Figures, OptionError, Options, shared_data
from benchmarks.drives import rms, sigma_ratio
from benchmarks.known_pairs import Motion, Record, Sighting, filtered, in_order
from mecp_env.core.carriers import Array
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import KINDS, AssociationConfig, FilterConfig
from mecp_env.slam.filters import Filter, make_filter

FILE, QUICK_POSES = "victoria_park.npz", 1500
SUBMAP = 20  # landmarks, so that the map is divided


def run(options: Options) -> Figures:
    """Every filter against the batch optimum. Raises `OptionError` without the record or GTSAM."""
    folder = shared_data("logs")
    if folder is None or not (folder / FILE).is_file():
        raise OptionError(f"victoria_park: no {FILE} in shared/data/logs beside the repository")
    record = read(folder / FILE, QUICK_POSES if options.quick else None)
    estimate = make_filter(FilterConfig(kind="riekf"))  # what it has is near the optimum
    path, belief = path_of(record, estimate, "iterated"), estimate.belief()
    best = optimum(record, path, belief.ids, belief.p_map)
    kinds = (*KINDS.ours, *KINDS.others)
    return {
        "batch": {"chi2": best.chi2, "freedom": best.freedom, "landmarks": len(best.ids)},
        "filters": {kind: {update: against(record, kind, update, best) for update in UPDATES} for kind in kinds},
    }


def read(path: Path, poses: int | None = None) -> Record:
    """The record, or its first poses."""
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    motions = [motion_of(T, np.diag(arrays["odom_cov"] ** 2)) for T in arrays["odom"][: poses and poses - 1]]
    at = np.searchsorted(arrays["obs"][:, 0], np.arange(len(motions) + 2))
    sightings = [
        Sighting(seen[:, 2:].copy(), np.diag(sigma.ravel() ** 2), seen[:, 1].astype(np.int64))
        for seen, sigma in ((arrays["obs"][a:b], arrays["obs_sigma"][a:b]) for a, b in pairwise(at))
    ]
    return Record(arrays["prior"], np.diag(arrays["prior_cov"]), motions, sightings)


def motion_of(T: Array, cov: Array) -> Motion:
    """A motion x, y, heading as turn, way and turn without noise, and its noise."""
    x, y, heading = T.tolist()
    way = math.atan2(y, x)
    arcs = np.array([[0.0, way], [math.hypot(x, y), 0.0], [0.0, heading - way]])
    return Motion(Odometry(arcs, np.zeros((3, 2, 2)), False), T, cov, cov)


def corrected(estimate: Filter, sighting: Sighting, odometry: Any = None) -> None:
    """Update, iterated where the estimator does."""
    estimate.update(*sighting, iterate=not AssociationConfig().is_sharp(estimate.belief()))


UPDATES = {"iterated": corrected, "once": lambda estimate, sighting, odometry: estimate.update(*sighting)}


def path_of(record: Record, estimate: Filter, update: str) -> Array:
    """(n,3) the pose of a filter after each step."""
    return np.array([belief.T_map_robot for belief in filtered(record, estimate, UPDATES[update])])


def against(record: Record, kind: str, update: str, best: Optimum) -> Figures:
    """A filter's landmarks and path compared with the batch optimum."""
    estimate, begun = make_filter(FilterConfig(kind=kind, submap=SUBMAP)), time.thread_time()
    path = path_of(record, estimate, update)
    seconds, (p_map, covs) = time.thread_time() - begun, in_order(estimate)
    return {
        "landmark_rms_m": rms(p_map - best.p_map),
        "sigma_ratio": sigma_ratio(covs, best.covs),
        "path_rms_m": rms((path - best.T_map_robot)[:, :2]),
        "ms": 1e3 * seconds / len(path),
    }
