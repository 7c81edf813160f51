"""Short drives that call what the commands call, so that it is compiled: `python -m mecp_env.cli.exercise NAME`."""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.log_run import LogDrive, LogRunConfig, config_for
from mecp_env.logs import Log
from mecp_env.logs.registration import registered
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import masks_of, options_of
from mecp_env.registration import make_rooms
from mecp_env.slam import SlamPipeline
from mecp_env.vector.exploration import explore
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
    policy = make_policy(name)
    env = gym.make(f"mecp_env/{task}", max_steps=TASK_STEPS, **options_of(policy))
    observation, _ = env.reset(seed=0)
    policy.reset(0)
    masks, over = masks_of(env), False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation, masks()))
        over = terminated or truncated
    env.get_wrapper_attr("summary")()


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

if __name__ == "__main__":
    DRIVES[sys.argv[1]]()
