"""Restore: states of episodes and maps at random moments come back to the bit, and go on alike.

Each run is a random id with a random start, crowd, clutter, laser, odometry, observation, reward, planning, building or
floor plan, estimator, filter and associator, driven for a random number of steps of random actions: sometimes past the
end of the episode, and sometimes while the pose is searched for.
Then its state is read into a second environment and its map into a second pipeline. The state and the map must be
those that were kept, and 3 more steps (or a `reset` after the end) must give the same results and the same state after
them. Every tenth run is a recorded log from a random record on, whose map must go on alike for 3 more scans. Plans and
logs are those of `shared/data` beside the repository; without them, shipped buildings stand in. Every failure is listed
with what makes it again.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import mecp_env
from benchmarks import restore_logs
from benchmarks.common import Figures, Gate, Options, in_parallel
from benchmarks.random_actions import goal, velocity
from benchmarks.restore_logs import described, restored, same
from benchmarks.tables import listed, table
from benchmarks.worlds import PIXEL_M, plans_at_hand
from mecp_env.core.errors import PlanWarning
from mecp_env.core.snapshot_file import FileKind, load_snapshot, save_snapshot
from mecp_env.slam import SlamConfig
from mecp_env.slam.config import KINDS, METHODS
from mecp_env.world.config import DIFFICULTIES, SPLITS
from mecp_env.world.layout import LIBRARY

RUNS, QUICK = 1000, 10
MORE = 3  # steps after a state
LOG_EVERY = 10  # runs
FILE = FileKind("mecp_env state of the benchmark", 1, "0")
GATES = (Gate("all/failed", "bound", 0.0),)

ALL_PARTS = {"format": "dict", "map": True, "scan": True}
LASERS = ("ideal", "lms200", "urg04lx", "utm30lx", "rplidar_a1")
CHOICES: dict[str, tuple[Any, ...]] = {
    "actions": ("goal", "velocity", "discrete"),
    "crowd": ({}, {"people": 4}, {"people": 3, "polite": False}),
    "clutter": ({}, {"movable_boxes": 3, "closed_doors": 1}),
    "laser": ({}, {"max_range_m": 3.0}, *({"preset": name} for name in LASERS)),
    "odometry": ({}, {"preset": "turtlebot"}, {"preset": "skid_steer"}, {"reading": "per_step"}, {"scale": 0.0}),
    "observation": ({}, {"format": "flat"}, {"format": "image"}, {"uncertainty": True}, ALL_PARTS),
    "reward": ("coverage", "correct_coverage", "terms", "active_terms", {"shaping": 1.0}, {"source": "truth"}),
    "planning": ({}, {"known_ground": {"places": 4, "wait_steps": 5}}),
    "end": ({}, {"coverage": 0.1}),
    "goal_steps": (10, 1),
    "start": ("layout", "random"),
    "estimator": ("slam", "slam", "known", "truth"),
}
SLAM_CHOICES: dict[str, tuple[Any, ...]] = {
    "localisation": ({}, {}, {"explained_share": 0.0}),
    "panorama": ({}, {"use": "always"}, {"use": "never"}),
    "grid": ({}, {"resolution_m": 0.05}),
}


def run(options: Options) -> Figures:
    """How many runs came back, and the failures."""
    numbers = [(number,) for number in range(QUICK if options.quick else RUNS)]
    failures = [text for text in in_parallel(failure_of, str, numbers, options) if text]
    logs = len(numbers) // LOG_EVERY if restore_logs.logs_at_hand() else 0
    counts = {"runs": len(numbers), "of logs": logs, "plans": len(plans_at_hand()), "failed": len(failures)}
    return {"all": counts, "failures": dict(enumerate(failures))}


def one_of(choices: dict[str, tuple[Any, ...]], rng: np.random.Generator) -> dict[str, Any]:
    """One of the choices of each field."""
    return {key: values[int(rng.integers(len(values)))] for key, values in choices.items()}


def slam_of(rng: np.random.Generator) -> dict[str, Any]:
    """Random fields of the estimator; one in ten is that of the paper."""
    if rng.random() < 0.1:
        return SlamConfig.paper().model_dump(mode="json", exclude={"sensor"})
    method, kind = str(rng.choice(METHODS.ours[:-1])), str(rng.choice(KINDS.ours))  # "known" needs the ground truth
    return one_of(SLAM_CHOICES, rng) | {"filter": {"kind": kind}, "association": {"method": method}}


def building_of(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """The keywords of the building that an id takes."""
    shipped = sorted(LIBRARY.glob("*.json"))
    if name.endswith("Layout-v0"):
        return {"layout": str(rng.choice([path.stem for path in shipped]))}
    if name.endswith("FloorPlan-v0"):
        path = (*shipped, *plans_at_hand())[int(rng.integers(len(shipped) + len(plans_at_hand())))]
        return {"plan": str(path)} | ({"resolution_m": PIXEL_M} if path.suffix == ".png" else {})
    if name.endswith("Rooms-v0"):
        return {"difficulty": str(rng.choice(list(DIFFICULTIES))), "split": str(rng.choice(list(SPLITS)))}
    return {}


def failure_of(unit: tuple[int]) -> str:
    """What is wrong with the run of a number, empty when nothing is."""
    (number,) = unit
    rng = np.random.default_rng([39, number])
    if number % LOG_EVERY == LOG_EVERY - 1 and restore_logs.logs_at_hand():
        return restore_logs.failure_of(number, rng, slam_of(rng))
    name = str(rng.choice(list(mecp_env.ENVIRONMENTS)))
    fields = one_of(CHOICES, rng) | {"slam": slam_of(rng), "max_steps": int(rng.integers(5, 300))}
    fields |= building_of(name, rng)
    steps, lost = int(rng.integers(0, 100)), bool(rng.random() < 0.2)
    what = f"{number}: {name} {fields} after {steps} steps{', lost' * lost}"
    return described(what, lambda: fault_of(*pair_of(name, fields), rng, steps, lost))


def pair_of(name: str, fields: dict[str, Any]) -> tuple[Any, Any]:
    """Two environments of an id."""
    with warnings.catch_warnings(action="ignore", category=PlanWarning):
        first, second = (gym.make(name, disable_env_checker=True, **fields) for _ in range(2))
    return first, second


def fault_of(env: Any, other: Any, rng: np.random.Generator, steps: int, lost: bool) -> str:
    """What differs between an environment after so many steps and another one that continues it."""
    env.reset(seed=int(rng.integers(2**31)))
    other.reset(seed=0)
    own, others = env.unwrapped, other.unwrapped
    going = drive(env, rng, steps)
    if lost and going:
        own._started().pipeline.lose_pose()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.zip"
        save_snapshot(path, FILE, own.get_state())
        others.set_state(load_snapshot(path, FILE))
    if not same(others.get_state(), own.get_state()):
        return "another state"
    is_map = own.config.estimator == "slam"  # a map of ground truth is of no use
    return (restored(own)[1] if is_map else "") or after_fault(env, other, rng, going)


def drive(env: Any, rng: np.random.Generator, steps: int) -> bool:
    """Take at most so many steps; False when the episode ended before."""
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(action_of(env, rng))
        if terminated or truncated:
            return False
    return True


def action_of(env: Any, rng: np.random.Generator) -> Any:
    """A random action, among the goals one that may be chosen."""
    if env.unwrapped.config.actions == "discrete":
        return int(rng.integers(env.action_space.n))
    return (goal if env.unwrapped.config.actions == "goal" else velocity)(env, rng)


def after_fault(env: Any, other: Any, rng: np.random.Generator, going: bool) -> str:
    """What differs in the steps that follow."""
    if not going:
        return "" if same(env.reset(), other.reset()) else "another reset"
    for _ in range(MORE):
        action = action_of(env, rng)
        results = env.step(action), other.step(action)
        if not same(*results):
            return "another step"
        if results[0][2] or results[0][3]:
            break
    return "" if same(env.unwrapped.get_state(), other.unwrapped.get_state()) else "another state after it"


def faults(figures: Figures) -> list[str]:
    """The failures."""
    return list(figures["failures"].values())


def report(figures: Figures) -> str:
    """The counts, and every failure."""
    counts = figures["all"]
    found = listed(faults(figures), "All came back to the bit.")
    return f"{table(list(counts), [tuple(counts.values())])}\n\n{found}"
