"""Vector environments: control steps per second of 16 environments in every vector class, against a single one.

All kinds run in the same process in turns of a few seconds, with another kind first in every round; a ratio is taken
within a round, so that other load affects both. CPU time is that of all processes of a kind together. Memory (Pss) is
that of a new process that drives only this kind, and of its workers, after an episode of each environment. `batch` has
its default number of workers: one per core, two per core with goals. With `send, recv` the eight environments that are
finished first get their next actions while the others are under way. `small` is `velocity` with an observation without
the grid, 5 of 79 kB, and shows the cost of transport.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from gymnasium.wrappers import FilterObservation

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.common import Figures, Gate, Options, estimate, in_turns, is_installed
from benchmarks.process_use import memory_mb, processor_s
from benchmarks.tables import sections, whole_rows
from mecp_env.core.processes import cores
from mecp_env.vector import BatchEnv

NAME, COUNT = "mecp_env/PaperMap-v0", 16
SETTINGS: dict[str, dict[str, Any]] = {"velocity": {}, "goal": {"actions": "goal"}, "small": {"small": True}}
EPISODE = 300  # steps; a larger map costs more, and the single environment would otherwise have the largest
HELD = 10  # steps for which a velocity is held
SMALL = ("pose", "pose_cov", "landmarks", "goals")
SINGLE, ASYNC, BATCH, SEND_RECV, SUBPROC = "single", "async", "batch", "batch, send, recv", "subproc"

GATES = tuple(
    Gate(f"velocity/{kind}/{ratio}", "share", 0.25)
    for kind in (BATCH, SEND_RECV)
    for ratio in ("over_single", "over_async")
)


def run(options: Options) -> Figures:
    """All results; 12 rounds of 3 s per kind and setting (--quick: 3 of 0.5 s)."""
    rounds, seconds = (3, 0.5) if options.quick else (12, 3.0)
    return {name: compare(setting, rounds, seconds) for name, setting in SETTINGS.items()}


def compare(setting: dict[str, Any], rounds: int, seconds: float, kinds: tuple[str, ...] = ()) -> Figures:
    """Results of each kind in a setting."""
    names = list(kinds or (kind for kind in MAKERS if kind != SUBPROC or is_installed("stable_baselines3")))
    memory = {name: memory_alone(name, setting, EPISODE) for name in names}
    drivers = {name: Driver(name, setting) for name in names}
    try:
        for driver in drivers.values():
            driver.measure(seconds)  # loads compiled functions and fills caches
        measured = in_turns({name: partial(driver.measure, seconds) for name, driver in drivers.items()}, rounds)
    finally:
        for driver in drivers.values():
            driver.close()
    return {name: figures(name, measured, memory[name]) for name in names}


def figures(name: str, measured: list[dict[str, tuple[float, float]]], memory_mb: float) -> Figures:
    """Speed, ratios and cost of a kind over the rounds."""
    rates = np.array([turn[name][0] for turn in measured])
    return {
        "periods_per_s": estimate(rates),
        **{f"over_{other}": estimate(rates / [turn[other][0] for turn in measured]) for other in (SINGLE, ASYNC)},
        "processor_us": estimate([turn[name][1] for turn in measured]),
        "memory_mb": memory_mb,
    }


def memory_alone(kind: str, setting: dict[str, Any], steps: int) -> float:
    """Memory (MB) of a kind after so many control steps of each environment, in a process that drives nothing else."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(_memory_here, kind, setting, steps).result()


def _memory_here(kind: str, setting: dict[str, Any], steps: int) -> float:
    driver, driven = Driver(kind, setting), 0
    while driven < steps * driver.count:
        driven += driver.step()
    used = memory_mb(driver.pids())
    driver.close()
    return used


