"""The environments that a policy learns in: made from a configuration, in processes, with episode statistics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle
from typing import Any, SupportsFloat

import gymnasium as gym
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.errors import LayoutError
from mecp_env.core.intervals import budget_m
from mecp_env.core.processes import cores
from mecp_env.episode.rewards import TERMS
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.fits import downsampled
from mecp_env.learning.sb3_batch import SB3Batch
from mecp_env.policies.rollout import CoverageCurve
from mecp_env.vector import BatchEnv

Env = gym.Env[Any, Any]
Step = tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]
KEPT = (
    *("coverage", "correct_coverage", "lost", "metres", "contacts", "landmarks"),
    *("pose_error_final_m", "pose_rmse_m", "nees_mean"),
)
MOST_WORKERS = 8  # of an evaluation
MEAN_OPTION_DISCOUNT = 0.93  # about the mean discount of an option: only for the scale of the rewards
REWARDS = tuple(f"reward_{term}" for term in TERMS)
CUSTOM = "reward_custom"  # of all terms that the user has registered
FIGURES = (
    *("auc", "correct_over_steps", *KEPT, "episode_periods", "episode_decisions", "reward"),
    *(*REWARDS, CUSTOM, "terminated"),
)


class OptionReward(gym.Wrapper[Any, Any, Any, Any]):
    """Discounts the reward of an option (macro-action), the drive to a goal, by the metres driven within it.

    With goals, the reward of a decision is the sum of those of its control steps, each times exp(-metres / discount_m)
    since the start of the option, and `info["discount"]` is that factor at its end: a semi-Markov decision process
    (Sutton, Precup, Singh 1999) whose clock is the odometer, because coverage is compared over metres. With velocities
    rewards stay unchanged. `info` has `periods`, `discount`, and at the end of an episode `figures`.

    An episode whose filter diverged terminates here, although the environment truncates it: no reward can be earned
    after it, while a learner adds the value of the next state to a truncated episode.
    """

    def __init__(self, env: Env, discount: float, discount_m: float) -> None:
        super().__init__(env)
        self.discount, self.discount_m = discount, discount_m
        self.steps = list[Step]()
        self.goals = env.has_wrapper_attr("callback")  # of `GoalActions`
        if self.goals:
            env.set_wrapper_attr("callback", self.steps.append)
            env.set_wrapper_attr("observes", False)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """As of the wrapped environment; `info` is empty."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.curve, self.rewards, self.decisions = CoverageCurve(), dict.fromkeys((*REWARDS, CUSTOM), 0.0), 0
        self.metres = 0.0
        self._count(info)
        return observation, {}

    def step(self, action: Any) -> Step:
        """As of the wrapped environment, with the discounted reward of the option; divergence terminates."""
        self.steps.clear()
        step = self.env.step(action)
        observation, reward, terminated, truncated, _ = step
        discount = self.discount
        if self.goals:
            reward, discount = self._of_option()
        else:
            self.steps.append(step)
        for each in self.steps:
            self._count(each[4])
        self.decisions += 1
        info: dict[str, Any] = {"periods": len(self.steps), "discount": discount}
        if terminated or truncated:
            info["figures"] = self._figures(terminated)
        diverged = bool(self.steps[-1][4]["diverged"])
        return observation, float(reward), terminated or diverged, truncated and not diverged, info

    def _of_option(self) -> tuple[float, float]:
        """The discounted reward of an option, and the discount of what follows it."""
        total, start = 0.0, self.metres
        for _, reward, _, _, info in self.steps:
            self.metres = float(info["metres"])
            total += float(reward) * math.exp(-(self.metres - start) / self.discount_m)
        return total, self.discount * math.exp(-(self.metres - start) / self.discount_m)

    def _count(self, info: dict[str, Any]) -> None:
        """Add one control step to the metrics of the episode."""
        self.curve.add(info["metres"], info["period"], info["coverage"])
        for name, value in info.items():
            if name.startswith("reward_"):
                self.rewards[name if name in REWARDS else CUSTOM] += value

    def _figures(self, terminated: bool) -> dict[str, float]:
        """The metrics of the episode, in the order of `FIGURES`."""
        summary: dict[str, float] = self.env.get_wrapper_attr("summary")()
        own = {
            "auc": self.curve.area_under(budget_m(summary["free_area_m2"])),
            "correct_over_steps": summary["correct_coverage_over_steps"],
            "episode_periods": summary["periods"],
            "episode_decisions": self.decisions,
            "reward": sum(self.rewards.values()),
            "terminated": terminated,
        }
        found = summary | self.rewards | own
        return {name: float(found[name]) for name in FIGURES}


