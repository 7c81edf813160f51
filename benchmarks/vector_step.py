"""Steps per second as Gymnasium measures them: `benchmark_step` of one environment, `benchmark_vector_step` of batches.

Both functions are those of `gymnasium.utils.performance`: random actions of `action_space.sample()`, and steps of all
environments together. All kinds run in turns, with another one first in every round; a ratio is taken within a round,
so that other load affects both. A batch has its default workers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from functools import partial
from typing import Any

import gymnasium
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.common import Figures, Options, estimate, in_rounds
from mecp_env.core.carriers import Array

NAME = "mecp_env/PaperMap-v0"
COUNTS = (1, 2, 4, 16)
SINGLE = "gymnasium.make"
SETTINGS: dict[str, dict[str, Any]] = {"velocity": {}, "goal": {"actions": "goal"}}
SEED = 0


def run(options: Options) -> Figures:
    """All results; 12 rounds of 3 s per kind and setting (--quick: 3 of 0.5 s)."""
    rounds, seconds = (3, 0.5) if options.quick else (12, 3.0)
    return {name: compare(keywords, rounds, seconds) for name, keywords in SETTINGS.items()}


def compare(keywords: dict[str, Any], rounds: int, seconds: float, counts: tuple[int, ...] = COUNTS) -> Figures:
    """Results of a single environment and of a batch of each count."""
    makers = {f"batch of {count}": partial(gymnasium.make_vec, NAME, count, **keywords) for count in counts}
    rates = rates_in_turns({SINGLE: partial(gymnasium.make, NAME, **keywords), **makers}, rounds, seconds, steps_per_s)
    return {
        name: {"steps_per_s": estimate(rate), "over_single": estimate(rate / rates[SINGLE])}
        for name, rate in rates.items()
    }


def rates_in_turns(
    makers: Mapping[str, Callable[[], Any]], rounds: int, seconds: float, measure: Callable[..., Any]
) -> dict[str, Array]:
    """(rounds,...) steps per second of each kind, or what else is measured of an environment."""
    with ExitStack() as opened:
        envs = {name: opened.enter_context(closing(make())) for name, make in makers.items()}
        return in_rounds({name: partial(measure, env, seconds) for name, env in envs.items()}, rounds)


def steps_per_s(env: Any, seconds: float) -> float:
    """Gymnasium's figure of an environment or batch."""
    is_batch = isinstance(env, gymnasium.vector.VectorEnv)
    return float((benchmark_vector_step if is_batch else benchmark_step)(env, seconds, SEED))