def make_env(setting: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    """One environment of a setting."""
    keywords = {name: value for name, value in setting.items() if name != "small"}
    env = gymnasium.make(NAME, disable_env_checker=True, max_steps=EPISODE, **keywords)
    return FilterObservation(env, SMALL) if "small" in setting else env


def make_subproc(makers: list[Callable[[], Any]]) -> Any:
    """The class of Stable-Baselines3; forked where possible, because other workers would import PyTorch first."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    return SubprocVecEnv(makers, start_method="fork" if "fork" in multiprocessing.get_all_start_methods() else None)


class Alone:
    """A single environment, stepped directly, with rows of one for the driver."""

    def __init__(self, makers: list[Callable[[], Any]]) -> None:
        self.env = makers[0]()

    def reset(self, seed: int | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """The first observation and info of an episode."""
        observation, info = self.env.reset(seed=seed)
        return {name: part[None] for name, part in observation.items()}, info

    def step(self, actions: Any) -> tuple[Any, ...]:
        """A step, and a new episode where one ends."""
        observation, reward, terminated, truncated, info = self.env.step(actions[0])
        rows = {name: part[None] for name, part in observation.items()}
        if terminated or truncated:
            rows, _ = self.reset()
        return rows, [reward], [terminated], [truncated], (info,)

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


class SendRecv:
    """A batch whose actions and results are those of the environments that are finished first, half of them at a time.

    An environment whose results were received is sent its next action; a step is one such exchange.
    """

    def __init__(self, makers: list[Callable[[], Any]]) -> None:
        self.batch = BatchEnv(makers, batch_size=max(1, len(makers) // 2))

    def reset(self, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """The first observations that are ready, and their infos."""
        self.batch.async_reset(seed=seed)
        observation, *_, infos = self.batch.recv()
        self.ids = infos["env_id"]
        return observation, infos

    def step(self, actions: Any) -> tuple[Any, ...]:
        """The results that are ready, after the actions for the last ones were sent."""
        self.batch.send(actions, self.ids)
        row = self.batch.recv()
        self.ids = row[-1]["env_id"]
        return row

    def close(self) -> None:
        """Stop the workers."""
        self.batch.close()


MAKERS: dict[str, Callable[[list[Callable[[], Any]]], Any]] = {
    SINGLE: Alone,
    "sync": SyncVectorEnv,
    ASYNC: AsyncVectorEnv,
    BATCH: BatchEnv,
    SEND_RECV: SendRecv,
    "batch, 4 a core": lambda makers: BatchEnv(makers, workers=4 * cores()),
    SUBPROC: make_subproc,
}


class Driver:
    """Environments of one kind and their random actions, the same for each kind."""

    def __init__(self, kind: str, setting: dict[str, Any]) -> None:
        self.venv = MAKERS[kind]([partial(make_env, setting)] * COUNT)
        self.goals = setting.get("actions") == "goal"
        self.rng = np.random.default_rng(0)
        self.count = 1 if kind == SINGLE else COUNT
        self.steps = 0  # of all environments together
        if kind == SUBPROC:
            self.venv.seed(0)
            self.observation = self.venv.reset()
        else:
            self.observation = self.venv.reset(seed=0)[0]

    def measure(self, seconds: float) -> tuple[float, float]:
        """Control steps per second, and microseconds of CPU time per step, over at least this time."""
        start, spent, steps = time.perf_counter(), processor_s(self.pids()), 0
        while time.perf_counter() < start + seconds:
            steps += self.step()
        return steps / (time.perf_counter() - start), 1e6 * (processor_s(self.pids()) - spent) / steps

    def step(self) -> int:
        """One step of all environments: the total number of control steps."""
        row = self.venv.step(self.choose())
        self.observation, infos, self.steps = row[0], row[-1], self.steps + len(row[1])
        if isinstance(infos, tuple):
            return sum(info["periods"] for info in infos) if self.goals else len(infos)
        return int(infos["periods"].sum() if self.goals else (infos["period"] > 0).sum())  # without resets

    def choose(self) -> Any:
        """A goal per observation, or velocities that are held for several steps."""
        if self.goals:
            masks = self.observation["goals"][:, :, 8] == 1.0
            return np.array([self.rng.choice(np.flatnonzero(mask)) if mask.any() else 0 for mask in masks])
        if self.steps % (HELD * self.count) == 0:
            self.held = self.rng.uniform([0.3, -0.4], [1.0, 0.4], (self.count, 2)).astype(np.float32)
        return self.held[getattr(self.venv, "ids", slice(None))]

    def pids(self) -> list[int]:
        """All running processes: this one and its workers."""
        batch = getattr(self.venv, "batch", self.venv)
        if isinstance(batch, BatchEnv):
            return [os.getpid(), *batch.pids]
        return [os.getpid(), *(process.pid for process in getattr(batch, "processes", ()))]

    def close(self) -> None:
        """Stop the workers."""
        self.venv.close()


def report(figures: Figures) -> str:
    """One table per setting with one row per kind."""
    heads = ["kind", "steps per second", "over a single one", "over async", "CPU us per step", "memory MB"]
    return sections({setting: whole_rows(heads, kinds) for setting, kinds in figures.items()})