class FixedBuildings(gym.Wrapper[Any, Any, Any, Any]):
    """Cycles through some buildings of the split, one per reset; a reset with a seed starts with the first one.

    The number of a building is the seed of its episode.
    """

    def __init__(self, env: Env, buildings: Sequence[int], generated: bool) -> None:
        super().__init__(env)
        self.buildings, self.generated = buildings, generated
        self.left = cycle(buildings)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The next building."""
        if seed is not None:
            self.left = cycle(self.buildings)
        building = next(self.left)
        return self.env.reset(seed=building, options={"building": building} if self.generated else None)


def make_env(config: TrainConfig, index: int = 0, split: str | None = None) -> Env:
    """Environment `index` of a run; `split` replaces the configured one.

    Raises `ConfigError`, and `LayoutError` for an unknown layout, with the field that it comes from.
    """
    buildings, fields = config.buildings, config.env.to_dict() | {"actions": config.actions}
    del fields["layout"]
    if buildings.layout is not None:
        try:
            env = gym.make("mecp_env/Layout-v0", **fields, layout=buildings.layout)
        except LayoutError as error:
            raise LayoutError(f"buildings.layout: {error}") from None
    else:
        difficulty = buildings.difficulty[index % len(buildings.difficulty)]
        where: dict[str, Any] = {"difficulty": difficulty, "split": split or buildings.split, **buildings.spec}
        env = gym.make("mecp_env/Rooms-v0", **fields, **where)
    option = OptionReward(env, config.ppo.discount, config.ppo.discount_m)
    return downsampled(option, goals=config.actions == "goal")


def make_validation_env(config: TrainConfig, index: int, buildings: Sequence[int]) -> Env:
    """Environment `index` of an evaluation on the validation split."""
    return FixedBuildings(make_env(config, index, "validation"), buildings, config.buildings.layout is None)


class Rewards(VecNormalize):
    """Divides rewards by the running deviation of the return, and measures how long the learner waits."""

    waited_s = 0.0

    def step_wait(self) -> VecEnvStepReturn:  # `step_async` only keeps the actions
        start = time.perf_counter()
        step = super().step_wait()
        self.waited_s += time.perf_counter() - start
        return step


def make_many(config: TrainConfig, seed: int) -> Rewards:
    """The environments of a run, seeded."""
    makers = [partial(make_env, config, index) for index in range(config.environments)]
    venv = vectorise(makers, config.workers, computing=config.actions == "velocity")  # goals have processes anyway
    venv.seed(seed)
    gamma = MEAN_OPTION_DISCOUNT if config.actions == "goal" else config.ppo.discount
    return Rewards(venv, norm_obs=False, norm_reward=config.ppo.normalise_reward, gamma=gamma)


def make_validation(config: TrainConfig) -> VecEnv:
    """The environments of an evaluation on the validation split; `seed` rewinds them.

    Environment i runs as many episodes as `evaluate_policy` expects of it, always in the same buildings.
    """
    buildings = config.log.evaluate_buildings
    count = min(buildings, MOST_WORKERS, config.environments)
    parts = [range(count - 1 - index, buildings, count) for index in range(count)]
    makers = [partial(make_validation_env, config, index, part) for index, part in enumerate(parts)]
    return vectorise(makers, config.workers)


def vectorise(makers: Sequence[Callable[[], Env]], workers: str = "batch", computing: bool = False) -> VecEnv:
    """Many environments as one: in few processes, each in its own process, or all in this one.

    `computing`: this process computes while a batch steps, so that it should step no environment itself.
    """
    if workers == "here":
        return DummyVecEnv(list(makers))
    few = cores() if computing else None
    count = len(makers) if workers == "processes" else few
    return SB3Batch(BatchEnv(makers, workers=count, autoreset_mode=AutoresetMode.SAME_STEP))
