"""A warm start: the policy imitates an explorer, and the critic learns what that earns, before PPO begins."""

from __future__ import annotations

import difflib
import importlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from functools import partial
from itertools import count, islice, takewhile
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor
from torch.nn import functional

from mecp_env.core.errors import ConfigError
from mecp_env.learning.compact import Observation, compact
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.environments import GOAL_VALID, make_env
from mecp_env.learning.report import Report
from mecp_env.vector import WorkerDied

TEACHERS = {  # explorers that choose goals: name -> "module:Class"
    "nearest": "mecp_env.policies.nearest:Nearest",
    "gain": "mecp_env.policies.gain:Gain",
    "bfs": "mecp_env.policies.bfs:BreadthFirstAgent",
}
BATCH = 128
LOOK_S = 0.2  # how often somebody looks whether to stop
FIRST_SEED = 1_000_000_000  # of the teacher's episodes: none of those of the training itself
Lesson = dict[str, np.ndarray]  # compact observations (n,...), `action` and `earned` (n,)


def never() -> bool:
    """Nobody asks to stop."""
    return False


def make_teacher(name: str) -> Any:
    """The explorer of that name. Raises `ConfigError` with those there are."""
    if name not in TEACHERS:
        nearest = difflib.get_close_matches(name, TEACHERS, n=1)
        guess = f"; did you mean {nearest[0]!r}?" if nearest else ""
        raise ConfigError(f"warm_start.teacher: {name!r:.80} is none of {', '.join(TEACHERS)}{guess}")
    module, _, kind = TEACHERS[name].partition(":")
    return getattr(importlib.import_module(module), kind)()


def check_teacher(config: TrainConfig) -> None:
    """Raise `ConfigError` for a teacher that there is not, or that does something else than the agent."""
    name = config.warm_start.teacher
    if name is None:
        return
    if make_teacher(name).actions != config.actions:
        raise ConfigError(f"warm_start.teacher: {name} chooses goals, {config.algorithm} velocities")


def imitate(
    model: OnPolicyAlgorithm, venv: VecNormalize, config: TrainConfig, report: Report, stop: Callable[[], bool] = never
) -> bool:
    """Let the policy imitate the teacher, and the critic learn its returns; False when `stop()` came before the end."""
    lesson = gather(config, report, stop)
    if stop():
        return False
    scale_rewards(venv, lesson["earned"])
    targets = torch.as_tensor(lesson.pop("earned") / np.sqrt(venv.ret_rms.var + venv.epsilon))
    actions = torch.as_tensor(lesson.pop("action"))
    observations = {name: torch.as_tensor(values) for name, values in lesson.items()}
    rng = np.random.default_rng(config.seed)
    agreed, imitating = float("nan"), config.warm_start.imitate
    for _ in range(config.warm_start.epochs):
        if stop():
            return False
        parts = torch.as_tensor(rng.permutation(len(actions))).split(BATCH)
        agreed = float(np.mean([learn(model, (observations, actions, targets), rows, imitating) for rows in parts]))
    report.say(f"warm start: {len(actions):,} decisions of {config.warm_start.teacher}, agrees with {agreed:.0%}")
    return True


def learn(
    model: OnPolicyAlgorithm, lesson: tuple[dict[str, Tensor], Tensor, Tensor], rows: Tensor, imitating: bool
) -> float:
    """One gradient step on some rows of observations, actions and returns; how often the policy does as the teacher."""
    policy = model.policy
    observations, actions, targets = lesson
    given = {name: values[rows] for name, values in observations.items()}
    masks = given["goals"][..., GOAL_VALID] > 0.5
    values, log_likelihood, _ = policy.evaluate_actions(given, actions[rows], action_masks=masks)
    loss = model.vf_coef * functional.mse_loss(values.flatten(), targets[rows])
    if imitating:
        loss = loss - log_likelihood.mean()
    policy.optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), model.max_grad_norm)
    policy.optimizer.step()
    with torch.no_grad():
        chosen = policy.get_distribution(given, action_masks=masks).get_actions(deterministic=True)
    return float((chosen == actions[rows]).float().mean())


