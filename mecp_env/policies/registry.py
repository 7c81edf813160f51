"""The policies by name. A line here is all that another explorer needs to be evaluated beside the rest."""

from __future__ import annotations

import importlib
from pathlib import Path

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess
from mecp_env.policies.policy import Agent

EXPLORERS = {  # name -> "module:Class", made without arguments
    "bfs": "mecp_env.policies.bfs:BreadthFirstAgent",
    "nearest": "mecp_env.policies.nearest:Nearest",
    "gain": "mecp_env.policies.gain:Gain",
    "random_goal": "mecp_env.policies.random_goal:RandomGoal",
    "random_walk": "mecp_env.policies.random_walk:RandomWalk",
}
LEARNED = ("ppo", "maskable_ppo", "recurrent_ppo")  # what `mecp_env.learning.train` trains
WEIGHTS = Path(__file__).parents[1] / "learning" / "weights"
INSTALL = 'pip install -e ".[rl]" (PyTorch first, see the README)'


def make_agent(name: str, trust: bool = False) -> Agent:
    """The policy of that name, or the trained one in the run folder or, with `trust`, the model file `name`.

    Raises `ConfigError` for an unknown name, with all there are, for a trained policy without PyTorch, and for a model
    file of Stable-Baselines3 that is not trusted: it may run any code while it is loaded.
    """
    if name in EXPLORERS:
        module, _, class_name = EXPLORERS[name].partition(":")
        agent: Agent = getattr(importlib.import_module(module), class_name)()
        return agent
    if name in LEARNED or Path(name).exists():
        return load_learned(name, trust)
    raise ConfigError(unknown_policy(name))


def load_learned(name: str, trust: bool = False) -> Agent:
    """The trained policy of a name, a run folder or a file; only this loads PyTorch."""
    try:
        agent: Agent = importlib.import_module("mecp_env.learning.learned").load(name, trust)
    except ModuleNotFoundError as error:
        raise ConfigError(f"policy: {name!r} is a trained one and needs {error.name}: {INSTALL}") from None
    return agent


def shipped() -> list[str]:
    """The names of the trained policies that come with the repository."""
    return [name for name in LEARNED if (WEIGHTS / name / "policy.json").is_file()]


def policies() -> list[str]:
    """The names that there are: explorers, and the trained policies that come with the repository."""
    return [*EXPLORERS, *shipped()]


def unknown_policy(name: str) -> str:
    """What to say about a name that is none: the nearest one, and all of them."""
    known = policies()
    return f"policy: {name!r:.80} is none of {', '.join(known)}, and no folder of a training run{guess(name, known)}"
