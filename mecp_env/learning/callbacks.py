"""Callbacks of Stable-Baselines3: option discounts, statistics, checkpoints, evaluation, and stopping."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy as evaluate_maskable
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from mecp_env.learning import files
from mecp_env.learning.environments import FIGURES, TimedVecEnv, make_validation_env, vectorise
from mecp_env.learning.files import TrainingState
from mecp_env.learning.run_folder import CLOCK, RunFolder, RunLog
from mecp_env.learning.sb3_batch import OptionBuffer, bootstrap_truncated

MOST_WORKERS = 8


class OptionCallback(BaseCallback):
    """Passes the discount of every option to the `OptionBuffer`, and adds the value after a step limit."""

    model: OnPolicyAlgorithm

    def _on_step(self) -> bool:
        infos, rewards = self.locals["infos"], self.locals["rewards"]
        if isinstance(self.model.rollout_buffer, OptionBuffer):
            self.model.rollout_buffer.next_discounts = np.array([info["discount"] for info in infos], np.float32)
            bootstrap_truncated(self.model.policy, rewards, infos)
        return True


class StatisticsCallback(BaseCallback):
    """Counts steps and episodes, and logs the means of the finished episodes; ends the training after `stop`."""

    model: OnPolicyAlgorithm

    def __init__(self, state: TrainingState, log: RunLog, timed: TimedVecEnv) -> None:
        super().__init__()
        self.state, self.log, self.timed = state, log, timed
        self.stop = False
        self.paused_s = 0.0

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Evaluation and checkpoints, which are no part of the training time."""
        start = time.perf_counter()
        yield
        self.paused_s += time.perf_counter() - start

    def clock(self) -> dict[str, float]:
        """How far the run has come."""
        return self.state.model_dump(include=set(CLOCK))

    def _on_training_start(self) -> None:
        self._start_clock()

    def _start_clock(self) -> None:
        self.start_s, self.paused_s = time.perf_counter(), 0.0
        self.before = self.timed.waited_s, self.timed.periods

    def _on_step(self) -> bool:
        state, infos = self.state, self.locals["infos"]
        state.periods += int(sum(info["periods"] for info in infos))
        for info in infos:
            state.episodes += "figures" in info
            for name, value in info.get("figures", {}).items():
                self.logger.record_mean(f"rollout/{name}", value)
        state.decisions = self.num_timesteps
        self.log.advance(state.decisions)
        return not self.stop

    def _on_rollout_end(self) -> None:
        seconds = time.perf_counter() - self.start_s - self.paused_s
        waited_s, periods = self.timed.waited_s - self.before[0], self.timed.periods - self.before[1]
        self._start_clock()
        self.state.seconds += seconds
        self.state.updates += 1
        speed = {"periods_per_s": periods / seconds, "waiting_share": waited_s / seconds}
        for name, value in (self.clock() | speed).items():
            self.logger.record(f"time/{name}", value)
        area = self.logger.name_to_value.get("rollout/auc")
        text = f"{speed['periods_per_s']:,.0f} steps/s, waiting {speed['waiting_share']:.0%}"
        self.log.advance(self.state.decisions, text if area is None else f"area {area:.3f}, {text}")


class SafeCheckpointCallback(BaseCallback):
    """Writes a checkpoint between two updates when the last one is `log.checkpoint_s` old, and at the end."""

    model: OnPolicyAlgorithm

    def __init__(self, folder: RunFolder, venv: VecNormalize, statistics: StatisticsCallback) -> None:
        super().__init__()
        self.folder, self.venv, self.statistics = folder, venv, statistics
        self.saved_s = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if time.perf_counter() - self.saved_s >= self.folder.config.log.checkpoint_s:
            self.save()

    def _on_training_end(self) -> None:
        self.save()

    def save(self) -> None:
        """Write a checkpoint. Raises `NotFiniteError`."""
        state, returns = self.statistics.state, self.venv.ret_rms
        state.return_mean, state.return_var = float(returns.mean), float(returns.var)
        state.return_count = float(returns.count)
        with self.statistics.paused():
            self.folder.checkpoints.save(self.model, state)
            if not self.folder.config.log.evaluate_buildings:
                self.folder.keep_policy(self.model, state)
        self.saved_s = time.perf_counter()


class EvaluationCallback(BaseCallback):
    """Evaluates on the validation split every `log.evaluate_every` decisions; keeps the best policy."""

    model: OnPolicyAlgorithm

    def __init__(self, folder: RunFolder, log: RunLog, statistics: StatisticsCallback) -> None:
        super().__init__()
        self.folder, self.log, self.statistics = folder, log, statistics
        self.venv: VecEnv | None = None  # made when it is first needed

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        files.check_finite(self.model.policy)
        state = self.statistics.state
        if not self.statistics.stop and state.decisions >= state.next_evaluation:
            self.evaluate()

    def _on_training_end(self) -> None:
        files.check_finite(self.model.policy)
        if not self.statistics.stop and self.statistics.state.evaluated != self.statistics.state.decisions:
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the policy; the best one so far is the one that is loaded from the folder."""
        state, options = self.statistics.state, self.folder.config.log
        state.next_evaluation, state.evaluated = state.decisions + options.evaluate_every, state.decisions
        if not options.evaluate_buildings:
            return
        with self.statistics.paused():
            figures = self.figures()
            score = figures[self.folder.config.score]
            best = score > state.best_score
            self.log.add_evaluation(self.statistics.clock(), figures, best)
            if best:
                state.best_score = score
                self.folder.keep_policy(self.model, state, validation=figures)

    def figures(self) -> dict[str, float]:
        """The mean of each metric over the buildings, one episode in each, and their number `n`.

        The policy takes its most probable action; building and seed of each episode are always the same.
        """
        found: list[dict[str, float]] = []

        def collect(scope: dict[str, Any], _: dict[str, Any]) -> None:
            if scope["done"]:
                found.append(scope["info"]["figures"])

        evaluate: Any = evaluate_maskable if isinstance(self.model, MaskablePPO) else evaluate_policy
        count = self.folder.config.log.evaluate_buildings
        evaluate(self.model, self._rewound(), count, callback=collect, warn=False)
        return mean_of(found)

    def _rewound(self) -> VecEnv:
        config = self.folder.config
        if self.venv is None:  # environment i runs as many episodes as `evaluate_policy` expects of it
            buildings = config.log.evaluate_buildings
            workers = min(buildings, MOST_WORKERS, config.environments)
            parts = [range(workers - 1 - i, buildings, workers) for i in range(workers)]
            makers = [partial(make_validation_env, config, i, part) for i, part in enumerate(parts)]
            self.venv = vectorise(makers, config.workers)
        elif config.buildings.layout is None:
            self.venv.env_method("rewind")
        if config.buildings.layout is not None:
            self.venv.seed(0)
        return self.venv

    def close(self) -> None:
        """End the workers."""
        if self.venv is not None:
            self.venv.close()


def mean_of(episodes: list[dict[str, float]]) -> dict[str, float]:
    """The means of the metrics of some episodes, the standard error of the area under the curve, and `n`."""
    means = {name: float(np.mean([episode[name] for episode in episodes])) for name in FIGURES}
    spread = float(np.std([episode["auc"] for episode in episodes])) / max(1, len(episodes) - 1) ** 0.5
    return means | {"auc_error": spread, "n": len(episodes)}
