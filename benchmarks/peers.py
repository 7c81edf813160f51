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
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import shapely
import yaml

from benchmarks.common import Figures, in_turns, is_installed, ratio
from benchmarks.in_tree import BEAMS, BlockDriver, random_commands
from benchmarks.tables import table
from mecp_env.core.carriers import Array
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import ROBOT_RADIUS_M, build_outline, random_free_pose

ACTIONS = ("random", "breadth_first")
BLOCK = 100  # steps of ours
STEP_S = 0.4

Block = Callable[[], tuple[int, float]]  # drives a block: steps, CPU seconds


def our_block(driver: BlockDriver) -> tuple[int, float]:
    """Drive a block in the environment of this tree; again where a function was compiled on the way."""
    done = driver.drive(BLOCK)
    return our_block(driver) if done["compiled"] else (done["steps"], done["seconds"])


class MiniGrid:
    """MiniGrid-FourRooms with the wrappers of `gymnasium.make` and random actions."""

    name, package, steps = "MiniGrid-FourRooms-v0", "minigrid", 500

    def __init__(self) -> None:
        import minigrid  # noqa: F401  (registers its environments)

        self.env = gymnasium.make(self.name)
        self.env.reset(seed=0)
        self.rng = np.random.default_rng(0)

    def __call__(self) -> tuple[int, float]:
        """Drive a block."""
        seconds = 0.0
        for action in self.rng.integers(0, 7, self.steps):
            start = time.process_time()
            _, _, terminated, truncated, _ = self.env.step(action)
            seconds += time.process_time() - start
            if terminated or truncated:
                self.env.reset()
        return self.steps, seconds


class IrSim:
    """A robot with a laser of 720 beams between the walls of `paper` in ir-sim."""

    name, package, steps = "ir-sim", "irsim", 30

    def __init__(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryDirectory() as folder:
            import irsim  # it prints which windows it cannot open

            path = Path(folder, "world.yaml")
            path.write_text(yaml.safe_dump(world()))
            self.env = irsim.make(str(path), headless=True, log_level="ERROR")
        self.rng, self.commands = np.random.default_rng(0), random_commands(0)
        self.outline = build_outline(load_layout("paper"))

    def __call__(self) -> tuple[int, float]:
        """Drive a block."""
        seconds = 0.0
        for _ in range(self.steps):
            command = next(self.commands)
            start = time.process_time()
            self.env.step(command)
            seconds += time.process_time() - start
            if self.env.done():
                self.env.reset()
                self.env.robot.set_state(random_free_pose(self.outline, self.rng, 1.0))
        return self.steps, seconds


def world() -> dict[str, Any]:
    """The world file of ir-sim: the walls of `paper` as a few lines, and a laser like ours."""
    segments = build_outline(load_layout("paper")).segments
    lines = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(segments)))
    width, height = (segments.reshape(-1, 2).max(axis=0) + 1.0).tolist()
    laser = {"range_max": 30.0, "angle_range": 2.0 * math.pi, "number": BEAMS, "noise": True, "std": 0.05}
    return {
        "world": {"width": width, "height": height, "step_time": STEP_S, "sample_time": STEP_S},
        "robot": {
            "kinematics": {"name": "diff"},
            "shape": {"name": "circle", "radius": ROBOT_RADIUS_M},
            "state": [3.0, 3.0, 0.0],
            "sensors": [{"name": "lidar2d"} | laser],
        },
        "obstacle": [
            {"shape": {"name": "linestring", "vertices": shapely.get_coordinates(line).tolist()}, "state": [0, 0, 0]}
            for line in lines
        ],
    }


def measure(turns: int, sweeps: tuple[int, ...]) -> Figures:
    """For each peer that is installed, number of sweeps and kind of action of ours, the ratio of the speeds."""
    peers = installed()
    if not peers:
        return {}
    ours = {(k, kind): partial(our_block, BlockDriver(kind, k)) for k in sweeps for kind in ACTIONS}
    drivers: dict[Any, Block] = peers | ours
    for drive in drivers.values():
        drive()  # loads compiled functions
    blocks = in_turns(drivers, turns)
    per_step = {name: np.array([turn[name][1] / turn[name][0] for turn in blocks]) for name in drivers}
    return {
        peer: {f"K={k}": {kind: compared(per_step[k, kind], per_step[peer]) for kind in ACTIONS} for k in sweeps}
        for peer in peers
    }


def installed() -> dict[Any, Block]:
    """The peers that can be imported; a line on stderr about each of the others."""
    found: dict[Any, Block] = {}
    for kind in (MiniGrid, IrSim):
        if is_installed(kind.package):
            found[kind.name] = kind()
        else:
            print(f"{kind.name} is not installed (extra `peers`): no comparison", file=sys.stderr)
    return found


def compared(ours: Array, theirs: Array) -> Figures:
    """Our steps per second over the peer's, and both, from the seconds per step in each turn."""
    return {"ratio": ratio(theirs, ours), "steps_per_s": 1.0 / ours.mean(), "peer_steps_per_s": 1.0 / theirs.mean()}


def report(figures: Figures) -> str:
    """One row for each peer and each kind of action of ours."""
    rows = [
        (peer, k, actions, *(values[name] for name in ("ratio", "steps_per_s", "peer_steps_per_s")))
        for peer, settings in figures.items()
        for k, both in settings.items()
        for actions, values in both.items()
    ]
    head = ["peer", "sweeps", "actions", "our steps per second over the peer's", "our steps per second", "the peer's"]
    return f"{__doc__}\n{table(head, rows)}" if rows else "The extra `peers` is not installed."
