"""Time of the MECP search with its lazy wall-crossing check on random sites, and of the whole stage on real scans.

Times are CPU times of this thread. "kernel" is one call from Python of search and check (720 beams that end on a wall
9 m away, tolerance 5 cm, two ties kept) for n sites in a 10 x 10 m square or on an ellipse.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.common import Figures, estimate
from benchmarks.rough_pose import polygons_of
from mecp_env.core.carriers import Array
from mecp_env.slam.config import PolygonConfig, SlamConfig
from mecp_env.slam.frontend import front_end
from mecp_env.slam.mecp.cycles import order_by_bearing
from mecp_env.slam.mecp.polygons import EdgeBeams, best_free_cycles
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.outline import build_outline, random_free_pose

SITES = (5, 10, 15, 20, 30, 40)
GROUPS = 5  # of sets of sites, over which an exponent spreads
SIGMAS = np.full(max(SITES), 0.02)  # m
LIMITS = PolygonConfig().record[0]
SPACING = math.pi / 360.0
BEARINGS = (np.arange(720, dtype=np.float64) + 0.5) * SPACING - math.pi
BEAMS = EdgeBeams(np.full(720, 9.0), BEARINGS, np.ones(720, np.bool_), SPACING)


def measure(sets: int = 100) -> Figures:
    """Median microseconds: {"kernel": {"uniform" | "convex": {"n=5": us, ...}}, "scans": {layout: {...}}}."""
    return {
        "kernel": {
            kind: {f"n={n}": median_us(search, sites(kind, n, sets)) for n in SITES} for kind in ("uniform", "convex")
        },
        "scans": {name: on_scans(name, sets) for name in shipped_layouts()},
    }


def search(points: Array) -> object:
    """Search and wall-crossing check on sites sorted by bearing."""
    return best_free_cycles(points, SIGMAS[: len(points)], BEAMS, LIMITS, False)


def sites(kind: str, n: int, sets: int) -> list[Array]:
    """Sets of sites anywhere in a square around the robot, or on an ellipse: the worst case of the search."""
    rng, found = np.random.default_rng(n), []
    for _ in range(sets):
        if kind == "uniform":
            points = rng.uniform(-5.0, 5.0, (n, 2))
        else:
            a = np.sort(rng.uniform(0.0, 2.0 * math.pi, n))
            points = np.column_stack([5.0 * np.cos(a), 3.0 * np.sin(a)])
        found.append(np.ascontiguousarray(points[order_by_bearing(points)]))
    return found


def on_scans(layout: str, scans: int) -> Figures:
    """The whole stage with edge intervals, on scans from random poses in a layout at the paper's noise."""
    outline, config, rng = build_outline(load_layout(layout)), SlamConfig(), np.random.default_rng(0)
    laser = Laser(outline, LaserConfig())
    seen = [front_end(laser.scan(random_free_pose(outline, rng, 0.3), rng), config) for _ in range(scans)]
    return {
        "sites": float(np.median([found.corners.sites.sum() for found in seen])),
        "stage_us": median_us(lambda found: polygons_of(found, config), seen),
    }


def median_us(call: Callable[[Any], object], items: Sequence[Any], repeats: int = 20) -> float:
    """Median over the items of the mean time of one call."""
    times = []
    for item in items:
        call(item)
        start = time.thread_time_ns()
        for _ in range(repeats):
            call(item)
        times.append((time.thread_time_ns() - start) * 1e-3 / repeats)
    return float(np.median(times))


def exponents(counts: Sequence[int], sets: int) -> Figures:
    """Slope of log time over log sites of the polygon search, with the spread over groups of sets of sites."""
    figures: Figures = {}
    for kind in ("uniform", "convex"):
        items = {n: sites(kind, n, sets) for n in counts}
        us = [[median_us(search, items[n][k::GROUPS]) for n in counts] for k in range(GROUPS)]
        figures[f"exponent_{kind}"] = estimate(np.polyfit(np.log(counts), np.log(us).T, 1)[0])
    return figures
