"""The filters: microseconds per call by map size, and consistency (NEES) on a ring of rooms.

Correspondences are known, so that only the filter is measured. The expected NEES of a pose is 3; the 95 % band of the
mean of 60 runs is 2.41-3.65.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.common import Figures, Options, best_of, estimate, in_parallel
from benchmarks.ring import Variance, config_of, linear, make_course, monte_carlo, per_metre, per_step
from benchmarks.tables import table_of
from mecp_env.core.carriers import Array
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import FILTERS, make_filter

LANDMARKS = (25, 50, 100, 200)
CORNERS = 12  # per scan
READINGS: dict[str, tuple[Variance, float]] = {  # noise and length of a step, m
    "per_metre": (per_metre, 0.25),
    "per_step_0.25_m": (per_step, 0.25),
    "per_step_1_m": (per_step, 1.0),
    "linear": (linear, 0.25),
}


def run(options: Options) -> Figures:
    """Times of all filters, and their NEES and error for every reading of the paper's odometry noise."""
    cases = [(reading, kind, 8 if options.quick else 60) for reading in READINGS for kind in FILTERS]
    nees: Figures = {reading: {} for reading in READINGS}
    for (reading, kind, _), figures in zip(cases, in_parallel(consistency, Figures, cases, options), strict=True):
        nees[reading][kind] = figures
    times = {kind: {str(count): times_us(kind, count) for count in LANDMARKS} for kind in FILTERS}
    return {"time_us": times, "nees": nees}


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


def times_us(kind: str, count: int) -> Figures:
    """Microseconds of the calls of one step with `count` landmarks, 12 corners and polygons with 5 vertices."""
    rng, belief = np.random.default_rng(0), make_filter(FilterConfig(kind=kind))
    z = np.stack([rng.uniform(1, 10, count), rng.uniform(-3, 3, count)], axis=1)
    belief.augment(z, sensor_cov(count), np.arange(count))
    arcs, ids = np.tile([0.05, 0.01], (4, 1)), np.arange(CORNERS) * (count // CORNERS)
    odometry = Odometry(np.zeros((4, 2)), per_metre(arcs)[:, :, None] * np.eye(2), False)
    seen, polygon = (z[ids], sensor_cov(CORNERS), ids), (z[ids[:5]], sensor_cov(5), ids[:5])
    calls: dict[str, Callable[[], object]] = {
        "predict": partial(belief.predict, odometry),
        "update": partial(belief.update, *seen),
        "innovation": partial(belief.innovation, *seen),
        "individual_nis": partial(belief.individual_nis, z[ids], np.tile(sensor_cov(1), (CORNERS, 1, 1)), belief.ids),
        "joint_nis": partial(belief.joint_nis, *polygon),
        "mean_of_gaussians_nis": partial(belief.mean_of_gaussians_nis, *polygon),
        "belief": belief.belief,
    }
    return {name: 1e6 * best_of(call, repeats=15, calls=50) for name, call in calls.items()}


def sensor_cov(count: int) -> Array:
    """(2n,2n) m, rad: corner covariance for 1 cm and 0.3 degrees."""
    return np.diag(np.tile([0.01**2, 0.005**2], count))


def report(figures: Figures) -> str:
    """Tables of the times and of the consistency."""
    times = {f"{kind}, {count}": us for kind, sizes in figures["time_us"].items() for count, us in sizes.items()}
    nees = {f"{reading}, {kind}": row for reading, kinds in figures["nees"].items() for kind, row in kinds.items()}
    values = {case: {name: estimated["value"] for name, estimated in row.items()} for case, row in nees.items()}
    tables = []
    for head, rows, digits in (("us, landmarks", times, 1), ("NEES (3 expected)", values, 2)):
        texts = {name: {key: f"{value:.{digits}f}" for key, value in row.items()} for name, row in rows.items()}
        tables.append(table_of(head, list(next(iter(texts.values()))), texts))
    return "\n\n".join(tables)
