"""The environments that an agent learns in: made from a configuration, in processes, with what is logged of them."""

from __future__ import annotations

import math
import multiprocessing
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.errors import LayoutError
from mecp_env.episode.rewards import TERMS
from mecp_env.learning.compact import Compact
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.processes import Processes
from mecp_env.learning.sb3_batch import SB3Batch
from mecp_env.policies.curve import Curve, budget_m
from mecp_env.vector import BatchEnv
from mecp_env.wrappers import GoalActions

Step = tuple[Any, float, bool, bool, dict[str, Any]]
KEPT = ("coverage", "metres", "contacts", "pose_error_final_m", "pose_rmse_m", "nees_mean", "landmarks")
LENGTHS = ("episode_periods", "episode_decisions")
FIGURES = ("auc", *KEPT, *LENGTHS, "reward", *(f"reward_{term}" for term in TERMS), "terminated")
GOAL_VALID = 8  # column of `goals`


@dataclass(slots=True)
class Tally:
    """What is added up over an episode."""

    curve: Curve = field(default_factory=Curve)
    terms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TERMS, 0.0))
    decisions: int = 0

    def look(self, info: dict[str, Any]) -> None:
        """Take in one control step."""
        self.curve.add(info["metres"], info["period"], info["coverage"])
        for term in TERMS:
            self.terms[term] += info[f"reward_{term}"]


class EpisodeLog(gym.Wrapper[Any, Any, Any, Any]):
    """Adds up the figures of an episode, and weighs what lies further on in a drive by the metres driven until then.

    With goals the reward of a decision is the sum of those of its steps, each times exp(-metres / discount_m) of the
    drive so far, and `info["discount"]` is that factor at the end of the drive: a semi-Markov decision process
    (Sutton, Precup, Singh 1999) whose clock is the odometer, because coverage is compared over metres. With velocities
    rewards stay as they are. `info` holds `steps`, `discount`, and at the end of an episode `figures`.

    An episode whose filter diverged has ended here (`terminated`), whatever the environment calls it: nothing is to be
    earned after it, while a learner values what comes after one that was cut short.
    """

    def __init__(self, env: gym.Env[Any, Any], discount: float, discount_m: float) -> None:
        super().__init__(env)
        self.discount, self.discount_m = discount, discount_m
        self.tally, self.drive = Tally(), list[Step]()
        self.goals = goal_wrapper(env)
        if self.goals is not None:
            self.goals.callback = self.drive.append
        self.metres = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """As of the environment below; `info` is empty."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.tally, self.metres = Tally(), 0.0
        self.tally.look(info)
        return observation, {}

    def step(self, action: Any) -> Step:
        """As of the environment below, with the reward of a drive discounted; a divergence is an end."""
        self.drive.clear()
        step = self.env.step(action)
        observation, reward, terminated, truncated, _ = step
        factor = self.discount
        if self.goals is not None:
            reward, factor = self._of_drive()
        else:
            self.drive.append(step)
        for step in self.drive:
            self.tally.look(step[4])
        self.tally.decisions += 1
        info: dict[str, Any] = {"periods": len(self.drive), "discount": factor}
        if terminated or truncated:
            info |= {"figures": self._figures(terminated)}
        lost = bool(self.drive[-1][4]["diverged"])
        return observation, float(reward), terminated or lost, truncated and not lost, info

    def _of_drive(self) -> tuple[float, float]:
        """The discounted reward of a drive, and the discount of what comes after it."""
        total, begun = 0.0, self.metres
        for _, reward, _, _, info in self.drive:
            self.metres = float(info["metres"])
            total += reward * math.exp(-(self.metres - begun) / self.discount_m)
        return total, self.discount * math.exp(-(self.metres - begun) / self.discount_m)

    def _figures(self, terminated: bool) -> dict[str, float]:
        """The figures of the episode, in the order of `FIGURES`."""
        final = self.env.get_wrapper_attr("summary")()
        tally = self.tally
        figures = {name: final[name] for name in KEPT}
        figures["auc"] = tally.curve.area_under(budget_m(final["free_area_m2"]))
        rewards = {f"reward_{term}": value for term, value in tally.terms.items()}
        totals = {"reward": sum(rewards.values()), "terminated": float(terminated)}
        totals |= dict(zip(LENGTHS, (final["periods"], tally.decisions), strict=True))
        found = figures | totals | rewards
        return {name: float(found[name]) for name in FIGURES}


class Visits(gym.Wrapper[Any, Any, Any, Any]):
    """Goes through some buildings of the split, one a reset, the number of each its seed; then through them again."""

    def __init__(self, env: gym.Env[Any, Any], buildings: Sequence[int]) -> None:
        super().__init__(env)
        self.buildings, self.next = list(buildings), 0

    def rewind(self) -> None:
        """Let the next one be the first."""
        self.next = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The next building."""
        building = self.buildings[self.next % len(self.buildings)]
        self.next += 1
        return self.env.reset(seed=building, options={"building": building})


