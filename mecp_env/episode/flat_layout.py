"""The layout of the format "flat": the name of each number, and where it is squashed to 0.5 (docs/observations.md)."""

from __future__ import annotations

from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess

Column = tuple[str, float]  # name, and h of v / (|v| + h) in SI units; 0 for a number that is within [-1, 1] by itself

SECTORS = 24  # of the ranges
ROWS = {"goal": 32, "velocity": 16, "discrete": 16}  # of goals, by the actions of the environment
NEAR_S = 10.0  # the time at which `near` is 0.5

HEAD: tuple[Column, ...] = (
    ("start_cos", 0.0),
    ("start_sin", 0.0),
    ("start_distance", 10.0),
    ("sigma_ahead", 0.1),
    ("sigma_left", 0.1),
    ("sigma_heading", 0.05),
    ("confidence", 0.0),
    ("localised", 0.0),
    ("recognised", 0.0),
    ("budget", 0.0),
    ("floor", 100.0),
    ("goals", 10.0),
    ("landmarks", 10.0),
)
RANGES: tuple[Column, ...] = tuple((f"range_{360 * k // SECTORS}", 0.0) for k in range(SECTORS))
GOAL: tuple[Column, ...] = (
    ("valid", 0.0),
    ("cos", 0.0),
    ("sin", 0.0),
    ("distance", 5.0),
    ("floor", 5.0),
    ("near", 0.0),
    ("width", 1.0),
    ("visits", 1.0),
    ("kind", 0.0),
)
PREDICTED: tuple[Column, ...] = (("sigma_m", 0.1), ("sigma_rad", 0.05), ("gain", 10.0))


def flat_columns(actions: str, uncertainty: bool) -> tuple[Column, ...]:
    """Name and h of each number of a flat observation, in its order.

    Raises `ConfigError` for unknown actions.
    """
    if actions not in ROWS:
        known = ", ".join(map(repr, ROWS))
        raise ConfigError(f"actions: expected one of {known}, got {actions!r}{guess(actions, ROWS)}")
    goal = (*GOAL, *PREDICTED) if uncertainty else GOAL
    goals = tuple((f"goal_{row}_{name}", half) for row in range(ROWS[actions]) for name, half in goal)
    return (*HEAD, *RANGES, *goals)


def flat_names(env: Any = None, *, actions: str = "velocity", uncertainty: bool = False) -> tuple[str, ...]:
    """The name of each number of a flat observation: see `mecp_env.flat_names`."""
    if env is not None:
        actions, uncertainty = _options_of(env)
    return tuple(name for name, _ in flat_columns(actions, uncertainty))


def _options_of(env: Any) -> tuple[str, bool]:
    config = getattr(getattr(env, "unwrapped", None), "config", None)
    seen = getattr(config, "observation", None)
    if config is None or seen is None:
        raise ConfigError(f"flat_names: env: expected a mecp_env environment, got {env!r:.80}")
    if seen.format != "flat":
        raise ConfigError(f"flat_names: env: expected observation='flat', got {seen.format!r}")
    return config.actions, seen.uncertainty
