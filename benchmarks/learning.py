"""Training: control steps per second including learning, with 16 environments, against one environment without it.

In each round a single environment of the training is driven with random actions for a few seconds, then a training of
some updates is started, whose first update is not counted; a ratio is taken within a round, so that other load affects
both. `waiting` is the share of the time in which the learner waits for the environments.
"""

from __future__ import annotations

import csv
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Figures, Options, estimate, steps_per_s
from benchmarks.random_actions import RandomDriver, goal, velocity

ALGORITHMS = {"maskable_ppo": goal, "ppo": velocity}  # and the actions of the single environment
LOG = {"evaluate_buildings": 0, "tensorboard": False, "checkpoint_s": 86_400.0}  # no evaluations, no checkpoints


def run(options: Options) -> Figures:
    """All results; 6 rounds of 5 s and 4 updates (--quick: 2 of 1 s and 2 updates)."""
    rounds, seconds, updates = (2, 1.0, 2) if options.quick else (6, 5.0, 4)
    return {name: compare(name, rounds, seconds, updates) for name in ALGORITHMS}


def compare(algorithm: str, rounds: int, seconds: float, updates: int, **fields: Any) -> Figures:
    """Speed of an algorithm over the rounds; `fields` of the configuration."""
    from mecp_env.learning.config import TrainConfig
    from mecp_env.learning.environments import make_env

    config = TrainConfig.build({"algorithm": algorithm, "log": LOG} | fields)
    config = config.model_copy(update={"steps": config.ppo.steps * config.environments * updates})
    single = RandomDriver(make_env(config), ALGORITHMS[algorithm])
    steps_per_s(single.step, seconds)  # loads compiled functions and fills caches
    measured = [(steps_per_s(single.step, seconds), *train(config, updates)) for _ in range(rounds)]
    alone, rates, waiting = np.array(measured).T
    return {
        "steps_per_s": estimate(rates),
        "single_per_s": estimate(alone),
        "over_single": estimate(rates / alone),
        "waiting": estimate(waiting),
    }


def train(config: Any, updates: int) -> tuple[float, float]:
    """Control steps per second and share of waiting of a training, means of its updates but the first."""
    from mecp_env.learning.train import train as run_training

    with tempfile.TemporaryDirectory() as folder:
        run_training(config, Path(folder) / "run")
        with (Path(folder) / "run" / "progress.csv").open() as lines:
            rows = list(csv.DictReader(lines))[1:updates]
    rate, waiting = (float(np.mean([float(row[name]) for row in rows])) for name in ("periods_per_s", "waiting_share"))
    return rate, waiting
