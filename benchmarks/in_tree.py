"""The script that a benchmark runs inside a source tree, ours or an older one (see `trees.py`).

Usage: `in_tree.py drive ACTIONS SWEEPS` or `in_tree.py start`, with the tree first on the path. It imports nothing of
ours but `mecp_env`, and of that uses only what every tree has: environment ids, keywords, observations and info keys.
"""

from __future__ import annotations

import hashlib
import json
import os
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
PATH, KIND, ROOM, LEVEL, VALID = 2, 4, 5, 6, 8  # columns of the observation's goals
DOOR = 3  # kind of a goal
STEPS_OF_START = 30
EPISODE = 10  # blocks; an episode may end earlier by itself


class Compilations(event.Listener):  # type: ignore[misc]
    """Notes when numba compiles or loads a function."""

    noted = False

    def on_start(self, event: Any) -> None:
        self.noted = True

    def on_end(self, event: Any) -> None:
        """Nothing to note: the start was."""


class BlockDriver:
    """One environment on `PaperMap-v0` and the actions that drive it, in blocks of control steps."""

    def __init__(self, actions: str, sweeps: int) -> None:
        kind = {"random": "velocity", "breadth_first": "goal"}[actions]
        self.env = gymnasium.make("mecp_env/PaperMap-v0", actions=kind, laser={"sweeps": sweeps, "beams": BEAMS})
        self.actions, self.blocks, self.over = actions, 0, True
        self.compilations = Compilations()
        event.register("numba:compiler_lock", self.compilations)

    def reset(self, seed: int) -> None:
        """Start the episode of a seed."""
        self.observation, info = self.env.reset(seed=seed)
        self.count, self.over = control_steps(info), False
        self.commands = random_commands(seed)

    def drive(self, steps: int) -> dict[str, Any]:
        """Drive on for at least so many control steps: how many, in how many CPU seconds, and with what result.

        A new episode starts where the last one ended, and after ten blocks. `compiled` is true where a function was
        compiled or loaded on the way.
        """
        if self.over or self.blocks % EPISODE == 0:
            self.reset(self.blocks)
        self.blocks += 1
        self.compilations.noted = False
        first, seconds = self.count, 0.0
        while self.count < first + steps and not self.over:
            action = self._choose()
            start = time.process_time()
            self.observation, _, terminated, truncated, info = self.env.step(action)
            seconds += time.process_time() - start
            self.count, self.over = control_steps(info), terminated or truncated
        digest = hashlib.sha256(b"".join(self.observation[name].tobytes() for name in sorted(self.observation)))
        return {
            "steps": self.count - first,
            "seconds": seconds,
            "compiled": self.compilations.noted,
            "digest": digest.hexdigest(),
        }

    def pin(self, core: int) -> dict[str, Any]:
        """Stay on one core from now on, where the system can do that."""
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {core})
        return {}

    def _choose(self) -> Any:
        if self.actions == "random":
            return next(self.commands)
        return breadth_first(self.observation["goals"], self.env.get_wrapper_attr("action_masks")())


def control_steps(info: dict[str, Any]) -> int:
    """The control steps of the episode so far."""
    return int(info["period"] if "period" in info else info["step"])


def random_commands(seed: int) -> Iterator[Any]:
    """Random velocities, mostly forwards, each held for ten control steps."""
    rng = np.random.default_rng(seed)
    while True:
        command = rng.uniform([0.3, -0.4], [1.0, 0.4]).astype(np.float32)
        for _ in range(10):
            yield command


def breadth_first(goals: Any, mask: Any) -> int:
    """Row of the next goal: the current room first, nearest level first; then other rooms; doors last."""
    rows = [row for row in range(len(goals)) if mask[row] and goals[row, VALID] > 0.5]
    indoors = [row for row in rows if goals[row, KIND] != DOOR]

    def rank(row: int) -> tuple[float, ...]:
        path, level = goals[row, PATH], goals[row, LEVEL]
        if goals[row, KIND] == DOOR:
            return 2.0, level, path
        return (0.0, level, path) if goals[row, ROOM] == goals[indoors[0], ROOM] else (1.0, path, level)

    return min(rows, key=rank, default=0)


def first_start() -> None:
    """What a new user runs first: `two_rooms`, 30 steps with velocities, then one goal, breadth first."""
    env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms")
    env.reset(seed=0)
    commands = random_commands(0)
    for _ in range(STEPS_OF_START):
        env.step(next(commands))
    env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms", actions="goal")
    observation, _ = env.reset(seed=0)
    env.step(breadth_first(observation["goals"], env.get_wrapper_attr("action_masks")()))


def answer_calls(driver: BlockDriver) -> None:
    """Read `[method, arguments...]` per line, answer with the result in one line, until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the tree prints is no answer
    for line in sys.stdin:
        method, *arguments = json.loads(line)
        print(json.dumps(getattr(driver, method)(*arguments)), file=answers, flush=True)


if __name__ == "__main__":
    if Path.cwd() not in Path(mecp_env.__file__).parents:
        sys.exit(f"it imported {mecp_env.__file__}, not the package in {Path.cwd()}")
    if sys.argv[1] == "start":
        first_start()
    else:
        answer_calls(BlockDriver(sys.argv[2], int(sys.argv[3])))
