"""Training with Stable-Baselines3: from a configuration to a run folder."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecNormalize

from mecp_env.core import processes
from mecp_env.learning import models
from mecp_env.learning.callbacks import EvaluationCallback, OptionCallback, SafeCheckpointCallback, StatisticsCallback
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.curves import draw_training
from mecp_env.learning.environments import make_env, make_many
from mecp_env.learning.files import TrainingState
from mecp_env.learning.run_folder import RunFolder, RunLog
from mecp_env.learning.warm_start import check_teacher, warm_start

AT_ONCE: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
MEAN_OPTION_DISCOUNT = 0.93  # about the mean discount of an option: only for the scale of the rewards


def train(config: TrainConfig, folder: Path, resume: bool = False) -> bool:
    """Train in a folder, or continue the run there: True at its end, False after Ctrl-C or SIGTERM, which save all.

    Raises `ConfigError` before anything is written, `WorkerDied`, and `NotFiniteError`.
    """
    check(config)
    with closing(RunFolder(folder, config)) as run_folder:
        run_folder.resume() if resume else run_folder.start()
        log = RunLog(folder, config.steps, config.log.tensorboard)
        with TrainingRun(run_folder, log) as run, log, stopped_in_order(run):  # the log starts threads after the forks
            done = run.train(resume)
        draw_training(folder)
        return done


def check(config: TrainConfig) -> None:
    """Raise `ConfigError` for a configuration that cannot be trained."""
    check_teacher(config)
    models.check_size(config)
    for index in range(len(config.buildings.difficulty)):
        make_env(config, index).close()


class TrainingRun:
    """Environments, algorithm and callbacks of a run; a context manager that ends its workers."""

    def __init__(self, folder: RunFolder, log: RunLog) -> None:
        self.config, self.folder, self.log = folder.config, folder, log
        self.state = TrainingState()

    def __enter__(self) -> Self:
        config = self.config
        torch.set_num_threads(1)  # several meet at the end of every operation: slower where a core is shared
        timed = make_many(config, config.seed)
        gamma = MEAN_OPTION_DISCOUNT if config.actions == "goal" else config.ppo.discount
        self.venv = VecNormalize(timed, norm_obs=False, norm_reward=config.ppo.normalise_reward, gamma=gamma)
        self.model = models.make_model(config, self.venv, config.seed)
        processes.keep()  # of an update; the workers are not meant
        self.statistics = StatisticsCallback(self.state, self.log, timed)
        self.evaluation = EvaluationCallback(self.folder, self.log, self.statistics)
        return self

    def __exit__(self, *_: object) -> None:
        self.evaluation.close()
        self.venv.close()

    def resume(self) -> None:
        """Continue from the newest checkpoint, if there is one. Raises `WeightError`."""
        found = self.folder.checkpoints.load(self.model, self.log.echo)
        if found is None:
            self.log.echo("resumed from the beginning: no checkpoint yet")
            return
        self.state = self.statistics.state = found
        returns = self.venv.ret_rms
        returns.mean, returns.var = np.array(found.return_mean), np.array(found.return_var)
        returns.count = found.return_count
        self.venv.seed(int(np.random.SeedSequence([self.config.seed, found.decisions]).generate_state(1)[0]) // 2)
        self.log.echo(f"resumed after {found.decisions:,} decisions")

    def train(self, resume: bool) -> bool:
        """Train to the end, or until `stop`; then everything is saved. An interrupted warm start is not."""
        if resume:
            self.resume()
        self.log.start(self.state.decisions)
        self.model.set_logger(self.log.training)
        teacher = self.config.warm_start.teacher and not self.state.decisions
        if teacher and not warm_start(self.model, self.venv, self.config, self.log, lambda: self.statistics.stop):
            self.log.echo("nothing is saved yet: an interrupted warm start starts again")
            return False
        saving = SafeCheckpointCallback(self.folder, self.venv, self.statistics)
        callbacks = [OptionCallback(), self.statistics, self.evaluation, saving]
        left = max(0, self.config.steps - self.state.decisions)
        self.model.learn(left, callback=callbacks, reset_num_timesteps=False)
        return not self.statistics.stop


@contextmanager
def stopped_in_order(run: TrainingRun) -> Iterator[None]:
    """Within it Ctrl-C or SIGTERM, as of a cluster's scheduler, ends the run in order; a second one ends it at once."""

    def stop(number: int, frame: Any) -> None:
        run.statistics.stop = True
        name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        run.log.echo(f"stopping: everything is saved after this step; {name} again ends at once")
        signal.signal(number, AT_ONCE[signal.Signals(number)])

    before = {number: signal.signal(number, stop) for number in AT_ONCE}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
