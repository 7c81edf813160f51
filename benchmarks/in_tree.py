"""The script that a benchmark runs inside a source tree, ours or an older one (see `trees.py`).

Usage: `in_tree.py drive WARM_UP BLOCK BLOCKS` or `in_tree.py start`, with the tree first on the path; it answers in its
last line. It imports nothing of ours but `mecp_env`, and of that uses only what every tree has: environment ids,
keywords, observations and info keys.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numba.core import event

import mecp_env

BEAMS = 720
ACTIONS, SWEEPS = ("random", "breadth_first"), (1, 4)
PATH, KIND, ROOM, LEVEL, VALID = 2, 4, 5, 6, 8  # columns of the observation's goals
DOOR = 3  # kind of a goal
STEPS_OF_START = 30
EPISODE = 10  # blocks; an episode may end earlier by itself


def drive(actions: str, sweeps: int, warm_up: int, block: int, blocks: int) -> dict[str, Any]:
    """Control steps on `PaperMap-v0`, the CPU seconds of `env.step`, and a digest of the last observation.

    A block in which a function was compiled or loaded does not count. A new episode starts where the last one ended,
    and after ten blocks.
    """
    kind = {"random": "velocity", "breadth_first": "goal"}[actions]
    env = gymnasium.make("mecp_env/PaperMap-v0", actions=kind, laser={"sweeps": sweeps, "beams": BEAMS})
    answer, over = {"steps": 0, "seconds": 0.0}, True
    for number, most in enumerate([warm_up] + [block] * blocks):
        if over or number % EPISODE == 0:
            observation, info = env.reset(seed=number)
            commands, over = random_commands(number), False
        first, seconds = control_steps(info), 0.0
        with event.install_recorder("numba:compiler_lock") as compilations:
            while control_steps(info) < first + most and not over:
                action = next(commands) if actions == "random" else breadth_first(env, observation)
                start = time.process_time()
                observation, _, terminated, truncated, info = env.step(action)
                seconds += time.process_time() - start
                over = terminated or truncated
        if number and not compilations.buffer:
            answer = {"steps": answer["steps"] + control_steps(info) - first, "seconds": answer["seconds"] + seconds}
    digest = hashlib.sha256(b"".join(observation[name].tobytes() for name in sorted(observation)))
    return answer | {"digest": digest.hexdigest()}


def control_steps(info: dict[str, Any]) -> int:
    """The control steps of the episode so far."""
    return int(info["period"] if "period" in info else info.get("step", 0))


def random_commands(seed: int) -> Iterator[Any]:
    """Random velocities, mostly forwards, each held for ten control steps."""
    rng = np.random.default_rng(seed)
    while True:
        command = rng.uniform([0.3, -0.4], [1.0, 0.4]).astype(np.float32)
        for _ in range(10):
            yield command


def breadth_first(env: Any, observation: dict[str, Any]) -> int:
    """The next goal of an environment."""
    return next_goal(observation["goals"], env.get_wrapper_attr("action_masks")())


def next_goal(goals: Any, mask: Any) -> int:
    """Row of the next goal: the current room first, nearest level first; then other rooms; doors last."""
    rows = [row for row in range(len(goals)) if mask[row] and goals[row, VALID] > 0.5]
    indoors = [row for row in rows if goals[row, KIND] != DOOR]

    def rank(row: int) -> tuple[float, ...]:
        path, level = goals[row, PATH], goals[row, LEVEL]
        if goals[row, KIND] == DOOR:
            return 2.0, level, path
        return (0.0, level, path) if goals[row, ROOM] == goals[indoors[0], ROOM] else (1.0, path, level)

    return min(rows, key=rank, default=0)


def first_start() -> dict[str, Any]:
    """What a new user runs first: `two_rooms`, 30 steps with velocities, then one goal, breadth first."""
    env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms")
    env.reset(seed=0)
    commands = random_commands(0)
    for _ in range(STEPS_OF_START):
        env.step(next(commands))
    env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms", actions="goal")
    observation, _ = env.reset(seed=0)
    env.step(breadth_first(env, observation))
    return {}


if __name__ == "__main__":
    if Path.cwd() not in Path(mecp_env.__file__).parents:
        sys.exit(f"it imported {mecp_env.__file__}, not the package in {Path.cwd()}")
    mode, *counts = sys.argv[1:]
    if mode == "start":
        print(json.dumps(first_start()))
    else:
        settings = [(sweeps, actions) for sweeps in SWEEPS for actions in ACTIONS]
        print(json.dumps({f"K={k} {actions}": drive(actions, k, *map(int, counts)) for k, actions in settings}))