def scale_rewards(venv: VecNormalize, earned: np.ndarray) -> None:
    """Let rewards be normalised by what the teacher earned."""
    venv.ret_rms.mean, venv.ret_rms.var = np.array(earned.mean()), np.array(earned.var())
    venv.ret_rms.count = float(len(earned))


def gather(config: TrainConfig, report: Report, stop: Callable[[], bool]) -> Lesson:
    """At least as many decisions of the teacher as the configuration says, in whole episodes; fewer after `stop()`."""
    with closing(episodes(config, stop)) as played:
        parts = list(enough(played, config.warm_start.decisions, report))
    return {name: np.concatenate([part[name] for part in parts]) for name in (parts[0] if parts else ())}


def enough(played: Iterator[Lesson], decisions: int, report: Report) -> Iterator[Lesson]:
    """The first of some episodes, until they hold so many decisions."""
    held = 0
    for part in played:
        held += len(part["action"])
        report.status(f"warm start: {held:,} of {decisions:,} decisions")
        yield part
        if held >= decisions:
            return


def episodes(config: TrainConfig, stop: Callable[[], bool]) -> Generator[Lesson]:
    """Episodes of the teacher until `stop()`, always the same ones in the same order. Raises `WorkerDied`."""
    play = partial(watch, config)
    if config.workers == "here":
        yield from map(play, takewhile(lambda _: not stop(), count()))
        return
    width = max(1, min(config.environments, os.cpu_count() or 1))
    with crew(width) as pool:
        yield from in_order((pool.submit(play, number) for number in count()), 4 * width, stop)


def end(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool."""
    for process in list(pool._processes.values()):
        process.terminate()


@contextmanager
def crew(width: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes, which leave Ctrl-C to this one and are ended at once. Raises `WorkerDied` when one dies."""
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(width, context, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise WorkerDied(f"a process of the warm start: {error}") from None
        finally:  # what is begun and not needed any more takes seconds
            end(pool)


def in_order(begun: Iterator[Future[Lesson]], ahead: int, stop: Callable[[], bool]) -> Generator[Lesson]:
    """The results, one after the other, of work that `begun` begins; so much is begun ahead."""
    waiting = deque(islice(begun, ahead))
    while not stop():
        if wait(list(waiting)[:1], LOOK_S).done:
            yield waiting.popleft().result()
            waiting.append(next(begun))


def watch(config: TrainConfig, number: int) -> Lesson:
    """One episode of the teacher: what it saw, what it did, and what that earned from there on, discounted."""
    assert config.warm_start.teacher is not None
    torch.set_num_threads(1)
    teacher, env = make_teacher(config.warm_start.teacher), make_env(config, number)
    plain = env.get_wrapper_attr("plain")
    env.reset(seed=FIRST_SEED + 1000 * config.seed + number)
    teacher.reset(number)
    seen, steps, over = list[Observation](), list[tuple[int, float, float]](), False
    while not over:
        observation = plain()
        action = int(teacher.act(observation, observation["goals"][:, GOAL_VALID] > 0.5))
        seen.append(compact(observation, goals=True))
        _, reward, terminated, truncated, info = env.step(action)
        steps.append((action, reward, info["discount"]))
        over = terminated or truncated
    env.close()
    lesson = {name: np.stack([observation[name] for observation in seen]) for name in seen[0]}
    return lesson | {"action": np.array([step[0] for step in steps]), "earned": returns(steps)}


def returns(steps: list[tuple[int, float, float]]) -> np.ndarray:
    """(n,) float32: what each step and those after it earned, by their discounts."""
    earned, ahead = np.zeros(len(steps), np.float32), 0.0
    for row in reversed(range(len(steps))):
        _, reward, discount = steps[row]
        earned[row] = ahead = reward + discount * ahead
    return earned