def goal_wrapper(env: gym.Env[Any, Any]) -> GoalActions | None:
    """The `GoalActions` among the wrappers of an environment."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, GoalActions):
            return env
        env = env.env
    return None


def make_env(config: TrainConfig, index: int = 0, split: str | None = None) -> gym.Env[Any, Any]:
    """Environment `index` of a run, as an agent learns in it; `split` in place of the configured one.

    Raises `ConfigError`, and `LayoutError` for a layout that there is not.
    """
    buildings, fields = config.buildings, config.env.to_dict()
    del fields["layout"], fields["actions"]
    if buildings.layout is not None:
        env = make_layout(buildings.layout, fields | {"actions": config.actions})
    else:
        difficulty = buildings.difficulty[index % len(buildings.difficulty)]
        where = {"difficulty": difficulty, "split": split or buildings.split, **buildings.spec}
        env = gym.make("mecp_env/Rooms-v0", **fields, **where, actions=config.actions)
    logged = EpisodeLog(env, config.ppo.discount, config.ppo.discount_m)
    return Compact(logged, goals=config.actions == "goal")


def make_layout(layout: str, fields: dict[str, Any]) -> gym.Env[Any, Any]:
    """The environment of one building. Raises `LayoutError`, with the field that it comes from."""
    try:
        return gym.make("mecp_env/Layout-v0", **fields, layout=layout)
    except LayoutError as error:
        raise LayoutError(f"buildings.layout: {error}") from None


def make_visits(config: TrainConfig, index: int, buildings: Sequence[int]) -> gym.Env[Any, Any]:
    """Environment `index` of an evaluation on the validation split."""
    env = make_env(config, index, "validation")
    return env if config.buildings.layout is not None else Visits(env, buildings)


def in_worker(make: Callable[[], gym.Env[Any, Any]]) -> gym.Env[Any, Any]:
    """`make()`; a process that was started for it leaves Ctrl-C to the learner."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return make()


class Timed(VecEnvWrapper):
    """Measures how long the learner waits for the environments, and answers for their masks."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.waited_s, self.steps = 0.0, 0
        self.last: dict[str, Any] = {}

    def reset(self) -> VecEnvObs:
        observations = self.venv.reset()
        assert isinstance(observations, dict)
        self.last = observations
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        begun = time.perf_counter()
        self.venv.step_async(actions)
        self.waited_s += time.perf_counter() - begun

    def step_wait(self) -> VecEnvStepReturn:
        begun = time.perf_counter()
        observations, rewards, dones, infos = self.venv.step_wait()
        self.waited_s += time.perf_counter() - begun
        assert isinstance(observations, dict)
        self.last = observations
        self.steps += sum(info["periods"] for info in infos)
        return observations, rewards, dones, infos

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """As of the environments; the masks stand in the observation and need no question to the workers."""
        if method_name == "action_masks" and indices is None:
            return list(self.last["goals"][..., GOAL_VALID] > 0.5)
        return super().env_method(method_name, *args, indices=indices, **kwargs)


def make_many(config: TrainConfig, seed: int) -> Timed:
    """The environments of a run, seeded."""
    makers = [partial(make_env, config, index) for index in range(config.environments)]
    venv = gather(makers, config.workers)
    venv.seed(seed)
    return Timed(venv)


def gather(makers: list[Callable[[], gym.Env[Any, Any]]], workers: str) -> VecEnv:
    """Environments side by side: in few processes, each in a process of its own, or all in this one."""
    if workers == "here":
        return DummyVecEnv(list(makers))
    apart = [partial(in_worker, make) for make in makers]
    if workers == "processes":
        return Processes(apart)
    return SB3Batch(BatchEnv(apart, autoreset_mode=AutoresetMode.SAME_STEP))
