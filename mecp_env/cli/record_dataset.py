"""`mecp-env record-dataset`: episodes of a policy as a Minari dataset."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

import tyro
from pydantic import Field

from mecp_env.cli.base import Seed, Steps, check_folder, check_word
from mecp_env.cli.exit_codes import INTERRUPTED, echo, print_error
from mecp_env.cli.options import WithModules, named_options
from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS

Observation = Literal["flat", "dict", "image"]
Actions = Literal["own", "velocity"]
FOLDER = "MINARI_DATASETS_PATH"  # of minari; without it, .minari/datasets in the home folder


@dataclass(frozen=True)
class RecordDataset(WithModules):
    """Record episodes of a policy as a Minari dataset, one building per episode. A policy is random_goal,
    random_walk, bfs, nearest, gain, maskable_ppo, the folder of a training run, or a custom class as module:Class."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env record-dataset bfs --episodes 100",
        "mecp-env record-dataset gain --actions velocity --difficulty easy",
        "mecp-env record-dataset maskable_ppo --observation dict --out runs/datasets",
        "mecp-env record-dataset nearest --task ActiveHalls-v0 --name my/halls-v0",
    )
    choices: ClassVar[Mapping[str, Sequence[str]]] = {
        "--observation": get_args(Observation),
        "--actions": get_args(Actions),
    }

    policy: Annotated[str, tyro.conf.Positional]
    observation: Observation = "flat"  # format of the observations (docs/observations.md)
    actions: Actions = "own"  # velocity: every control step of a policy that selects goals
    episodes: Annotated[int, Field(ge=1, le=1_000_000)] = 20
    seed: Seed = 0  # number of the first building, and seed of its start and noise; the next ones follow
    difficulty: str = "medium"  # easy, medium, hard or huge
    split: str = "train"  # of the buildings: train, validation or test
    task: str = ""  # a task of active SLAM in place of a difficulty: ActiveHalls-v0, ActiveCorridors-v0, ...
    estimator: Literal["slam", "known", "truth"] = "slam"
    max_steps: Steps = 3000  # control steps of 0.4 s per episode, at most
    name: str = ""  # id of the dataset, as my/rooms-v0; by default from the options
    out: Path | None = None  # folder of the datasets; by default that of minari
    trust: bool = False  # load a model file of Stable-Baselines3 (.zip), which may run arbitrary code

    keeps_results = True

    def check(self, line: Sequence[str]) -> None:
        """Raise `ConfigError` for an unknown word, and for a difficulty beside a task."""
        check_word("difficulty", self.difficulty, DIFFICULTIES)
        check_word("split", self.split, SPLITS)
        if self.task:
            check_word("task", self.task, TASKS)
        if self.task and "difficulty" in named_options(line):
            raise ConfigError(f"--difficulty {self.difficulty}: --task {self.task} fixes it; leave out one of the two")

    def run(self, line: Sequence[str]) -> int:
        """Record the episodes; after Ctrl-C the dataset has those that were finished."""
        from mecp_env.policies.recording import DatasetWriter, Recording, default_name
        from mecp_env.policies.registry import make_policy
        from mecp_env.policies.setting import Setting

        if self.out is not None:
            os.environ[FOLDER] = str(check_folder(self.out).absolute())
        setting = Setting(self.difficulty, self.split, self.estimator, self.max_steps, self.task)
        policy = make_policy(self.policy, self.trust)
        recording = Recording(policy, setting, self.observation, "" if self.actions == "own" else self.actions)
        name = self.name or default_name(self.policy, recording)
        writer = DatasetWriter(name, recording, self.policy)
        code = 0
        try:
            for done, rows in enumerate(recording.episodes(self.seed, self.episodes), start=1):
                writer.add(rows)
                last = rows.infos[-1]
                echo(f"{done:6d} of {self.episodes}: {len(rows.actions):5d} actions, {last['coverage']:7.1%} seen")
        except KeyboardInterrupt:
            print_error("interrupted")
            code = INTERRUPTED
        if writer.dataset is not None:
            count, steps = writer.dataset.total_episodes, writer.dataset.total_steps
            echo(f"{name}: {count} episodes, {steps} actions in {writer.path}")
        return code
