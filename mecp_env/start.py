"""Where an episode starts: the layout's first start, a pose drawn anywhere in free space, or a given one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point

from mecp_env.config import unknown
from mecp_env.errors import ConfigError
from mecp_env.world.config import RobotConfig
from mecp_env.world.outline import Outline, random_free_pose
from mecp_env.world.simulation import wall_distance

Array = NDArray[np.float64]
Start = str | tuple[float, float, float]

CLEARANCE_M = 0.05  # between the robot and the walls at a drawn start


def parse_options(options: Any, default: Start, outline: Outline, robot: RobotConfig) -> Start:
    """The start that the options of `reset` ask for. Raises `ConfigError` for an unknown option."""
    if options is None:
        return default
    if not isinstance(options, dict):
        raise ConfigError(f"options: expected a dict or None, given {type(options).__name__}")
    for name in options:
        if name != "start":
            raise ConfigError(unknown(name, ["start"], "options"))
    return check_start(options.get("start", default), outline, robot)


def check_start(start: Any, outline: Outline, robot: RobotConfig) -> Start:
    """`start` if it can be one: "layout", "random", or a pose at which the robot touches nothing."""
    if isinstance(start, str) and start in ("layout", "random"):
        return start
    pose = to_pose(start)
    if not outline.free_area.contains(Point(pose[:2])):
        raise ConfigError(f"start: {pose} does not lie in the free space of {outline.name!r}")
    room = wall_distance(outline.segments, pose[0], pose[1])
    if room < robot.radius_m:
        raise ConfigError(
            f"start: {pose} is {room:.3f} m from a wall, at least {robot.radius_m} m (the robot's radius)"
        )
    return pose


def to_pose(start: Any) -> tuple[float, float, float]:
    """`start` as three finite numbers. Raises `ConfigError`."""
    try:
        x, y, heading = (float(value) for value in start)
    except (TypeError, ValueError):
        raise ConfigError(f'start: expected "layout", "random" or x, y, heading, given {start!r:.80}') from None
    if not np.isfinite([x, y, heading]).all():
        raise ConfigError(f"start: expected finite numbers, given {start!r:.80}")
    return x, y, heading


def start_pose(start: Start, outline: Outline, robot: RobotConfig, rng: np.random.Generator) -> Array:
    """The pose (3,) in the world frame that `start` stands for; only "random" draws from `rng`."""
    if start == "random":
        return random_free_pose(outline, rng, robot.radius_m + CLEARANCE_M)
    if start == "layout":
        first: Array = outline.starts[0].copy()
        return first
    return np.array(start, np.float64)
