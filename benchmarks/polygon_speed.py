"""Time of the MECP search with its lazy wall-crossing check on random sites, and of the whole stage on real scans.

Times are CPU times of this thread. "kernel" is one call from Python of search and check (720 beams that end on a wall
9 m away, tolerance 5 cm, two ties kept) for n sites in a 10 x 10 m square or on an ellipse.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from benchmarks.common import Figures, estimate
from benchmarks.rough_pose import front_end
from mecp_env.core.carriers import Array, Bools
from mecp_env.slam.config import PolygonConfig, SlamConfig
from mecp_env.slam.mecp.cycles import order_by_bearing
from mecp_env.slam.mecp.polygons import EdgeBeams, best_free_cycles, find_polygons
from mecp_env.slam.messages import Corners, MergedScan
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.outline import build_outline, random_free_pose

Item = TypeVar("Item")
SeenScan = tuple[Corners, MergedScan, Bools]

SITES = (5, 10, 15, 20, 30, 40)
GROUPS = 5  # of sets of sites, over which an exponent spreads
SIGMAS = np.full(max(SITES), 0.02)  # m
LIMITS = PolygonConfig().record[0]
BEAMS = EdgeBeams(
    np.full(720, 9.0),
    (np.arange(720, dtype=np.float64) + 0.5) * math.pi / 360.0 - math.pi,
    np.ones(720, np.bool_),
    math.pi / 360.0,
)


def measure(sets: int = 100) -> Figures:
    """Median microseconds: {"kernel": {"uniform" | "convex": {"n=5": us, ...}}, "scans": {layout: {...}}}."""
    return {
        "kernel": {
            "uniform": {f"n={n}": median_us(search, uniform(n, sets)) for n in SITES},
            "convex": {f"n={n}": median_us(search, convex(n, sets)) for n in SITES},
        },
        "scans": {name: on_scans(name, sets) for name in shipped_layouts()},
    }


def search(sites: Array) -> object:
    """Search and wall-crossing check on sites sorted by bearing."""
    return best_free_cycles(sites, SIGMAS[: len(sites)], BEAMS, LIMITS, False)


def uniform(n: int, sets: int) -> list[Array]:
    """Sites anywhere in a square around the robot."""
    rng = np.random.default_rng(n)
    return [by_bearing(rng.uniform(-5.0, 5.0, (n, 2))) for _ in range(sets)]


def convex(n: int, sets: int) -> list[Array]:
    """Sites on an ellipse around the robot: the worst case of the search."""
    rng = np.random.default_rng(n)
    angles = [np.sort(rng.uniform(0.0, 2.0 * math.pi, n)) for _ in range(sets)]
    return [by_bearing(np.column_stack([5.0 * np.cos(a), 3.0 * np.sin(a)])) for a in angles]


def by_bearing(points: Array) -> Array:
    """The points in the order that the compiled functions expect."""
    return np.ascontiguousarray(points[order_by_bearing(points)])


def on_scans(layout: str, scans: int) -> Figures:
    """The whole stage with edge intervals, on scans from random poses in a layout at the paper's noise."""
    seen = list(scans_of(layout, scans))
    config = PolygonConfig()
    return {
        "sites": float(np.median([corners.sites.sum() for corners, _, _ in seen])),
        "stage_us": median_us(lambda scan: find_polygons(scan[0], scan[1], config, scan[2]), seen),
    }


def scans_of(layout: str, scans: int) -> Iterator[SeenScan]:
    """Corners, beams and the mask of beams on walls, from random poses."""
    outline, config, rng = build_outline(load_layout(layout)), SlamConfig(), np.random.default_rng(0)
    laser = Laser(outline, LaserConfig())
    for _ in range(scans):
        yield front_end(laser.scan(random_free_pose(outline, rng, 0.3), rng), config)


def median_us(call: Callable[[Item], object], items: Sequence[Item], repeats: int = 20) -> float:
    """Median over the items of the mean time of one call."""
    times = []
    for item in items:
        call(item)
        start = time.thread_time_ns()
        for _ in range(repeats):
            call(item)
        times.append((time.thread_time_ns() - start) * 1e-3 / repeats)
    return float(np.median(times))


def exponents(sites: Sequence[int], sets: int) -> Figures:
    """Slope of log time over log sites of the polygon search, with the spread over groups of sets of sites."""
    return {f"exponent_{make.__name__}": estimate(slopes(make, sites, sets)) for make in (uniform, convex)}


def slopes(make: Callable[[int, int], list[Array]], sites: Sequence[int], sets: int) -> list[float]:
    """The slope in each group."""
    items = {n: [by_bearing(points) for points in make(n, sets)] for n in sites}
    groups = [[median_us(search, items[n][k::GROUPS]) for n in sites] for k in range(GROUPS)]
    return [float(np.polyfit(np.log(sites), np.log(group), 1)[0]) for group in groups]
