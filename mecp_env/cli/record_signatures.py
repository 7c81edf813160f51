"""Write the list of functions that are compiled ahead: `python -m mecp_env.cli.record_signatures`.

The episodes run twice, in two processes: only one that finds everything in the cache asks it for a function when Python
calls that, and not when a compiled function does.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from mecp_env.core.jit_cache import _FunctionCache, within_another_compilation
from mecp_env.core.warm_up_list import LIST, Entry, encode
from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.registration import make_rooms
from mecp_env.wrappers import GoalActions

ROOMS: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 4}, "max_steps": 200}
EPISODES = 40  # of random goals, and of random velocities
HELD = 10  # steps for which a velocity is held

EXERCISE = "from mecp_env.cli.record_signatures import exercise; exercise()"


def record() -> list[Entry]:
    """The functions that `exercise` calls from Python, with their types, in the order of their first call."""
    found: dict[str, Entry] = {}
    owner: Any = _FunctionCache
    load = owner.load_overload

    def load_and_note(cache: Any, sig: Any, context: Any) -> Any:
        function = cache._function
        if not within_another_compilation(sys._getframe(1)):
            entry = [function.__module__, function.__name__, [encode(argument) for argument in sig]]
            found.setdefault(json.dumps(entry), entry)
        return load(cache, sig, context)

    owner.load_overload = load_and_note
    try:
        exercise()
    finally:
        owner.load_overload = load
    return list(found.values())


def exercise() -> None:
    """Explore the layout `paper`, then drive at random in generated buildings, for what few episodes call."""
    explore()
    rng = np.random.default_rng(0)
    goals: Any = make_rooms(actions="goal", **ROOMS)
    velocities = make_rooms(**ROOMS)
    for seed in range(EPISODES):
        drive(goals, seed, lambda: rng.choice(np.append(np.flatnonzero(goals.action_masks()), 0)), 1)
        drive(velocities, seed, lambda: rng.uniform([0.3, -0.4], [1.0, 0.4]).astype(np.float32), HELD)


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


def drive(env: Any, seed: int, choose: Callable[[], Any], held: int) -> None:
    """One episode with actions that are held for so many steps."""
    env.reset(seed=seed)
    action = choose()
    for step in itertools.count(1):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return
        action = action if step % held else choose()


def main() -> None:
    """Fill the cache, then record."""
    subprocess.run([sys.executable, "-c", EXERCISE], check=True)
    lines = ",\n".join(json.dumps(entry) for entry in record())
    LIST.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
