"""The filters: consistency (NEES) on a ring of rooms.

Correspondences are known, so that only the filter is measured. The expected NEES of a pose is 3; the 95 % band of the
mean of 60 runs is 2.41-3.65.
"""

from __future__ import annotations

import numpy as np

from benchmarks.common import Figures, Options, estimate, in_parallel
from benchmarks.ring import Variance, config_of, linear, make_course, monte_carlo, per_metre, per_step
from mecp_env.slam.config import KINDS

READINGS: dict[str, tuple[Variance, float]] = {  # noise and length of a step, m
    "per_metre": (per_metre, 0.25),
    "per_step_0.25_m": (per_step, 0.25),
    "per_step_1_m": (per_step, 1.0),
    "linear": (linear, 0.25),
}


def run(options: Options) -> Figures:
    """NEES and error of all filters for every reading of the paper's odometry noise."""
    kinds = *KINDS.ours, *KINDS.others
    cases = [(reading, kind, 8 if options.quick else 60) for reading in READINGS for kind in kinds]
    nees: Figures = {reading: {} for reading in READINGS}
    for (reading, kind, _), figures in zip(cases, in_parallel(consistency, Figures, cases, options), strict=True):
        nees[reading][kind] = figures
    return {"nees": nees}


def consistency(case: tuple[str, str, int]) -> Figures:
    """NEES by phase, at the closing scan with a one-shot and with an iterated update, and the position error."""
    reading, kind, runs = case
    variance, step_m = READINGS[reading]
    config = config_of(kind)
    figures = monte_carlo(config, make_course(step_m), runs, variance=variance)
    once = monte_carlo(config, make_course(step_m, laps=1.1), runs, variance=variance, iterate=False)
    lap_2 = figures.lap > 1.0
    return {
        "lap_1_second_half": estimate(figures.nees[:, (figures.lap > 0.5) & ~lap_2].mean(axis=1)),
        "lap_2": estimate(figures.nees[:, lap_2].mean(axis=1)),
        "closing_scan": estimate(figures.nees[:, figures.closure]),
        "closing_scan_one_shot": estimate(once.nees[:, once.closure]),
        "position_rmse_lap_2_m": estimate(np.sqrt((figures.error_m[:, lap_2] ** 2).mean(axis=1))),
    }
