"""Training with Stable-Baselines3: from a configuration to a run folder.

A warm start: the policy imitates an explorer, and the critic learns its returns, before PPO starts.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor
from torch.nn import functional

from mecp_env.core import processes
from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import WorkerDied, cores
from mecp_env.core.settings import guess
from mecp_env.core.work_units import FailedUnit, run_units
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.encoder import make_model, make_network
from mecp_env.learning.environments import FIGURES, TimedVecEnv, make_env, make_many, make_validation
from mecp_env.learning.exported import check_finite, weights_of
from mecp_env.learning.fits import Observation, downsample, goal_masks
from mecp_env.learning.learned import MOST_POLICY_BYTES, save_policy, tensor_bytes
from mecp_env.learning.run_folder import CLOCK, RunFolder, RunLog, TrainingState, draw_training
from mecp_env.learning.sb3_batch import OptionCallback
from mecp_env.policies.registry import make_policy

ENDS = signal.SIGINT, signal.SIGTERM  # Ctrl-C, and what a scheduler of a cluster sends
MEAN_OPTION_DISCOUNT = 0.93  # about the mean discount of an option: only for the scale of the rewards
ACTIVE = ("pause", "returning", "stachniss")  # explorers that act on their uncertainty
TEACHERS = ("nearest", "next_best_view", "gain", "bfs", *ACTIVE)  # explorers that select goals
BATCH = 128
FIRST_SEED = 1_000_000_000  # of the teacher's episodes: outside those of the training itself
Lesson = dict[str, np.ndarray]  # downsampled observations (n,...), `action` and `returns` (n,)


def train(config: TrainConfig, folder: Path, resume: bool = False) -> bool:
    """Train in a folder, or continue the run there: True at its end, False after Ctrl-C or SIGTERM, which save all.

    Raises `ConfigError` before anything is written, `WorkerDied`, and `NotFiniteError`.
    """
    check(config)
    with closing(RunFolder(folder, config)) as run_folder, ExitStack() as stack:
        run_folder.hold() if resume else run_folder.start()
        torch.set_num_threads(1)  # several meet at the end of every operation: slower where a core is shared
        timed = stack.enter_context(closing(make_many(config, config.seed)))
        gamma = MEAN_OPTION_DISCOUNT if config.actions == "goal" else config.ppo.discount
        venv = VecNormalize(timed, norm_obs=False, norm_reward=config.ppo.normalise_reward, gamma=gamma)
        model = make_model(config, venv, config.seed)
        processes.keep()  # of an update; the workers are not meant
        log = stack.enter_context(RunLog(folder, config.steps, config.log.tensorboard))  # threads, after the forks
        run = stack.enter_context(closing(RunCallback(run_folder, log, timed)))
        if resume:
            run.state = resumed(run_folder, model, log)
        done = learn(model, run)
    draw_training(folder)
    return done


def check(config: TrainConfig) -> None:
    """Raise `ConfigError` for a configuration that cannot be trained."""
    check_teacher(config)
    check_size(config)
    for index in range(len(config.buildings.difficulty)):
        make_env(config, index).close()


def check_size(config: TrainConfig) -> None:
    """Raise `ConfigError` for a network whose weights would be refused at loading."""
    torch.set_num_threads(1)  # workers may be forked later, which threads of PyTorch would not survive
    size = len(tensor_bytes(weights_of(make_network(config))))
    network = config.network
    if size > MOST_POLICY_BYTES:
        raise ConfigError(
            f"network.width: {network.width} (grid_channels {network.grid_channels}, lstm {network.lstm}) makes a file "
            f"of {size} bytes of weights, at most {MOST_POLICY_BYTES}"
        )


def resumed(folder: RunFolder, model: OnPolicyAlgorithm, log: RunLog) -> TrainingState:
    """The state of a run that continues, and its model. All draws follow from the seed and the decisions made."""
    state = folder.resume(model, log.echo)
    returns = reward_statistics(model)
    returns.mean, returns.var, returns.count = *map(np.array, state.returns[:2]), state.returns[2]
    if state.decisions:
        words = np.random.SeedSequence([folder.config.seed, state.decisions]).generate_state(1)
        model.set_random_seed(int(words[0]) // 2)
    return state


def learn(model: OnPolicyAlgorithm, run: RunCallback) -> bool:
    """Train to the end, or until Ctrl-C or SIGTERM; then everything is saved. An interrupted warm start is not."""
    config, log = run.folder.config, run.log
    log.start(run.state.decisions)
    model.set_logger(log.training)
    first = config.warm_start.teacher and not run.state.decisions
    if first and not warm_started(model, config, log):
        return False
    left = max(0, config.steps - run.state.decisions)
    with handled_by(run.end):
        model.learn(left, callback=[OptionCallback(), run], reset_num_timesteps=False)
    return not run.stop


def warm_started(model: OnPolicyAlgorithm, config: TrainConfig, log: RunLog) -> bool:
    """Warm start; False after Ctrl-C or SIGTERM."""
    try:
        with handled_by(signal.default_int_handler):
            warm_start(model, model.get_vec_normalize_env(), config, log)
    except KeyboardInterrupt:
        log.echo("nothing is saved yet: an interrupted warm start starts again")
        return False
    log.advance(0, "first update")
    return True


@contextmanager
def handled_by(handler: Callable[[int, Any], Any]) -> Iterator[None]:
    """Within it that function handles Ctrl-C and SIGTERM."""
    before = {number: signal.signal(number, handler) for number in ENDS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def reward_statistics(model: OnPolicyAlgorithm) -> Any:
    """The running statistics by which rewards are normalised."""
    venv = model.get_vec_normalize_env()
    assert venv is not None
    return venv.ret_rms


class RunCallback(BaseCallback):
    """Counts and logs; between two updates it evaluates, keeps the best policy and saves checkpoints.

    Stable-Baselines3's own callbacks save and evaluate within a rollout, by the reward alone, and not atomically.
    """

    model: OnPolicyAlgorithm

    def __init__(self, folder: RunFolder, log: RunLog, timed: TimedVecEnv) -> None:
        super().__init__()
        self.folder, self.log, self.timed = folder, log, timed
        self.state, self.stop = TrainingState(), False  # after `stop` the training ends
        self.validation: VecEnv | None = None  # made when it is first needed
        self.saved_s = time.perf_counter()

    def _on_training_start(self) -> None:
        """Also at the end of every rollout."""
        self.start_s, self.start_periods = time.perf_counter(), self.state.periods
        self.timed.waited_s = 0.0

    def _on_rollout_start(self) -> None:
        begun, state, options = time.perf_counter(), self.state, self.folder.config.log
        check_finite(self.model.policy)
        if not self.stop and (state.evaluated < 0 or state.decisions >= state.evaluated + options.evaluate_every):
            self.evaluate()
        if begun - self.saved_s >= options.checkpoint_s:
            self.save()
        self.start_s += time.perf_counter() - begun  # which is no part of the training time

    def _on_step(self) -> bool:
        state = self.state
        for info in self.locals["infos"]:
            state.periods += info["periods"]
            state.episodes += "figures" in info
            for name, value in info.get("figures", {}).items():
                self.logger.record_mean(f"rollout/{name}", value)
        state.decisions = self.num_timesteps
        self.log.advance(state.decisions)
        return not self.stop

    def _on_rollout_end(self) -> None:
        seconds = time.perf_counter() - self.start_s
        self.state.seconds += seconds
        rate, waiting = (self.state.periods - self.start_periods) / seconds, self.timed.waited_s / seconds
        self._on_training_start()
        for name, value in (self.clock() | {"periods_per_s": rate, "waiting_share": waiting}).items():
            self.logger.record(f"time/{name}", value)
        area = self.logger.name_to_value.get("rollout/auc")
        found = "" if area is None else f"area {area:.3f}, "
        self.log.advance(self.state.decisions, f"{found}{rate:,.0f} steps/s, waiting {waiting:.0%}")

    def _on_training_end(self) -> None:
        check_finite(self.model.policy)
        if not self.stop and self.state.evaluated != self.state.decisions:
            self.evaluate()
        self.save()

    def clock(self) -> dict[str, Any]:
        """How far the run has come."""
        return self.state.model_dump(include=set(CLOCK))

    def save(self) -> None:
        """Write a checkpoint. Raises `NotFiniteError`."""
        returns = reward_statistics(self.model)
        self.state.returns = float(returns.mean), float(returns.var), float(returns.count)
        self.folder.save(self.model, self.state)
        if not self.folder.config.log.evaluate_buildings:
            self.keep_policy()
        self.saved_s = time.perf_counter()

    def evaluate(self) -> None:
        """Evaluate on the validation split; the best policy so far is the one that is loaded from the folder."""
        state, config = self.state, self.folder.config
        state.evaluated = state.decisions
        if not config.log.evaluate_buildings:
            return
        figures = self.figures(config.log.evaluate_buildings)
        best = figures[config.score] > state.best_score
        self.log.add_evaluation(self.clock(), figures, best)
        if best:
            state.best_score = figures[config.score]
            self.keep_policy(validation=figures)

    def keep_policy(self, **facts: Any) -> None:
        """Make the policy the one that is loaded from the folder; `facts` describe its origin."""
        facts |= {"decisions": self.state.decisions, "seconds": round(self.state.seconds)}
        save_policy(self.folder.folder, self.model.policy, self.folder.config.algorithm, facts)

    def figures(self, buildings: int) -> dict[str, float]:
        """The mean of each metric over the buildings, one episode in each, and their number `n`.

        The policy takes its most probable action; building and seed of each episode are always the same.
        """
        found: list[dict[str, float]] = []

        def collect(scope: dict[str, Any], _: dict[str, Any]) -> None:
            if scope["done"]:
                found.append(scope["info"]["figures"])

        self.validation = self.validation or make_validation(self.folder.config)
        self.validation.seed(0)
        model: Any = self.model  # of any algorithm
        masked = isinstance(model, MaskablePPO)
        evaluate_policy(model, self.validation, buildings, callback=collect, warn=False, use_masking=masked)
        return mean_of(found)

    def end(self, number: int, _: Any) -> None:
        """End the training in order after the present step; the same signal again ends it at once."""
        self.stop, name = True, "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self.log.echo(f"stopping: everything is saved after this step; {name} again ends at once")
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)

    def close(self) -> None:
        """End the workers."""
        if self.validation is not None:
            self.validation.close()


def mean_of(episodes: list[dict[str, float]]) -> dict[str, float]:
    """The means of the metrics of some episodes, the standard error of the area under the curve, and `n`."""
    means = {name: float(np.mean([episode[name] for episode in episodes])) for name in FIGURES}
    spread = float(np.std([episode["auc"] for episode in episodes])) / max(1, len(episodes) - 1) ** 0.5
    return means | {"auc_error": spread, "n": len(episodes)}


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


def warm_start(model: Any, venv: VecNormalize, config: TrainConfig, log: RunLog) -> None:
    """Let the policy imitate the teacher, and the critic learn its returns."""
    lesson = gather(config, log)
    venv.ret_rms.mean, venv.ret_rms.var = np.array(lesson["returns"].mean()), np.array(lesson["returns"].var())
    venv.ret_rms.count = float(len(lesson["returns"]))  # rewards are normalised by the returns of the teacher
    targets = torch.as_tensor(lesson.pop("returns") / np.sqrt(venv.ret_rms.var + venv.epsilon))
    actions = torch.as_tensor(lesson.pop("action"))
    tensors = {name: torch.as_tensor(values) for name, values in lesson.items()}, actions, targets
    rng = np.random.default_rng(config.seed)
    agreed, imitate = float("nan"), config.warm_start.imitate
    for _ in range(config.warm_start.epochs):
        parts = torch.as_tensor(rng.permutation(len(actions))).split(BATCH)
        agreed = float(np.mean([gradient_step(model, tensors, rows, imitate) for rows in parts]))
    log.echo(f"warm start: {len(actions):,} decisions of {config.warm_start.teacher}, agrees with {agreed:.0%}")


def gradient_step(model: Any, lesson: tuple[dict[str, Tensor], Tensor, Tensor], rows: Tensor, imitate: bool) -> float:
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


def gather(config: TrainConfig, log: RunLog) -> Lesson:
    """At least as many decisions of the teacher as configured, in complete episodes."""
    parts, held, wanted = list[Lesson](), 0, config.warm_start.decisions
    with closing(episodes(config)) as lessons:
        while held < wanted:
            parts.append(next(lessons))
            held += len(parts[-1]["action"])
            log.advance(0, f"warm start: {held:,} of {wanted:,} decisions")
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def episodes(config: TrainConfig) -> Generator[Lesson]:
    """Episodes of the teacher without end, always the same ones in the same order. Raises `WorkerDied`."""
    jobs = 1 if config.workers == "here" else max(2, min(config.environments, cores()))
    waiting, following = dict[int, Lesson](), 0
    with closing(run_units(partial(teach, config), count(), jobs)) as finished:
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
