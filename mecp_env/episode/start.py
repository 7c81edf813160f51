"""The start of an episode: the layout's first start, a random pose in free space, or a given pose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from shapely.geometry import Point

from mecp_env.config import alternatives
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.core.settings import number
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import wall_distance
from mecp_env.world.outline import Outline, random_free_pose

Start = str | tuple[float, float, float]

OPTIONS = ("start", "building", "difficulty")
CLEARANCE_M = 0.05  # between the robot and the walls at a drawn start
MAX_TURN = 2.0 * math.pi


def parse_options(options: Any) -> dict[str, Any]:
    """The options of `reset`, unchecked but for their names. Raises `ConfigError` for an unknown one."""
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise ConfigError(f"options: expected a dict or None, given {type(options).__name__}")
    for name in options:
        if name not in OPTIONS:
            raise ConfigError(f"options.{name}: no such field{alternatives(name, OPTIONS)}")
    return options


def check_seed(seed: Any) -> int | None:
    """`seed` as a Python integer of at least 0, or None. Raises `ConfigError`."""
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"seed: {seed!r:.80}, expected an integer of at least 0 or None")
    return int(seed)


def check_start(start: Any, outline: Outline, robot: RobotConfig) -> Start:
    """`start` if it can be one: "layout", "random", or a pose at which the robot touches nothing.

    Raises `ConfigError`, also when the robot is too large for the layout's own start, or for any drawn one.
    """
    if isinstance(start, str) and start == "random":
        check_space(outline, robot)
        return start
    own = isinstance(start, str) and start == "layout"
    pose = to_pose(outline.starts[0] if own else start)
    if not outline.free_area.contains(Point(pose[:2])):
        raise ConfigError(f"start: {pose} does not lie in the free space of {outline.name!r}")
    room = wall_distance(outline.segments, pose[0], pose[1])
    if room < robot.radius_m:
        raise ConfigError(f"start: {pose} is {room:.3f} m from a wall, at least robot.radius_m = {robot.radius_m}")
    return "layout" if own else pose


def check_space(outline: Outline, robot: RobotConfig) -> None:
    """Raise `ConfigError` when there is no place where the robot touches nothing."""
    try:
        random_free_pose(outline, np.random.default_rng(0), robot.radius_m + CLEARANCE_M)
    except LayoutError as error:
        raise ConfigError(f"robot.radius_m: {robot.radius_m} m: {error}") from None


def to_pose(start: Any) -> tuple[float, float, float]:
    """`start` as three finite numbers, the heading at most a full turn. Raises `ConfigError`."""
    try:
        x, y, heading = (float(number(value)) for value in start)
    except (TypeError, ValueError):
        raise ConfigError(f'start: expected "layout", "random" or x, y, heading, given {start!r:.80}') from None
    if not np.isfinite([x, y, heading]).all():
        raise ConfigError(f"start: expected finite numbers, given {start!r:.80}")
    if abs(heading) > MAX_TURN:
        raise ConfigError(f"start: heading {heading:g} rad, at most {MAX_TURN:.4f} (a full turn) either way")
    return x, y, heading


def start_pose(start: Start, outline: Outline, robot: RobotConfig, rng: np.random.Generator) -> Array:
    """The pose (3,) in the world frame that `start` stands for; only "random" draws from `rng`."""
    if start == "random":
        return random_free_pose(outline, rng, robot.radius_m + CLEARANCE_M)
    if start == "layout":
        first: Array = outline.starts[0].copy()
        return first
    return np.array(start, np.float64)
