"""`mecp-env warmup`: compile ahead.

Short drives that call what the commands call, so that it is compiled: `python -m mecp_env.cli.warmup NAME`.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mecp_env.cli.base import FAILED, Command, Line, echo, print_error
from mecp_env.core.carriers import Array
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.log_run import LogDrive, LogRunConfig, config_for
from mecp_env.logs import Log
from mecp_env.logs.registration import registered
from mecp_env.policies.rollout import EpisodeTask, run_episode
from mecp_env.policies.setting import Setting
from mecp_env.registration import make_rooms
from mecp_env.slam import SlamPipeline
from mecp_env.vector.hosted import explore
from mecp_env.world.config import LaserConfig, RobotConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.simulation import Simulation

ROOMS: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 4}, "max_steps": 200}
EPISODES = 8  # of random goals, and of random velocities
HELD = 10  # steps for which a velocity is held
VARIANTS: tuple[dict[str, Any], ...] = (  # fields of short drives
    {"laser": {"preset": "urg04lx"}, "odometry": {"preset": "turtlebot"}},
    {"observation": "flat"},
    {"observation": "image"},
    {"reward": "correct_coverage"},
    {"estimator": "known"},
)
TASK_STEPS = 150
SCANS, SPEED, TURN = 60, 0.4, 0.35  # of a log: m/s, rad/s


def episode() -> None:
    """What most episodes call: an exploration, goals at random, and velocities, which bump."""
    explore("paper")
    at_random(1, {"max_steps": 120})


def tasks() -> None:
    """What other observations, rewards, buildings, policies and tasks call beside that."""
    for fields in VARIANTS:
        at_random(1, {"max_steps": 120, **fields})
    for name, task in zip(("bfs", "gain", "nearest"), TASKS, strict=False):
        act(name, task)
    at_random(EPISODES, ROOMS)


def at_random(episodes: int, fields: dict[str, Any]) -> None:
    """Drives in generated buildings: to goals, and by velocities."""
    rng = np.random.default_rng(0)
    goals: Any = make_rooms(actions="goal", **fields)
    velocities = make_rooms(**fields)
    for seed in range(episodes):
        drive(goals, seed, lambda: rng.choice(np.append(np.flatnonzero(goals.action_masks()), 0)), 1)
        drive(velocities, seed, lambda: rng.uniform([0.3, -0.4], [1.0, 0.4]).astype(np.float32), HELD)


def drive(env: Any, seed: int, choose: Callable[[], Any], held: int) -> None:
    """One episode with actions that are held for so many steps."""
    env.reset(seed=seed)
    action = choose()
    for step in itertools.count(1):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return
        action = action if step % held else choose()


def act(name: str, task: str) -> None:
    """The start of an episode of a policy in a task of active SLAM."""
    run_episode(EpisodeTask(name, 0, Setting("", "train", max_steps=TASK_STEPS, task=task)))


def log() -> None:
    """Map a log with its odometry and without any, and search for the pose in the saved map."""
    made = made_log()
    for one in (made, registered(made)):
        run = LogDrive(one, SlamPipeline(config_for(one)), LogRunConfig())
        for _ in run.steps():
            pass
    run.result()  # with the final path and map
    run.pipeline.grid.canvas.set_room(np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]), 0)  # as where rooms merge
    with tempfile.TemporaryDirectory() as folder:
        run.pipeline.save_map(Path(folder) / "map.zip")
        lost = SlamPipeline.from_map(Path(folder) / "map.zip", "unknown")
    for row in (0, 0, 0):
        lost.start(made.scan(row))


def made_log() -> Log:
    """A drive in circles through the layout `two_rooms` with a laser of 240 degrees."""
    outline, rng = build_outline(load_layout("two_rooms")), np.random.default_rng(0)
    robot, laser = Simulation(outline, RobotConfig()), Laser(outline, LaserConfig(preset="urg04lx"))
    robot.reset(np.array(outline.starts[0]))
    ranges, poses = list[Array](), list[Array]()
    for _ in range(SCANS):
        scan = laser.scan(robot.T_world_robot, rng)
        sweep = scan.ranges[0].copy()
        sweep[~scan.hit[0]] = np.nan
        ranges.append(sweep)
        poses.append(robot.T_world_robot.copy())
        robot.step(SPEED, TURN)
    times, bearings = 0.4 * np.arange(SCANS, dtype=np.float64), scan.bearings[0].copy()
    return Log("drive", times, np.array(ranges), bearings, scan.max_range_m, np.zeros(3), np.array(poses))


DRIVES = {drive.__name__: drive for drive in (episode, log, tasks)}


@dataclass(frozen=True)
class WarmUp(Command):
    """Compile what the commands call into the user's cache, by short drives in processes of their own.

    Examples:
        mecp-env warmup
        mecp-env warmup --jobs 1
    """

    jobs: Annotated[int, Field(ge=1)] | None = None  # processes at the same time, at most two; default: one per core

    def run(self, line: Line) -> int:
        """Count the functions in the meantime; what no drive calls is compiled when it is called."""
        from rich.progress import Progress, SpinnerColumn, TextColumn

        from mecp_env.core import jit, warm_up
        from mecp_env.core.processes import cores

        place, together = jit.cache_directory(), (self.jobs or cores()) > 1
        if not jit.usable(place):
            print_error(f"{place} cannot be written; NUMBA_CACHE_DIR names another folder")
            return FAILED
        with Progress(SpinnerColumn(), TextColumn("{task.completed} functions")) as bar:
            task = bar.add_task("compiling", total=None)
            rows = (warm_up.FIRST, warm_up.LATER) if together else zip(warm_up.FIRST + warm_up.LATER)
            failed = [warm_up.compile_ahead(drives, lambda count: bar.update(task, completed=count)) for drives in rows]
        if any(failed):
            names = [name for row in failed for name in row]
            print_error(f"drives that failed: {', '.join(names)}; python -m {warm_up.DRIVES} {names[0]} says why")
            return FAILED
        echo(f"functions compiled, in {place}")
        return 0


if __name__ == "__main__":
    DRIVES[sys.argv[1]]()
