"""A warm start: the policy imitates an explorer, and the critic learns its returns, before PPO starts."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor
from torch.nn import functional

from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import WorkerDied, cores
from mecp_env.core.settings import guess
from mecp_env.core.work_units import FailedUnit, run_units
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.environments import make_env
from mecp_env.learning.fits import Observation, downsample, goal_masks
from mecp_env.learning.run_folder import RunLog
from mecp_env.policies.registry import make_policy

ACTIVE = ("pause", "returning", "stachniss")  # explorers that act on their uncertainty
TEACHERS = ("nearest", "next_best_view", "gain", "bfs", *ACTIVE)  # explorers that select goals
BATCH = 128
FIRST_SEED = 1_000_000_000  # of the teacher's episodes: outside those of the training itself
Lesson = dict[str, np.ndarray]  # downsampled observations (n,...), `action` and `returns` (n,)


def check_teacher(config: TrainConfig) -> None:
    """Raise `ConfigError` for an unknown teacher, or one with other actions than the policy."""
    name = config.warm_start.teacher
    if name is None:
        return
    if name not in TEACHERS:
        known = ", ".join(TEACHERS)
        raise ConfigError(f"warm_start.teacher: {name!r:.80}, expected one of {known}{guess(name, TEACHERS)}")
    if config.actions != "goal":
        raise ConfigError(f"warm_start.teacher: {name} selects goals, {config.algorithm} velocities")
    if name in ACTIVE and not config.env.observation.uncertainty:
        raise ConfigError(f"warm_start.teacher: {name} acts on its uncertainty, which a `task` shows")


def warm_start(
    model: Any, venv: VecNormalize, config: TrainConfig, log: RunLog, stop: Callable[[], bool] = lambda: False
) -> bool:
    """Let the policy imitate the teacher, and the critic learn its returns; False when `stop()` came before the end."""
    lesson = gather(config, log, stop)
    if stop():
        return False
    scale_rewards(venv, lesson["returns"])
    targets = torch.as_tensor(lesson.pop("returns") / np.sqrt(venv.ret_rms.var + venv.epsilon))
    actions = torch.as_tensor(lesson.pop("action"))
    observations = {name: torch.as_tensor(values) for name, values in lesson.items()}
    rng = np.random.default_rng(config.seed)
    agreed, imitate = float("nan"), config.warm_start.imitate
    for _ in range(config.warm_start.epochs):
        if stop():
            return False
        parts = torch.as_tensor(rng.permutation(len(actions))).split(BATCH)
        agreed = float(np.mean([learn(model, (observations, actions, targets), rows, imitate) for rows in parts]))
    log.echo(f"warm start: {len(actions):,} decisions of {config.warm_start.teacher}, agrees with {agreed:.0%}")
    return True


def learn(model: Any, lesson: tuple[dict[str, Tensor], Tensor, Tensor], rows: Tensor, imitate: bool) -> float:
    """One gradient step on some rows of observations, actions and returns; the share of equal actions before it."""
    policy = model.policy
    observations, actions, targets = lesson
    given = {name: values[rows] for name, values in observations.items()}
    masks = goal_masks(given)
    values, log_likelihood, _ = policy.evaluate_actions(given, actions[rows], action_masks=masks)
    loss = model.vf_coef * functional.mse_loss(values.flatten(), targets[rows])
    if imitate:
        loss = loss - log_likelihood.mean()
    policy.optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), model.max_grad_norm)
    policy.optimizer.step()
    with torch.no_grad():
        chosen = policy.get_distribution(given, action_masks=masks).get_actions(deterministic=True)
    return float((chosen == actions[rows]).float().mean())


def scale_rewards(venv: VecNormalize, returns: np.ndarray) -> None:
    """Normalise rewards by the returns of the teacher."""
    venv.ret_rms.mean, venv.ret_rms.var = np.array(returns.mean()), np.array(returns.var())
    venv.ret_rms.count = float(len(returns))


def gather(config: TrainConfig, log: RunLog, stop: Callable[[], bool]) -> Lesson:
    """At least as many decisions of the teacher as configured, in complete episodes; fewer after `stop()`."""
    parts, held, wanted = list[Lesson](), 0, config.warm_start.decisions
    with closing(episodes(config, stop)) as lessons:
        while held < wanted and (part := next(lessons, None)) is not None:
            parts.append(part)
            held += len(part["action"])
            log.advance(0, f"warm start: {held:,} of {wanted:,} decisions")
    return {name: np.concatenate([part[name] for part in parts]) for name in (parts[0] if parts else ())}


def episodes(config: TrainConfig, stop: Callable[[], bool]) -> Generator[Lesson]:
    """Episodes of the teacher until `stop()`, always the same ones in the same order. Raises `WorkerDied`."""
    jobs = 1 if config.workers == "here" else max(2, min(config.environments, cores()))
    waiting, following = dict[int, Lesson](), 0
    with closing(run_units(partial(teach, config), count(), jobs, stop)) as finished:
        for number, lesson in finished:
            if isinstance(lesson, FailedUnit):
                raise WorkerDied(f"warm start, episode {lesson}") from lesson.error
            waiting[number] = lesson
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def teach(config: TrainConfig, number: int) -> Lesson:
    """One episode of the teacher: its observations, actions, and discounted returns."""
    assert config.warm_start.teacher is not None
    torch.set_num_threads(1)
    teacher, env = make_policy(config.warm_start.teacher), make_env(config, number)
    full_observation = env.get_wrapper_attr("full_observation")
    env.reset(seed=FIRST_SEED + 1000 * config.seed + number)
    teacher.reset(number)
    seen, steps, ended = list[Observation](), list[tuple[int, float, float]](), False
    while not ended:
        observation = full_observation()
        action = int(teacher.act(observation, goal_masks(observation)))
        seen.append(downsample(observation, goals=True))
        _, reward, terminated, truncated, info = env.step(action)
        steps.append((action, float(reward), info["discount"]))
        ended = terminated or truncated
    env.close()
    lesson = {name: np.stack([observation[name] for observation in seen]) for name in seen[0]}
    return lesson | {"action": np.array([step[0] for step in steps]), "returns": discounted_returns(steps)}


def discounted_returns(steps: list[tuple[int, float, float]]) -> np.ndarray:
    """(n,) float32 return from each step on, of (action, reward, discount) per step."""
    returns, following = np.zeros(len(steps), np.float32), 0.0
    for row in reversed(range(len(steps))):
        _, reward, discount = steps[row]
        returns[row] = following = reward + discount * following
    return returns
