"""`mecp-env warmup`: compile ahead.

Short runs of the commands, so that what they call is compiled: `python -m mecp_env.cli.warmup NAME`.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from mecp_env.cli import main
from mecp_env.cli.base import FAILED, WRONG_INPUT, Command, Line, echo, print_error
from mecp_env.core import jit, warm_up
from mecp_env.core.processes import cores
from mecp_env.registration import make_rooms
from mecp_env.world.config import LaserConfig, RobotConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.simulation import Simulation

SCANS, SPEED, TURN = 60, 0.4, 0.35  # of a log: m/s, rad/s
CHEAP = "--env.laser.preset urg04lx --env.odometry.preset turtlebot"
LIVELY = "--env.crowd.people 2 --env.clutter.movable-boxes 4"
EVALUATE = "evaluate nearest --difficulty easy --known"
LINES = {  # by the name of a process
    "episode": ("explore bfs", "explore random_walk --difficulty easy --steps 120"),
    "log": (
        "slam log.npz --out online --save-map map.zip",
        "slam log.npz --out registered --odometry none",
        "slam log.npz --out found --from-map map.zip --start unknown",
        "export map.zip --landmarks x.csv --rooms x.geojson",
    ),
    "tasks": (
        "explore pause --task ActiveHalls-v0 --steps 150",
        "explore returning --task ActiveCorridors-v0 --steps 150",
        "explore stachniss --task ActiveCheapRobot-v0 --steps 150",
        "demo --layout two_rooms --config.slam.filter.kind ekf --config.max-steps 100",
        f"{EVALUATE} --episodes 1 --max-steps 150 --out cheap {CHEAP}",
        f"{EVALUATE} --episodes 8 --max-steps 200 --out lively {LIVELY}",
        f"evaluate random_goal random_walk --no-truth --episodes 8 --max-steps 200 --out random {LIVELY}",
        "worlds stats paper hard:0",
    ),
}


def compile_by(name: str) -> int:
    """Run the lines of that name; the exit code."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if name == "log":
            write_log(Path("log.npz"))
        if name == "tasks":
            observe()
        return FAILED if WRONG_INPUT in [main.main(line.split()) for line in LINES[name]] else 0


def observe() -> None:
    """Make the observations of policies that learn, and their reward."""
    for observation in ("flat", "image"):
        env = make_rooms(observation=observation, reward="correct_coverage")
        env.reset(seed=0)
        env.step(env.action_space.sample())


def write_log(path: Path) -> None:
    """Write a drive in circles through the layout `two_rooms`, with a laser of 240 degrees."""
    outline, rng = build_outline(load_layout("two_rooms")), np.random.default_rng(0)
    robot, laser = Simulation(outline, RobotConfig()), Laser(outline, LaserConfig(preset="urg04lx"))
    robot.reset(np.array(outline.starts[0]))
    scans, poses = [], []
    for _ in range(SCANS):
        scans.append(laser.scan(robot.T_world_robot, rng))
        poses.append(robot.T_world_robot.copy())
        robot.step(SPEED, TURN)
    ranges = [np.where(scan.hit[0], scan.ranges[0], np.nan) for scan in scans]
    beams = {"ranges": ranges, "angles": scans[0].bearings[0], "max_range_m": scans[0].max_range_m}
    np.savez(path, t=0.4 * np.arange(SCANS), odo=poses, **beams)


@dataclass(frozen=True)
class WarmUp(Command):
    """Compile what the commands call into the user's cache, by short runs in processes of their own.

    Examples:
        mecp-env warmup
        mecp-env warmup --jobs 1
    """

    jobs: Annotated[int, Field(ge=1)] | None = None  # processes at the same time, at most two; default: one per core

    def run(self, line: Line) -> int:
        """Count the functions in the meantime; what no run calls is compiled when it is called."""
        place, together = jit.cache_directory(), (self.jobs or cores()) > 1
        if not jit.usable(place):
            print_error(f"{place} cannot be written; NUMBA_CACHE_DIR names another folder")
            return FAILED
        rows = (warm_up.FIRST, warm_up.LATER) if together else zip(warm_up.FIRST + warm_up.LATER)
        failed = [name for names in rows for name in warm_up.compile_ahead(names, warm_up.show)]
        if failed:
            print_error(f"runs that failed: {', '.join(failed)}; python -m {warm_up.DRIVES} {failed[0]} says why")
            return FAILED
        echo(f"functions compiled, in {place}")
        return 0


if __name__ == "__main__":
    sys.exit(compile_by(sys.argv[1]))
