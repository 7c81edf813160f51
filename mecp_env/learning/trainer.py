"""A training run: from its configuration to its folder, in the rhythm of PPO's updates."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any, Self

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from mecp_env.learning import files, models
from mecp_env.learning.checkpoints import Progress
from mecp_env.learning.environments import FIGURES, make_many
from mecp_env.learning.models import DriveBuffer
from mecp_env.learning.report import Report
from mecp_env.learning.run_folder import RunFolder
from mecp_env.learning.validation import Validation
from mecp_env.learning.warm_start import imitate

LOSSES = {  # of Stable-Baselines3 -> in our tables
    "train/policy_gradient_loss": "policy_loss",
    "train/value_loss": "value_loss",
    "train/entropy_loss": "entropy_loss",
    "train/approx_kl": "kl",
    "train/clip_fraction": "clip_fraction",
    "train/explained_variance": "explained_variance",
    "train/learning_rate": "learning_rate",
}
MEAN_DRIVE_DISCOUNT = 0.93  # about what a drive is discounted by: only for the scale of the rewards


class Trainer:
    """Environments, algorithm and files of a run; a context manager that ends its workers."""

    def __init__(self, folder: RunFolder, report: Report) -> None:
        self.config, self.folder, self.report = folder.config, folder, report
        self.stop = False
        self.progress = Progress()
        self.saved_s = time.perf_counter()
        self.episodes: list[dict[str, float]] = []

    def __enter__(self) -> Self:
        config = self.config
        models.use_threads(config.threads)
        self.timed = make_many(config, config.seed)
        drives = config.algorithm == "maskable_ppo"
        self.venv = VecNormalize(
            self.timed,
            norm_obs=False,
            norm_reward=config.ppo.normalise_reward,
            gamma=MEAN_DRIVE_DISCOUNT if drives else config.ppo.discount,
        )
        self.model = models.make_model(config, self.venv, config.seed)
        self.model.set_logger(Logger(None, []))
        self.validation = Validation(config)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.validation.close()
        self.venv.close()

    def resume(self) -> bool:
        """Go on from the newest checkpoint; False when there is none yet. Raises `WeightError`."""
        found = self.folder.checkpoints.load(self.model)
        if found is None:
            return False
        self.progress = found
        self.venv.ret_rms.mean = np.array(found.return_mean)
        self.venv.ret_rms.var, self.venv.ret_rms.count = np.array(found.return_var), found.return_count
        self.venv.seed(int(np.random.SeedSequence([self.config.seed, found.decisions]).generate_state(1)[0]) // 2)
        return True

    def run(self) -> None:
        """Train to the end, or until `stop`; then everything is saved. A warm start counts when it is whole."""
        self.report.begin(self.progress.decisions)
        if not self.warmed_up():
            self.report.say("nothing is saved yet: a warm start is whole or begins again")
            return
        left = self.config.steps - self.progress.decisions
        rhythm = Rhythm(self)
        if left > 0:
            self.model.learn(left, callback=rhythm, reset_num_timesteps=False)
            rhythm.between()
        if not self.stop and self.progress.evaluated != self.progress.decisions:
            self.evaluate()
        self.save()

    def warmed_up(self) -> bool:
        """Imitate the teacher, if there is one and the run begins; False when that was stopped."""
        if self.progress.decisions or not self.config.warm_start.teacher:
            return True
        return imitate(self.model, self.venv, self.config, self.report, lambda: self.stop)

    def note(self, rewards: np.ndarray, infos: list[dict[str, Any]]) -> bool:
        """Take in a decision of every environment, before it is learned from; False when it is time to stop."""
        if isinstance(self.model.rollout_buffer, DriveBuffer):
            self.model.rollout_buffer.coming = np.array([info["discount"] for info in infos], np.float32)
            models.value_cut_off(self.model.policy, rewards, infos)
        self.progress.steps += sum(info["periods"] for info in infos)
        ended = [info["figures"] for info in infos if "figures" in info]
        self.episodes += ended
        self.progress.episodes += len(ended)
        self.progress.decisions = self.model.num_timesteps
        self.report.advance(self.progress.decisions)
        return not self.stop

    def update(self, seconds: float, waited_s: float, steps: int) -> None:
        """Write down what the last update came to. Raises `NotFiniteError`."""
        files.check_finite(self.model.policy)
        self.progress.seconds += seconds
        self.progress.updates = self.model._n_updates
        speed = {"periods_per_s": steps / seconds, "waiting_share": waited_s / seconds}
        losses = {ours: self.model.logger.name_to_value[theirs] for theirs, ours in LOSSES.items()}
        means = {name: float(np.mean([e[name] for e in self.episodes])) for name in FIGURES if self.episodes}
        self.report.row(self.progress, speed | losses | means)
        self.episodes = []

    def evaluate_when_due(self) -> None:
        """Evaluate when enough decisions were made since the last time."""
        if self.progress.decisions >= self.progress.next_evaluation:
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the policy; the best one so far is what is loaded from the folder."""
        progress = self.progress
        progress.next_evaluation = progress.decisions + self.config.log.evaluate_every
        progress.evaluated = progress.decisions
        if not self.config.log.evaluate_buildings:
            return
        figures = self.validation.run(self.model.policy)
        best = figures["auc"] > progress.best_score
        self.report.evaluation(progress, figures, best)
        if best:
            progress.best_score = figures["auc"]
            self.keep({"validation": figures})

    def keep(self, facts: dict[str, Any]) -> None:
        """Make this policy the one that is loaded from the folder."""
        facts = facts | {"decisions": self.progress.decisions, "seconds": round(self.progress.seconds)}
        self.folder.keep_policy(self.model.policy, facts)

    def save_when_due(self) -> None:
        """Write a checkpoint when the last one is old enough."""
        if time.perf_counter() - self.saved_s >= self.config.log.checkpoint_s:
            self.save()

    def save(self) -> None:
        """Write a checkpoint."""
        returns = self.venv.ret_rms
        self.progress.return_mean, self.progress.return_var = float(returns.mean), float(returns.var)
        self.progress.return_count = float(returns.count)
        self.folder.checkpoints.save(self.model, self.progress)
        self.saved_s = time.perf_counter()
        if not self.config.log.evaluate_buildings:
            self.keep({})


class Rhythm(BaseCallback):
    """Calls the trainer at every decision, and between two updates."""

    def __init__(self, trainer: Trainer) -> None:
        super().__init__()
        self.trainer = trainer
        self.begun_s: float | None = None
        self.waited_s, self.steps = 0.0, 0

    def _on_step(self) -> bool:
        return self.trainer.note(self.locals["rewards"], self.locals["infos"])

    def _on_rollout_start(self) -> None:
        self.between()

    def between(self) -> None:
        """After an update: write down, evaluate, save; the clock of the training stands still meanwhile."""
        trainer, timed = self.trainer, self.trainer.timed
        if self.begun_s is not None and timed.steps > self.steps:
            seconds = time.perf_counter() - self.begun_s
            trainer.update(seconds, timed.waited_s - self.waited_s, timed.steps - self.steps)
        if not trainer.stop:
            trainer.evaluate_when_due()
        trainer.save_when_due()
        self.begun_s, self.waited_s, self.steps = time.perf_counter(), timed.waited_s, timed.steps
