"""The self-test of `mecp-env doctor`: make the paper's building, reset, drive."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from mecp_env.cli.findings import Finding

LEAST_STEPS = 5
FAR_M = 0.5  # an estimate so far from ground truth after two seconds has failed
SLOW_STEPS_S = 50.0

Env = gymnasium.Env[Any, Any]


def self_test(seconds: float) -> Iterator[Finding]:
    """Make `PaperMap-v0`, reset it twice with the same seed, and drive at random for so many seconds."""
    import numba.core.event

    with numba.core.event.install_recorder("numba:compile") as compiled:
        begun = time.perf_counter()
        env = gymnasium.make("mecp_env/PaperMap-v0")
        first = start(env)
        spent = time.perf_counter() - begun
    count = len(compiled.buffer) // 2
    warm = "nothing had to be compiled: the cache is warm" if not count else f"compiled {count} functions"
    yield Finding("PASS", "self-test: make", f"PaperMap-v0 made, reset and stepped in {spent:.1f} s; {warm}")
    yield same_again(first, start(env))
    yield from drive(env, seconds)
    env.close()


def start(env: Env) -> dict[str, np.ndarray[Any, Any]]:
    """The observation after a reset with seed 0 and one step."""
    env.reset(seed=0)
    observation: dict[str, np.ndarray[Any, Any]] = env.step(np.array([1.0, 0.0], np.float32))[0]
    return observation


def same_again(first: dict[str, Any], second: dict[str, Any]) -> Finding:
    """Whether the same seed gave the same bits."""
    differing = [name for name in first if not np.array_equal(first[name], second[name])]
    if differing:
        said = f"the same seed gave another {', '.join(differing)}"
        return Finding("FAIL", "self-test: seed", said, "report this, with the lines above")
    return Finding("PASS", "self-test: seed", "the same seed gave the same observation")


def drive(env: Env, seconds: float) -> Iterator[Finding]:
    """Random actions for so many seconds: observations as declared, an estimate near the truth, a fair speed."""
    env.action_space.seed(0)
    steps, over, begun = 0, True, time.perf_counter()
    while steps < LEAST_STEPS or time.perf_counter() - begun < seconds:
        if over:
            env.reset(seed=steps)
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        steps, over = steps + 1, terminated or truncated
        if not (env.observation_space.contains(observation) and np.isfinite(float(reward))):
            yield Finding("FAIL", "self-test: drive", f"step {steps} left the observation space", "report this")
            return
    yield judge(steps, steps / (time.perf_counter() - begun), info["pose_error_m"])


def judge(steps: int, speed: float, error_m: float) -> Finding:
    """What a drive says of the machine."""
    said = f"{steps} steps, {speed:.0f} per second, the estimate {100.0 * error_m:.1f} cm from ground truth"
    if error_m > FAR_M:
        return Finding("FAIL", "self-test: drive", said, "report this, with the lines above")
    if speed < SLOW_STEPS_S:
        return Finding("WARN", "self-test: drive", said, "slow: is the machine busy, or NUMBA_DISABLE_JIT set?")
    return Finding("PASS", "self-test: drive", said)
