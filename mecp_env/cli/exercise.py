"""Short drives that call every compiled function which the commands call, with the types of their arguments."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.env import MecpEnv
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.log_run import LogDrive, LogRunConfig, config_for
from mecp_env.logs import Log
from mecp_env.logs.registration import registered
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.policies.registry import OURS, make_policy
from mecp_env.policies.rollout import masks_of, options_of
from mecp_env.registration import make_rooms
from mecp_env.slam import SlamPipeline
from mecp_env.world.config import LaserConfig, RobotConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.simulation import Simulation
from mecp_env.wrappers import GoalActions

ROOMS: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 4}, "max_steps": 200}
EPISODES = 40  # of random goals, and of random velocities
HELD = 10  # steps for which a velocity is held
VARIANTS: tuple[dict[str, Any], ...] = (  # fields of short drives
    {"slam": {"filter": {"kind": "ekf"}}},
    {"laser": {"preset": "urg04lx"}, "odometry": {"preset": "turtlebot"}},
    {"observation": "flat"},
    {"observation": "image"},
    {"estimator": "known"},
    {"estimator": "truth"},
    {"reward": "correct_coverage"},
    {"reward": "terms"},
    {"reward": "active_terms"},
)
TASK_STEPS = 150
SCANS, SPEED, TURN = 60, 0.4, 0.35  # of a log: m/s, rad/s


def exercise() -> None:
    """Explore the layout `paper`, then what the other commands do, each for a short time."""
    explore()
    at_random(EPISODES, ROOMS)
    for fields in VARIANTS:
        at_random(2, {"max_steps": 120, **fields})
    for name, task in zip((*OURS, "gain"), itertools.cycle(TASKS), strict=False):
        act(name, task)
    map_log()


def explore() -> None:
    """One exploration."""
    env, policy = MecpEnv(layout="paper"), BreadthFirst()
    goals = GoalActions(env)
    observation, _ = goals.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = goals.step(policy.act(observation, goals.action_masks()))
        over = terminated or truncated
    env.summary()


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


def map_log() -> None:
    """Map a log with its odometry and without any, and search for the pose in the saved map."""
    log = made_log()
    for one in (log, registered(log)):
        run = LogDrive(one, SlamPipeline(config_for(one)), LogRunConfig())
        for _ in run.steps():
            pass
    run.result()  # with the final path and map
    run.pipeline.grid.canvas.set_room(np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]), 0)  # as where rooms merge
    with tempfile.TemporaryDirectory() as folder:
        run.pipeline.save_map(Path(folder) / "map.zip")
        lost = SlamPipeline.from_map(Path(folder) / "map.zip", "unknown")
    for row in (0, 0, 0):
        lost.start(log.scan(row))


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
