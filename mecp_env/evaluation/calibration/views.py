"""Scans by the stages of the estimator: surfaces for a registration, and the range noise about straight walls."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mecp_env.core.messages import Scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend.clustering import beams_on_walls, cluster_beams
from mecp_env.slam.frontend.dense_scan import merge_sweeps
from mecp_env.slam.frontend.lost_beams import restore_lost_beams
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import MergedScan, Segments
from mecp_env.slam.panorama.surfaces import Surfaces, surfaces_of

SCANS = 60  # that tell the range noise, spread over a log
WIDE_M = 0.05  # range noise that straight walls are looked for with: with less than there is, they fall to pieces
LINE_BEAMS, LEAST_COSINE = 10, 0.7  # of a wall that tells the range noise: beams, and cosine of their incidence
TRIM = 2  # beams at each end of a line that may be on something else
STRAIGHT_SHARE = 0.9  # of the lines; the others may be no walls


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A scan as the registration takes it."""

    surfaces: Surfaces
    beams: MergedScan
    segments: Segments


def view(scan: Scan, config: SlamConfig) -> View:
    """The surfaces of a scan, by the stages of the estimator."""
    sensor = config.sensor
    beams = restore_lost_beams(merge_sweeps(scan, sensor), sensor)
    clusters = cluster_beams(beams, config.clustering, config.segments, sensor)
    segments = extract_segments(beams, clusters, config.segments, sensor)
    wall = beams_on_walls(clusters, beams)
    return View(surfaces_of(beams, segments, wall, sensor), beams, segments)


def range_noise(scan_at: Callable[[int], Scan], scans: int, config: SlamConfig) -> float:
    """m: the standard deviation of single beams about straight walls; nan where no wall is long enough.

    `scan_at` gives the scan of each of so many rows; `config` has the laser as far as it is known.
    """
    wide = config.model_copy(update={"sensor": config.sensor.model_copy(update={"range_sigma_m": WIDE_M})})
    rows = np.unique(np.linspace(0, scans - 1, min(SCANS, scans)).astype(np.int64)).tolist()
    variances = np.sort([variance for row in rows for variance in _variances(view(scan_at(row), wide))])
    kept = variances[: math.ceil(STRAIGHT_SHARE * len(variances))]
    return math.sqrt(float(kept.mean())) if len(kept) else math.nan


def _variances(seen: View) -> list[float]:
    """m^2: the variance of the ranges about each long line, as of a single beam."""
    beams, segments = seen.beams, seen.segments
    found, size = list[float](), len(beams.ranges)
    for (alpha, rho), first, last in zip(segments.line, segments.first, segments.last, strict=True):
        on = (segments.roll + np.arange(first + TRIM, last + 1 - TRIM)) % size
        cosine = np.cos(beams.bearings[on] - alpha)
        kept = beams.hit[on] & (cosine > LEAST_COSINE)
        on, cosine = on[kept], cosine[kept]
        if len(on) >= LINE_BEAMS:
            off = (beams.ranges[on] - rho / cosine) * np.sqrt(beams.count[on])
            design = np.column_stack((np.ones(len(on)), beams.bearings[on] - beams.bearings[on[0]]))
            off -= design @ np.linalg.lstsq(design, off, rcond=None)[0]
            found.append(float(off @ off) / (len(on) - 2))
    return found
