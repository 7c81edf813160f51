"""Write the list of kernels that helpers compile ahead (warm_up.py): `python -m mecp_env.cli.record_signatures`.

The exploration runs twice, in two processes: only one that finds everything in the cache tells the kernels that are
called from Python from those that kernels call.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from typing import Any

from mecp_env.core.jit_cache import _KernelCache
from mecp_env.core.warm_up import LIST, Entry, encode
from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.wrappers import GoalActions


def record() -> list[Entry]:
    """The kernels that an exploration calls from Python, with their types, in the order of their first call."""
    found: dict[str, Entry] = {}
    owner: Any = _KernelCache
    load = owner.load_overload

    def load_and_note(cache: Any, sig: Any, context: Any) -> Any:
        function = cache._function
        with contextlib.suppress(ValueError):
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
    subprocess.run(
        [sys.executable, "-c", "from mecp_env.cli.record_signatures import exercise; exercise()"], check=True
    )
    lines = ",\n".join(json.dumps(entry) for entry in record())
    LIST.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
