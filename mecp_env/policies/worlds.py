"""The environment of an evaluation, and how an agent is let into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.policies.policy import Agent
from mecp_env.wrappers import GoalActions

Info = dict[str, Any]
Look = Callable[[dict[str, Any], Info], None]
Env = gym.Env[Any, Any]


@dataclass(frozen=True, slots=True)
class Setting:
    """Where the policies are compared; the same for all of them."""

    difficulty: str = "medium"
    split: str = "test"
    estimator: str = "slam"
    max_steps: int = 3000


def rooms(setting: Setting, agent: Agent, render_mode: str | None = None) -> Env:
    """The generated buildings of a setting, started anywhere. Raises `ConfigError`."""
    return gym.make(
        "mecp_env/Rooms-v0",
        render_mode=render_mode,
        disable_env_checker=True,
        difficulty=setting.difficulty,
        split=setting.split,
        estimator=setting.estimator,
        max_steps=setting.max_steps,
        start="random",
        actions=below(agent),
        **getattr(agent, "settings", {}),
    )


def below(agent: Agent) -> str:
    """The action mode below the wrapper `GoalActions`, which `admit` puts on."""
    return "velocity" if agent.actions == "goal" else agent.actions


def admit(env: Env, agent: Agent, look: Look) -> Env:
    """`env` with the actions that the agent wants; `look` is called with observation and info of every step."""
    if agent.actions == "goal":
        return GoalActions(env, callback=lambda step: look(step[0], step[4]))
    return Watched(env, look)


class Watched(gym.Wrapper[Any, Any, Any, Any]):
    """Shows every step to a spectator, as the callback of `GoalActions` does."""

    def __init__(self, env: Env, look: Look) -> None:
        super().__init__(env)
        self.look = look

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, Info]:
        """The step of the environment below."""
        step = super().step(action)
        self.look(step[0], step[4])
        return step


def masks(env: Env) -> Any:
    """The mask of the goals; None where the actions are no goals."""
    return env.action_masks() if isinstance(env, GoalActions) else None
