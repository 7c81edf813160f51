"""Shared by the tests of the environment."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import gymnasium
import numpy as np

import mecp_env  # registers the environments
from mecp_env.world.layout import LIBRARY
from mecp_env.wrappers import GoalActions

IDS = tuple(mecp_env.ENVIRONMENTS)
NEEDED: dict[str, dict[str, Any]] = {"mecp_env/FloorPlan-v0": {"plan": str(LIBRARY / "furnished.json")}}  # to be made
SMALL: dict[str, Any] = {"layout": "two_rooms", "laser": {"sweeps": 1, "range_sigma_m": 0.01, "bearing_sigma_deg": 0.0}}


def make(**keywords: Any) -> gymnasium.Env:
    """A small environment, fast enough for tests."""
    return gymnasium.make("mecp_env/Layout-v0", **(SMALL | keywords))


def started(seed: int = 1, **keywords: Any) -> Any:
    """A small environment without wrappers after a reset."""
    env = make(**keywords).unwrapped
    env.reset(seed=seed)
    return env


def below(env: gymnasium.Env) -> gymnasium.Env:
    """The environment that an entry point made, without gymnasium's own wrappers."""
    while not isinstance(env, GoalActions) and env is not env.unwrapped:
        env = env.env
    return env


def episode_of(env: gymnasium.Env) -> Any:
    """The state of the episode, with the pipeline; tests look into an environment here alone."""
    return env.unwrapped._episode


def world_of(env: gymnasium.Env) -> Any:
    """The true world."""
    return env.unwrapped._true_world


def until_over(env: gymnasium.Env, choose: Callable[[Any], Any], observation: Any = None) -> Iterator[Any]:
    """The result of each step up to the end of the episode; `choose` gives the action for an observation."""
    over = False
    while not over:
        row = env.step(choose(observation))
        observation, _, terminated, truncated, _ = row
        over = terminated or truncated
        yield row


def drive(env: gymnasium.Env, steps: int, seed: int = 0) -> list[tuple[Any, ...]]:
    """The results of `steps` steps with fixed random actions; a new episode starts where one ends."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(steps):
        action = np.clip(rng.normal((0.6, 0.0), (0.4, 0.5)), -1, 1).astype(np.float32)
        rows.append(env.step(action))
        if rows[-1][2] or rows[-1][3]:
            rows.append(env.reset())
    return rows


def same(a: Any, b: Any) -> bool:
    """True when two structures are equal to the last bit; nan equals nan."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        if a.dtype == object:
            return b.dtype == object and same(a.tolist(), b.tolist())
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b) or (a != a and b != b)
