"""Restore: states of episodes and maps at random moments come back to the bit, and go on alike.

Each run is a random id with a random start, crowd, clutter, laser, odometry, observation, reward, planning, building or
floor plan, estimator, filter and associator, driven for a random number of steps of random actions: sometimes past the
end of the episode, and sometimes while the pose is searched for.
Then its state is read into a second environment and its map into a second pipeline. The state and the map must be
those that were kept, and 3 more steps (or a `reset` after the end) must give the same results and the same state after
them. Plans are those of `shared/data` beside the repository; without them, shipped buildings stand in. Every failure is
listed with what makes it again.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import mecp_env
from benchmarks.common import Figures, Options, in_parallel
from benchmarks.random_actions import goal, sample, velocity
from benchmarks.worlds import PIXEL_M, plans_at_hand
from mecp_env.core.snapshot_file import FileKind, load_snapshot, save_snapshot
from mecp_env.slam import SlamConfig, SlamPipeline
from mecp_env.slam.config import KINDS, METHODS
from mecp_env.world.config import DIFFICULTIES, SPLITS
from mecp_env.world.layout import LIBRARY
from tests.env.helpers import same

RUNS, QUICK = 1000, 10
MORE = 3  # steps after a state
FILE = FileKind("mecp_env state of the benchmark", 1, "0")
LASERS = ("ideal", "lms200", "urg04lx", "utm30lx", "rplidar_a1")
CHOICES: dict[str, tuple[Any, ...]] = {
    "actions": ("goal", "velocity", "discrete"),
    "crowd": ({}, {"people": 4}, {"people": 3, "polite": False}),
    "clutter": ({}, {"movable_boxes": 3, "closed_doors": 1}),
    "laser": ({}, {"max_range_m": 3.0}, *({"preset": name} for name in LASERS)),
    "odometry": ({}, {"preset": "turtlebot"}, {"preset": "skid_steer"}, {"reading": "per_step"}, {"scale": 0.0}),
    "observation": ({}, "flat", "image", {"uncertainty": True}, {"format": "dict", "map": True, "scan": True}),
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
ACTIONS = {"goal": goal, "velocity": velocity, "discrete": sample}


def run(options: Options) -> Figures:
    """How many runs came back, and the failures."""
    numbers = [(number,) for number in range(QUICK if options.quick else RUNS)]
    failures = [text for text in in_parallel(failure_of, str, numbers, options) if text]
    counts = {"runs": len(numbers), "plans": len(plans_at_hand()), "failed": len(failures)}
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
    """What was run and what is wrong with it, empty when nothing is; an error of any kind is a finding, too."""
    (number,) = unit
    rng = np.random.default_rng([39, number])
    name = str(rng.choice(list(mecp_env.ENVIRONMENTS)))
    fields = one_of(CHOICES, rng) | {"slam": slam_of(rng), "max_steps": int(rng.integers(5, 300))}
    fields |= building_of(name, rng)
    steps, lost = int(rng.integers(0, 100)), bool(rng.random() < 0.2)
    try:
        with warnings.catch_warnings(action="ignore"):
            env, other = (gym.make(name, disable_env_checker=True, **fields) for _ in range(2))
            fault = fault_of(env, other, rng, steps, lost)
    except Exception as error:
        fault = f"{type(error).__name__}: {error}"
    return f"{number}: {name} {fields} after {steps} steps{', lost' * lost}: {fault}" if fault else ""


def fault_of(env: Any, other: Any, rng: np.random.Generator, steps: int, lost: bool) -> str:
    """What differs between an environment after so many steps and another one that continues it."""
    env.reset(seed=int(rng.integers(2**31)))
    other.reset(seed=0)
    own, others, act = env.unwrapped, other.unwrapped, ACTIONS[env.unwrapped.config.actions]
    env.action_space.seed(int(rng.integers(2**31)))
    going = not any(any(env.step(act(env, rng))[2:4]) for _ in range(steps))
    if lost and going:
        own._started().pipeline.lose_pose()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.zip"
        save_snapshot(path, FILE, own.get_state())
        others.set_state(load_snapshot(path, FILE))
    if not same(others.get_state(), own.get_state()):
        return "another state"
    if own.config.estimator == "slam" and not is_restored(own):  # a map of ground truth is of no use
        return "another map"
    if not going:
        return "" if same(env.reset(), other.reset()) else "another reset"
    for _ in range(MORE):
        action = act(env, rng)
        first, second = env.step(action), other.step(action)
        if not same(first, second):
            return "another step"
        if any(first[2:4]):
            break
    return "" if same(own.get_state(), others.get_state()) else "another state after it"


def is_restored(env: Any) -> bool:
    """Whether the map that an environment saves is the same when it is read and saved again."""
    with tempfile.TemporaryDirectory() as folder:
        first, second = Path(folder) / "map.zip", Path(folder) / "again.zip"
        env.save_map(first)
        SlamPipeline.from_map(first).save_map(second)
        return first.read_bytes() == second.read_bytes()


def faults(figures: Figures) -> list[str]:
    """The failures."""
    return list(figures["failures"].values())
