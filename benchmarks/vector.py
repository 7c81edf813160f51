"""Vector environments: control steps per second of 16 environments in every vector class, against a single one.

All kinds run in the same process in turns of a few seconds, with another kind first in every round; a ratio is taken
within a round, so that other load affects both. CPU time is that of all processes of a kind together. Memory (Pss) is
that of a new process that drives only this kind, and of its workers, after an episode of each environment. `batch` has
its default number of workers: one per core, two per core with goals. With `send, recv` the eight environments that are
finished first get their next actions while the others are under way.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.common import Figures, Options, estimate
from benchmarks.process_use import memory_mb, processor_s
from benchmarks.vector_step import NAME, SETTINGS, rates_in_turns, steps_per_s
from mecp_env.vector import BatchEnv

COUNT = 16
EPISODE = 300  # steps; a larger map costs more, and the single environment would otherwise have the largest
MEMORY_S = 20.0  # an episode of each environment
SINGLE, ASYNC = "single", "async"


class SendRecv(VectorEnv[Any, Any, Any]):
    """A batch of which half are stepped at a time: a step sends the actions of those received, and receives others."""

    def __init__(self, makers: list[Callable[[], Any]]) -> None:
        self.num_envs, self.metadata = max(1, len(makers) // 2), {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.batch = BatchEnv(makers, batch_size=self.num_envs)
        self.action_space, self.pids = batch_space(self.batch.single_action_space, self.num_envs), self.batch.pids
        self.ids = None

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """The first observations that are ready; those of an earlier drive go on."""
        if self.ids is None:
            self.batch.async_reset(seed=seed)
            observation, *_, infos = self.batch.recv()
            self.ids = infos["env_id"]
            return observation, infos
        return {}, {}

    def step(self, actions: Any) -> tuple[Any, ...]:
        """The results that are ready, after the actions for the last ones were sent."""
        self.batch.send(actions, self.ids)
        row = self.batch.recv()
        self.ids = row[-1]["env_id"]
        return row

    def close_extras(self, **_: Any) -> None:
        """Stop the workers."""
        self.batch.close()


KINDS: dict[str, Callable[[list[Callable[[], Any]]], Any]] = {
    SINGLE: lambda makers: makers[0](),
    "sync": SyncVectorEnv,
    ASYNC: AsyncVectorEnv,
    "batch": BatchEnv,
    "batch, send, recv": SendRecv,
}


def run(options: Options) -> Figures:
    """All results; 12 rounds of 3 s per kind and setting (--quick: 3 of 0.5 s)."""
    rounds, seconds = (3, 0.5) if options.quick else (12, 3.0)
    return {name: compare(keywords, rounds, seconds) for name, keywords in SETTINGS.items()}


def compare(keywords: dict[str, Any], rounds: int, seconds: float) -> Figures:
    """Results of each kind in a setting."""
    found = rates_in_turns({kind: partial(make, kind, keywords) for kind in KINDS}, rounds, seconds, measure)
    rates = {kind: of[:, 0] for kind, of in found.items()}
    return {
        kind: {
            "periods_per_s": estimate(rates[kind]),
            **{f"over_{other}": estimate(rates[kind] / rates[other]) for other in (SINGLE, ASYNC)},
            "processor_us": estimate(of[:, 1]),
            "memory_mb": memory_alone(kind, keywords),
        }
        for kind, of in found.items()
    }


def make(kind: str, keywords: dict[str, Any]) -> Any:
    """The environments of a kind."""
    return KINDS[kind]([partial(gymnasium.make, NAME, disable_env_checker=True, max_steps=EPISODE, **keywords)] * COUNT)


def measure(env: Any, seconds: float) -> tuple[float, float]:
    """Steps per second, and microseconds of CPU time per step."""
    spent = processor_s(pids_of(env))
    rate = steps_per_s(env, seconds)
    return rate, 1e6 * (processor_s(pids_of(env)) - spent) / (rate * seconds)


def pids_of(env: Any) -> list[int]:
    """All running processes: this one and the workers of an environment."""
    workers = [process.pid for process in getattr(env, "processes", ())]
    return [os.getpid(), *workers, *getattr(env, "pids", ())]


def memory_alone(kind: str, keywords: dict[str, Any], seconds: float = MEMORY_S) -> float:
    """Memory (MB) of a kind that is driven for some time, in a process that drives nothing else."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(_memory_here, kind, keywords, seconds).result()


def _memory_here(kind: str, keywords: dict[str, Any], seconds: float) -> float:
    env = make(kind, keywords)
    steps_per_s(env, seconds)
    used = memory_mb(pids_of(env))
    env.close()
    return used
