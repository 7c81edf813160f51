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
from benchmarks.common import Figures, Gate, Options, chosen, in_parallel, ratio, show_progress
from benchmarks.process_use import open_files, own_memory_mb, processor_s, shared_segments
from benchmarks.random_actions import RandomDriver, goal
from benchmarks.tables import columns_of, listed, turned
from benchmarks.vector import HELD

NAME, COUNT = "mecp_env/Rooms-v0", 16
SETTING: dict[str, Any] = {"crowd": {"people": 2}, "clutter": {"movable_boxes": 2}, "max_steps": 200}
SETS = {"vector": 1_000_000, "single": 1_000_000}  # control steps
QUICK = {"vector": 16_000, "single": 4_000}
MOST = 1_000_000_000
SLICES, TENTH = 100, 10
SAMPLES = 10  # of memory, in a slice

BOUNDS = {
    "growth_mb": 5.0,
    "more_files": 0.0,
    "more_segments": 0.0,
    "wrong_observations": 0.0,
    "left_behind": 0.0,
    "processor_time_last_over_first": 1.1,
}
GATES = tuple(Gate(f"{name}/{figure}", "bound", most) for name in SETS for figure, most in BOUNDS.items())


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
        self.rng, self.calls = np.random.default_rng(0), 0

    def advance(self) -> tuple[int, int]:
        """One step of all environments: control steps, and episodes that ended."""
        if self.calls % HELD == 0:
            self.held = self.rng.uniform([0.3, -0.4], [1.0, 0.4], (COUNT, 2)).astype(np.float32)
        self.calls += 1
        self.observation, _, terminated, truncated, infos = self.env.step(self.held)
        return int((infos["period"] > 0).sum()), int((terminated | truncated).sum())


class One(RandomDriver):
    """A single environment and random goals."""

    def __init__(self) -> None:
        super().__init__(gymnasium.make(NAME, actions="goal", **SETTING), goal)

    def advance(self) -> tuple[int, int]:
        """A drive to a goal: control steps, and episodes that ended."""
        before = self.episodes
        return self.step(), self.episodes - before


KINDS = {"vector": Many, "single": One}


def run(options: Options) -> Figures:
    """The figures of each set; one after the other, each kept when it is finished."""
    counts = chosen(options.sets, SETS, MOST) or (QUICK if options.quick else SETS)
    soaks = in_parallel(soak, Soak, list(counts.items()), replace(options, jobs=1))
    return {name: summarise(result) for name, result in zip(counts, soaks, strict=True)}


def soak(task: tuple[str, int]) -> Soak:
    """Drive the environment of a kind for so many control steps, and watch it."""
    kind, steps = task
    KINDS[kind]().env.close()  # starts what the process keeps: the servers of multiprocessing
    before = open_files(["self"]) + shared_segments(["self"])
    driver, watched = KINDS[kind](), Soak()
    block = max(steps // SLICES, 1)
    drive(driver, block * TENTH, watched, 2 * getattr(driver.env, "num_envs", 1))
    begun = time.monotonic()
    for number in range(SLICES):
        watch(driver, block, watched)
        show_progress(number + 1, SLICES, time.monotonic() - begun)
    pids = pids_of(driver.env)
    driver.env.close()
    watched.left_behind = max(open_files(pids) + shared_segments(pids) - before, 0)
    return watched


def pids_of(env: Any) -> list[Any]:
    """This process and the workers of an environment."""
    return ["self", *getattr(env, "pids", ())]


def watch(driver: Any, steps: int, watched: Soak) -> None:
    """Drive for a slice and append what it used."""
    pids = pids_of(driver.env)
    start, spent = time.perf_counter(), processor_s(pids)
    memory, parts = list[float](), list[tuple[int, int]]()
    for _ in range(SAMPLES):
        parts.append(drive(driver, max(steps // SAMPLES, 1), watched))
        memory.append(own_memory_mb(pids))
    counted, episodes = map(sum, zip(*parts, strict=True))
    used = {"seconds": time.perf_counter() - start, "processor_s": processor_s(pids) - spent}
    used |= {"steps": counted, "episodes": episodes, "memory_mb": float(np.mean(memory))}
    watched.slices.append(used | {"files": open_files(pids), "segments": shared_segments(pids)})


def drive(driver: Any, steps: int, watched: Soak, least: int = 0) -> tuple[int, int]:
    """At least so many control steps and ends of episodes: their numbers."""
    counted = episodes = 0
    while counted < steps or episodes < least:
        done, ended = driver.advance()
        counted, episodes = counted + done, episodes + ended
        watched.wrong += not sound(driver.env.observation_space, driver.observation)
    return counted, episodes


def sound(space: Any, observation: dict[str, Any]) -> bool:
    """True when every number is finite and the observation is in its space."""
    return all(np.isfinite(part).all() for part in observation.values()) and space.contains(observation)


def summarise(soak: Soak) -> Figures:
    """The figures of a run: first and last tenth, and what must be none."""
    of, first, last = columns_of(soak.slices), slice(0, TENTH), slice(-TENTH, None)
    per_step = of["processor_s"] / of["steps"]
    rate = [float(of["steps"][tenth].sum() / of["seconds"][tenth].sum()) for tenth in (first, last)]
    memory = [float(of["memory_mb"][tenth].mean()) for tenth in (first, last)]
    files, segments = ([int(of[name][tenth].max()) for tenth in (first, last)] for name in ("files", "segments"))
    return {
        "steps": int(of["steps"].sum()),
        "episodes": int(of["episodes"].sum()),
        "memory_mb": memory[1],
        "growth_mb": memory[1] - memory[0],
        "files": files[1],
        "more_files": files[1] - files[0],
        "segments": segments[1],
        "more_segments": segments[1] - segments[0],
        "wrong_observations": soak.wrong,
        "left_behind": soak.left_behind,
        "steps_per_s_first": rate[0],
        "steps_per_s_last": rate[1],
        "processor_time_last_over_first": ratio(per_step[last], per_step[first]),
    }


def faults(figures: Figures) -> list[str]:
    """What exceeds a bound, one line each."""
    return [f"{name}: {fault}" for name, values in figures.items() for fault in _faults(values)]


def _faults(values: Figures) -> list[str]:
    least = {name: values[name]["low"] if isinstance(values[name], dict) else values[name] for name in BOUNDS}
    found = [f"{name} {least[name]:.4g}, at most {most:g}" for name, most in BOUNDS.items() if not least[name] <= most]
    return found + ["no episode ended"] * (not values["episodes"])


def report(figures: Figures) -> str:
    """One column per set."""
    return f"{turned(figures)}\n\n{listed(faults(figures), 'All within their bounds.')}"
