"""Steps per second beside MiniGrid and ir-sim (extra `peers`), in alternating blocks in one process.

MiniGrid-FourRooms takes random actions. ir-sim casts 720 beams at the walls of the layout `paper`, without SLAM; its
robot takes random velocities and starts at another place after a contact. All times are CPU times of `env.step`,
without resets. A ratio compares the blocks of the same turn.
"""

from __future__ import annotations

import contextlib
import io
import math
import sys
import tempfile
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import shapely
import yaml
from numpy.random import Generator

from benchmarks.common import Figures, in_rounds, is_installed, ratio
from benchmarks.in_tree import ACTIONS, BEAMS, breadth_first
from benchmarks.random_actions import RandomDriver, velocity
from benchmarks.tables import one_table
from mecp_env.core.carriers import Array
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import ROBOT_RADIUS_M, build_outline, random_free_pose

BLOCK = {"random": 100, "breadth_first": 6, "MiniGrid-FourRooms-v0": 500, "ir-sim": 30}  # actions
PACKAGES = {"MiniGrid-FourRooms-v0": "minigrid", "ir-sim": "irsim"}
STEP_S = 0.4


class IrSim:
    """A robot with a laser of 720 beams between the walls of `paper` in ir-sim, as an environment of Gymnasium."""

    action_space = gymnasium.spaces.Discrete(1)  # none is drawn from it

    def __init__(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryDirectory() as folder:
            import irsim  # it prints which windows it cannot open

            path = Path(folder, "world.yaml")
            path.write_text(yaml.safe_dump(world()))
            self.env = irsim.make(str(path), headless=True, log_level="ERROR")
        self.outline, self.rng = build_outline(load_layout("paper")), np.random.default_rng(0)

    def reset(self, seed: int | None = None) -> tuple[None, dict[str, Any]]:
        """Start somewhere."""
        self.env.reset()
        self.env.robot.set_state(random_free_pose(self.outline, self.rng, 1.0))
        return None, {}

    def step(self, action: Array) -> tuple[None, float, bool, bool, dict[str, Any]]:
        """Move, and look; a contact ends the episode."""
        self.env.step(action)
        return None, 0.0, self.env.done(), False, {}


def world() -> dict[str, Any]:
    """The world file of ir-sim: the walls of `paper` as a few lines, and a laser like ours."""
    segments = build_outline(load_layout("paper")).segments
    lines = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(segments)))
    width, height = (segments.reshape(-1, 2).max(axis=0) + 1.0).tolist()
    laser = {"range_max": 30.0, "angle_range": 2.0 * math.pi, "number": BEAMS, "noise": True, "std": 0.05}
    robot = {"kinematics": {"name": "diff"}, "shape": {"name": "circle", "radius": ROBOT_RADIUS_M}}
    walls = [{"name": "linestring", "vertices": shapely.get_coordinates(line).tolist()} for line in lines]
    return {
        "world": {"width": width, "height": height, "step_time": STEP_S, "sample_time": STEP_S},
        "robot": robot | {"state": [3.0, 3.0, 0.0], "sensors": [{"name": "lidar2d"} | laser]},
        "obstacle": [{"shape": wall, "state": [0, 0, 0]} for wall in walls],
    }


def peer(name: str) -> RandomDriver:
    """The driver of a peer."""
    if name == "ir-sim":
        return RandomDriver(IrSim(), velocity)
    import minigrid  # noqa: F401  (registers its environments)

    return RandomDriver(gymnasium.make(name), lambda env, rng: rng.integers(7))


def ours(sweeps: int, actions: str) -> RandomDriver:
    """The driver of our environment."""
    kind, choose = ("velocity", velocity) if actions == "random" else ("goal", explore)
    laser = {"sweeps": sweeps, "beams": BEAMS}
    return RandomDriver(gymnasium.make("mecp_env/PaperMap-v0", actions=kind, laser=laser), choose)


def explore(env: Any, rng: Generator) -> int:
    """The next goal, breadth first."""
    return breadth_first(env, env.unwrapped.observation())


def measure(turns: int, sweeps: tuple[int, ...]) -> Figures:
    """For each peer that is installed, number of sweeps and kind of action of ours, the ratio of the speeds."""
    there = [name for name, package in PACKAGES.items() if is_installed(package)]
    for name in PACKAGES.keys() - set(there):
        print(f"{name} is not installed (extra `peers`): no comparison", file=sys.stderr)
    if not there:
        return {}
    blocks: dict[Any, Any] = {name: partial(peer(name).seconds_per_step, BLOCK[name]) for name in there}
    blocks |= {(k, kind): partial(ours(k, kind).seconds_per_step, BLOCK[kind]) for k in sweeps for kind in ACTIONS}
    s = in_rounds(blocks, turns)
    figures: Figures = {name: {f"K={k}": {} for k in sweeps} for name in there}
    for name, k, kind in product(there, sweeps, ACTIONS):
        speeds = {"steps_per_s": 1.0 / s[k, kind].mean(), "peer_steps_per_s": 1.0 / s[name].mean()}
        figures[name][f"K={k}"][kind] = {"ratio": ratio(s[name], s[k, kind])} | speeds
    return figures


def report(figures: Figures) -> str:
    """One row for each peer and each kind of action of ours."""
    return f"{__doc__}\n{one_table(figures)}" if figures else "The extra `peers` is not installed."
