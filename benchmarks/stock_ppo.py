"""Stock PPO of Stable-Baselines3, its hyperparameters unchanged: control steps per second, including learning.

In `Rooms-v0`, with two processes: `SubprocVecEnv` with two environments, or the batch of mecp_env with 16. In each
round a single environment is driven with random actions for a few seconds, then PPO collects one rollout of 4,096
actions (with goals an eighth, with images half, with a dict a quarter) and learns from it. A ratio is taken within a
round, so that other load affects both. PyTorch computes in one thread.

CPU time per control step is that of the learner (which chooses actions and learns) and of the two processes with the
environments. The learner waits for the environments and they for it, so that two cores without other load make at most
1 / (learner + environments / 2) steps per second.
"""

from __future__ import annotations

import multiprocessing
import time
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from benchmarks.common import Figures, Options, estimate, steps_per_s
from benchmarks.process_use import processor_s
from benchmarks.random_actions import RandomDriver, sample

ROOMS = "mecp_env/Rooms-v0"
MODULE_AND_ID = f"mecp_env:{ROOMS}"  # the processes of SubprocVecEnv import the package first
ROLLOUT = 4096  # actions of all environments
POLICIES = {"flat": "MlpPolicy", "image": "CnnPolicy", "dict": "MultiInputPolicy"}


class Case(NamedTuple):
    """What is trained, and where."""

    observation: str
    actions: str = "velocity"
    environments: int = 2  # more than two: in the batch of mecp_env, instead of SubprocVecEnv
    part: int = 1  # of 4,096 actions in a rollout, where these would take minutes

    @property
    def name(self) -> str:
        kind = "batch" if self.environments > 2 else "SubprocVecEnv"
        return f"{self.observation}, {self.actions}, {kind} of {self.environments}"

    @property
    def fields(self) -> dict[str, Any]:
        return {"observation": self.observation, "actions": self.actions}

    def make(self) -> Any:
        """The environments as a user would make them."""
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import SubprocVecEnv

        from mecp_env.learning import sb3_batch

        if self.environments > 2:
            return sb3_batch.make(ROOMS, self.environments, workers=2, **self.fields)
        return make_vec_env(MODULE_AND_ID, self.environments, env_kwargs=self.fields, vec_env_cls=SubprocVecEnv)


CASES = (
    Case("flat"),
    Case("flat", environments=16),
    Case("flat", actions="goal", part=8),
    Case("image", part=2),
    Case("dict", part=4),
)


def run(options: Options) -> Figures:
    """All results; 5 rounds with 3 s of a single environment (--quick: 2 of 1 s with a quarter of the actions)."""
    rounds, seconds, actions = (2, 1.0, ROLLOUT // 4) if options.quick else (5, 3.0, ROLLOUT)
    return {case.name: compare(case, rounds, seconds, actions // case.part) for case in CASES}


def compare(case: Case, rounds: int, seconds: float, actions: int) -> Figures:
    """Speed of a case over the rounds."""
    import torch
    from stable_baselines3 import PPO

    torch.set_num_threads(1)
    single, venv = RandomDriver(gymnasium.make(MODULE_AND_ID, **case.fields), sample), case.make()
    model = PPO(POLICIES[case.observation], venv, n_steps=actions // case.environments)
    measured = [(steps_per_s(single.step, seconds), *learn(model, actions)) for _ in range(rounds + 1)][1:]
    venv.close()
    alone, rates, learner, others = np.array(measured).T
    return {
        "steps_per_s": estimate(rates),
        "single_per_s": estimate(alone),
        "over_single": estimate(rates / alone),
        "learner_ms": estimate(1e3 * learner),
        "environments_ms": estimate(1e3 * others),
        "two_cores_per_s": estimate(1.0 / (learner + others / 2.0)),
    }


def learn(model: Any, actions: int) -> tuple[float, float, float]:
    """Control steps per second of one rollout with its update; CPU s per step of the learner, and of the others."""
    counts = list[int]()

    def count(inner: dict[str, Any], _: Any) -> bool:
        counts.append(sum(info.get("periods", 1) for info in inner["infos"]))
        return True

    others = [process.pid for process in multiprocessing.active_children() if process.pid]
    start, used, before = time.perf_counter(), time.process_time(), processor_s(others)
    model.learn(actions, callback=count)
    seconds, steps = time.perf_counter() - start, sum(counts)
    return steps / seconds, (time.process_time() - used) / steps, (processor_s(others) - before) / steps
