"""Write the list of functions that are compiled ahead: `python -m mecp_env.cli.record_signatures`.

The exploration runs twice, in two processes: only one that finds everything in the cache asks it for a function when
Python calls that, and not when a compiled function does.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

from mecp_env.core.jit_cache import _FunctionCache, within_another_compilation
from mecp_env.core.warm_up_list import LIST, Entry, encode
from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.wrappers import GoalActions

EXERCISE = "from mecp_env.cli.record_signatures import exercise; exercise()"


def record() -> list[Entry]:
    """The functions that an exploration calls from Python, with their types, in the order of their first call."""
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
    """Explore the layout `paper`, which calls all that an episode calls."""
    env, policy = MecpEnv(layout="paper"), BreadthFirst()
    goals = GoalActions(env)
    observation, _ = goals.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = goals.step(policy.act(observation, goals.action_masks()))
        over = terminated or truncated
    env.summary()


def main() -> None:
    """Fill the cache, then record."""
    subprocess.run([sys.executable, "-c", EXERCISE], check=True)
    lines = ",\n".join(json.dumps(entry) for entry in record())
    LIST.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
