"""Shared by the tests of vector environments."""

from typing import Any

import gymnasium
import numpy as np

from mecp_env.vector import BatchEnv, make_batch
from tests.env.helpers import SMALL

LAYOUT, ROOMS = "mecp_env/Layout-v0", "mecp_env/Rooms-v0"
N = 3
PEOPLE: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 2, "closed_doors": 0.3}}


def make_small(count: int = N, **keywords: Any) -> BatchEnv:
    """A batch of small environments, forked, with two workers by default; it closes itself when a test is over."""
    return make_batch(LAYOUT, count, **({"context": "fork", "workers": 2} | SMALL | keywords))


def started(count: int = N, **keywords: Any) -> BatchEnv:
    """The same after a reset."""
    venv = make_small(count, **keywords)
    venv.reset(seed=1)
    return venv


def choose(space: gymnasium.Space[Any], observation: Any, rng: np.random.Generator) -> Any:
    """Actions (N,...) for a batch of observations: mostly forward, any choice, or any goal."""
    count = len(observation["pose"] if isinstance(observation, dict) else observation)
    if isinstance(space, gymnasium.spaces.Box):
        return np.clip(rng.normal((0.6, 0.0), (0.4, 0.5), (count, 2)), -1, 1).astype(np.float32)
    if space.n == 5:
        return rng.integers(0, 5, count)
    return np.array([int(rng.integers(max(1, int(goals[:, 8].sum())))) for goals in observation["goals"]])
