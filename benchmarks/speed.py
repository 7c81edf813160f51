"""Speed: steps per second of the whole environment, beside other simulators, and by stage; rays and polygons alone.

Everything runs on one core. Times are CPU times of this thread, so that other load on the machine does not count; steps
in which numba compiled or loaded a function are excluded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count

import numpy as np
import pymunk

from benchmarks import crowd_speed, peers, polygon_speed
from benchmarks.common import Figures, Options
from benchmarks.drives import exploration
from benchmarks.in_tree import BEAMS, SWEEPS
from benchmarks.polygon_speed import median_us
from benchmarks.random_actions import wander
from benchmarks.stopwatch import timed_stages
from benchmarks.tables import all_figures, one_table, sections, table_of, turned
from mecp_env.core.carriers import Array
from mecp_env.env import MecpEnv
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser, _cast
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import Outline, build_outline, random_free_pose
from mecp_env.wrappers import GoalActions
from tests.slam.scans import cast

LAYOUT = "paper"


def run(options: Options) -> Figures:
    """All results; the environment is measured for 3,000 steps per setting (--quick: 300)."""
    steps = 300 if options.quick else 3000
    return {
        "env": {f"K={k}": {name: timed(k, steps, drive) for name, drive in DRIVES.items()} for k in SWEEPS},
        "peers": peers.measure(5 if options.quick else 60, SWEEPS),
        "crowd": crowd_speed.measure(2 if options.quick else 12),
        "rays": rays(50 if options.quick else 300),
        "polygon": polygon_speed.measure(20 if options.quick else 200),
    }


def timed(sweeps: int, steps: int, drive: Callable[[MecpEnv, int], None]) -> Figures:
    """Steps per second of whole steps; then, on the same drive again, microseconds per stage."""
    env = MecpEnv(layout=LAYOUT, laser={"sweeps": sweeps, "beams": BEAMS}, max_steps=10**7)
    drive(env, 50)  # loads the compiled functions
    with timed_stages(each=False) as watch:
        drive(env, steps)
    with timed_stages() as stages:
        drive(env, steps)
    with_driver = watch.steps / (watch.seconds["step"] + watch.seconds["drive"])  # with planner and controller
    return {"steps_per_s": watch.steps_per_s, "with_driver_per_s": with_driver, "us": stages.microseconds()}


def explore(env: MecpEnv, steps: int) -> None:
    """Whole explorations, one after the other, until enough steps are over."""
    goals, seen = GoalActions(env), 0
    for *_, info in (goal for seed in count() for goal in exploration(goals, seed)):
        seen += info["periods"]
        if seen >= steps:
            return


DRIVES = {"random": wander, "bfs": explore}


def rays(poses: int) -> Figures:
    """Median time of a sweep of 720 rays from random poses: compiled, laser, pymunk, NumPy."""
    outline, rng = build_outline(load_layout(LAYOUT)), np.random.default_rng(0)
    places = [random_free_pose(outline, rng, 0.3) for _ in range(poses)]
    laser = Laser(outline, LaserConfig(preset="paper", sweeps=1, beams=BEAMS))
    few, space = places[:10], pymunk_space(outline)
    faces, angles = laser._segments, laser._table
    spacing = 2.0 * math.pi / angles.shape[1]
    return {
        "faces": len(outline.segments),
        "kernel_us": median_us(lambda pose: _cast(faces, pose, angles, spacing, 0.0), places),
        "laser_with_noise_us": median_us(lambda pose: laser.scan(pose, rng), places),
        "pymunk_us": median_us(lambda pose: query_pymunk(space, pose), few, repeats=3),
        "brute_force_numpy_us": median_us(lambda pose: brute_force(outline, pose), few, repeats=3),
    }


def pymunk_space(outline: Outline) -> pymunk.Space:
    """A space of the outline's faces as segments of radius 0."""
    space = pymunk.Space()
    faces = [(tuple(a), tuple(b)) for a, b in outline.segments.tolist()]
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in faces))
    return space


def angles_at(T_world_robot: Array) -> Array:
    """(720,) rad of the rays in the world."""
    return T_world_robot[2] - math.pi + np.arange(1, BEAMS + 1) * 2.0 * math.pi / BEAMS


def query_pymunk(space: pymunk.Space, T_world_robot: Array) -> list[float]:
    """Ranges of 720 rays by `segment_query_first`."""
    (x, y, _), reach = T_world_robot.tolist(), 30.0
    ranges = []
    for angle in angles_at(T_world_robot).tolist():
        end = x + reach * math.cos(angle), y + reach * math.sin(angle)
        found = space.segment_query_first((x, y), end, 0.0, pymunk.ShapeFilter())
        ranges.append(reach * found.alpha if found else math.inf)
    return ranges


def brute_force(outline: Outline, T_world_robot: Array) -> Array:
    """Ranges (720,) of every ray against every face, by NumPy."""
    ranges: Array = cast(outline.segments - T_world_robot[:2], angles_at(T_world_robot))
    return ranges


def report(figures: Figures) -> str:
    """Tables: steps per second, time per stage, rays, polygons."""
    settings = {f"{k}, {actions}": of for k, both in figures["env"].items() for actions, of in both.items()}
    polygon, rates = figures["polygon"], ("steps_per_s", "with_driver_per_s")
    return sections(
        {
            "Steps per second (layout `paper`, 720 beams, one core)": table_of("sweeps, actions", rates, settings),
            "Time per stage, us": turned({name: of["us"] for name, of in settings.items()}),
            "MiniGrid and ir-sim": peers.report(figures["peers"]),
            "A larger building, and pedestrians": f"{crowd_speed.__doc__}\n{one_table(figures['crowd'])}",
            "720 rays, us (median over poses)": all_figures(figures["rays"]),
            "Maximum Empty Convex Polygon, search and wall-crossing check, us (median)": turned(polygon["kernel"]),
            "The polygon stage on scans, edge intervals included (median)": one_table(polygon["scans"]),
        }
    )
