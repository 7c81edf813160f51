"""Steps per second as Gymnasium measures them: `benchmark_step` of one environment, `benchmark_vector_step` of batches.

Both functions are those of `gymnasium.utils.performance`: random actions of `action_space.sample()`, and steps of all
environments together. All kinds run in turns, with another one first in every round; a ratio is taken within a round,
so that other load affects both. A batch has its default workers.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.common import Figures, Gate, Options, estimate, in_turns
from benchmarks.tables import sections, whole_rows

NAME = "mecp_env/PaperMap-v0"
COUNTS = (1, 2, 4, 16)
SINGLE = "gymnasium.make"
SETTINGS: dict[str, dict[str, Any]] = {"velocity": {}, "goal": {"actions": "goal"}}
SEED = 0
GATES = tuple(Gate(f"velocity/batch of {count}/over_single", "share", 0.25) for count in COUNTS)

Measure = Callable[[], float]


def run(options: Options) -> Figures:
    """All results; 12 rounds of 3 s per kind and setting (--quick: 3 of 0.5 s)."""
    rounds, seconds = (3, 0.5) if options.quick else (12, 3.0)
    return {name: compare(keywords, rounds, seconds) for name, keywords in SETTINGS.items()}


def compare(keywords: dict[str, Any], rounds: int, seconds: float, counts: tuple[int, ...] = COUNTS) -> Figures:
    """Results of a single environment and of a batch of each count."""
    with ExitStack() as opened:
        single = opened.enter_context(closing(gymnasium.make(NAME, **keywords)))
        kinds: dict[str, Measure] = {SINGLE: partial(benchmark_step, single, seconds, SEED)}  # type: ignore[arg-type]
        for count in counts:
            batch = opened.enter_context(closing(gymnasium.make_vec(NAME, count, **keywords)))
            kinds[f"batch of {count}"] = partial(benchmark_vector_step, batch, seconds, SEED)  # type: ignore[arg-type]
        measured = in_turns(kinds, rounds + 1)[1:]  # the first loads compiled functions
    return {name: figures(name, measured) for name in kinds}


def figures(name: str, measured: list[dict[str, float]]) -> Figures:
    """Speed of a kind, and its ratio to a single environment."""
    rates = np.array([turn[name] for turn in measured])
    return {"steps_per_s": estimate(rates), "over_single": estimate(rates / [turn[SINGLE] for turn in measured])}


def report(figures: Figures) -> str:
    """One table per setting with one row per kind."""
    heads = ["kind", "steps per second", "over a single one"]
    return sections({setting: whole_rows(heads, kinds) for setting, kinds in figures.items()})
