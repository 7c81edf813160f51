"""Soak: a million control steps of a vector environment, and of a single one, over many episodes and buildings.

`vector` is 16 environments of `make_vec` with random velocities, `single` one with random goals, both in generated
buildings with pedestrians and boxes. After a tenth of the steps to warm up, and two episodes of each environment,
memory (Pss without the files of libraries, which other programs share), open files, shared memory and CPU time of all
processes are taken for a hundred slices of the run; memory is the mean over each slice, because it grows and falls with
every episode, and 16 episodes that are cut off at the same length end together. The run fails when memory grows by more
than 5 MB from the first tenth of these to the last (means), when files or segments are more in the last tenth than at
any time in the first, when an observation is not finite or outside its space, when no episode ended, when a step costs
more than 1.1 times the CPU time at the end (lower end of the interval), or when closing leaves a process, file or
segment behind.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium
import numpy as np

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.common import Figures, Options, chosen, in_parallel, ratio
from benchmarks.process_use import OWN, memory_mb, open_files, processor_s, shared_segments
from benchmarks.random_actions import RandomDriver, goal
from benchmarks.tables import columns_of

NAME, COUNT = "mecp_env/Rooms-v0", 16
SETTING: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 2}, "max_steps": 200}
SETS = {"vector": 1_000_000, "single": 1_000_000}  # control steps
QUICK = {"vector": 16_000, "single": 4_000}
MOST = 1_000_000_000
SLICES, TENTH, HELD = 100, 10, 10
SAMPLES = 10  # of memory, in a slice
BOUNDS = {
    "growth_mb": 5.0,
    **dict.fromkeys(("more_files", "more_segments", "wrong_observations", "left_behind"), 0.0),
    "processor_time_last_over_first": 1.1,
}


@dataclass(slots=True)
class Soak:
    """What was watched."""

    slices: list[dict[str, float]] = field(default_factory=list)  # control steps, seconds, memory ... of each
    wrong: int = 0  # observations that are not finite or outside their space
    left_behind: int = 0  # workers, files and segments after closing


class Many:
    """A vector environment and random velocities, each held for several steps."""

    def __init__(self) -> None:
        self.env: Any = gymnasium.make_vec(NAME, num_envs=COUNT, **SETTING)
        self.observation, _ = self.env.reset(seed=0)
        self.rng, self.calls, self.episodes = np.random.default_rng(0), 0, 0

    def step(self) -> int:
        """One step of all environments: control steps."""
        if self.calls % HELD == 0:
            self.held = self.rng.uniform([0.3, -0.4], [1.0, 0.4], (COUNT, 2)).astype(np.float32)
        self.calls += 1
        self.observation, _, terminated, truncated, infos = self.env.step(self.held)
        self.episodes += int((terminated | truncated).sum())
        return int((infos["period"] > 0).sum())


def driver_of(kind: str) -> Any:
    """The driver of a vector environment, or of a single one with random goals."""
    return Many() if kind == "vector" else RandomDriver(gymnasium.make(NAME, actions="goal", **SETTING), goal)


def run(options: Options) -> Figures:
    """The figures of each set; one after the other, each kept when it is finished."""
    counts = chosen(options, SETS, QUICK, MOST)
    soaks = in_parallel(soak, Soak, list(counts.items()), replace(options, jobs=1))
    return {name: summarise(result) for name, result in zip(counts, soaks, strict=True)}


def soak(task: tuple[str, int]) -> Soak:
    """Drive the environment of a kind for so many control steps, and watch it."""
    kind, steps = task
    driver_of(kind).env.close()  # starts what the process keeps: the servers of multiprocessing
    before = opened(["self"])
    driver, watched, block = driver_of(kind), Soak(), max(steps // SLICES, 1)
    drive(driver, block * TENTH, watched, 2 * getattr(driver.env, "num_envs", 1))
    pids = ["self", *getattr(driver.env, "pids", ())]
    watched.slices += [watch(driver, pids, block, watched) for _ in range(SLICES)]
    driver.env.close()
    watched.left_behind = max(opened(pids) - before, 0)
    return watched


def opened(pids: list[Any]) -> int:
    """Files and segments of shared memory."""
    return open_files(pids) + shared_segments(pids)


def watch(driver: Any, pids: list[Any], steps: int, watched: Soak) -> dict[str, float]:
    """Drive for a slice: what it used."""
    start, spent, episodes, counted = time.perf_counter(), processor_s(pids), driver.episodes, 0
    memory = []
    for _ in range(SAMPLES):
        counted += drive(driver, max(steps // SAMPLES, 1), watched)
        memory.append(memory_mb(pids, OWN))
    used = {"seconds": time.perf_counter() - start, "processor_s": processor_s(pids) - spent}
    used |= {"steps": counted, "episodes": driver.episodes - episodes, "memory_mb": float(np.mean(memory))}
    return used | {"files": open_files(pids), "segments": shared_segments(pids)}


def drive(driver: Any, steps: int, watched: Soak, least: int = 0) -> int:
    """At least so many control steps and ends of episodes: the number of steps."""
    counted, last = 0, driver.episodes + least
    while counted < steps or driver.episodes < last:
        counted += driver.step()
        observation, space = driver.observation, driver.env.observation_space
        finite = all(np.isfinite(part).all() for part in observation.values())
        watched.wrong += not (finite and space.contains(observation))
    return counted


def summarise(soak: Soak) -> Figures:
    """The figures of a run: first and last tenth, and what must be none."""
    first, last = columns_of(soak.slices[:TENTH]), columns_of(soak.slices[-TENTH:])
    return {
        "steps": int(sum(used["steps"] for used in soak.slices)),
        "episodes": int(sum(used["episodes"] for used in soak.slices)),
        "memory_mb": float(last["memory_mb"].mean()),
        "growth_mb": float(last["memory_mb"].mean() - first["memory_mb"].mean()),
        "files": int(last["files"].max()),
        "more_files": int(last["files"].max() - first["files"].max()),
        "segments": int(last["segments"].max()),
        "more_segments": int(last["segments"].max() - first["segments"].max()),
        "wrong_observations": soak.wrong,
        "left_behind": soak.left_behind,
        "steps_per_s_first": float(first["steps"].sum() / first["seconds"].sum()),
        "steps_per_s_last": float(last["steps"].sum() / last["seconds"].sum()),
        "processor_time_last_over_first": ratio(*(of["processor_s"] / of["steps"] for of in (last, first))),
    }


def faults(figures: Figures) -> list[str]:
    """What exceeds a bound, one line each."""
    found = []
    for name, values in figures.items():
        least = {key: values[key]["low"] if isinstance(values[key], dict) else values[key] for key in BOUNDS}
        over = [key for key, most in BOUNDS.items() if not least[key] <= most]
        found += [f"{name}: {key} {least[key]:.4g}, at most {BOUNDS[key]:g}" for key in over]
        found += [f"{name}: no episode ended"] * (not values["episodes"])
    return found
