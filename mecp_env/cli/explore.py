"""The commands `explore` and `record-dataset`: episodes of a policy, option by option, or as a Minari dataset."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro
from pydantic import Field

from mecp_env.cli.base import INTERRUPTED, Line, Seed, Steps, check_folder, echo, print_error
from mecp_env.cli.options import DifficultyName, Estimator, KeepsMap, ReadsPlans, SplitName, TaskName, WithModules
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess
from mecp_env.episode.tasks import TASKS
from mecp_env.world.config import DIFFICULTIES, SPLITS

FOLDER = "MINARI_DATASETS_PATH"  # of minari; without it, .minari/datasets in the home folder
EXPECTED = "expected DIFFICULTY:SPLIT:NUMBER, such as medium:test:3, or a task in place of the difficulty"


@dataclass(frozen=True)
class Explore(KeepsMap, ReadsPlans):
    """Explore one building with a policy, and print every drive and the metrics. A policy is bfs, nearest,
    next_best_view, gain, pause, returning, stachniss, random_goal, random_walk, maskable_ppo, the folder of a training
    run, or a custom class as module:Class.

    Examples:
        mecp-env explore gain --layout office
        mecp-env explore gain --difficulty hard --seed 3
        mecp-env explore maskable_ppo --layout medium:test:3 --start random
        mecp-env explore pause --layout ActiveHalls-v0:validation:0 --replay runs/halls
        mecp-env explore nearest --layout office --save-map office.zip
        mecp-env explore runs/my-training --layout hard:7 --estimator truth
    """

    fixes: ClassVar[Mapping[str, Sequence[str]]] = {"layout": ("difficulty", "task"), "task": ("difficulty",)}
    needs: ClassVar[Mapping[str, Sequence[str]]] = {"split": ("difficulty", "task")}

    policy: Annotated[str, tyro.conf.Positional]
    # a shipped name, DIFFICULTY:SEED, DIFFICULTY:SPLIT:NUMBER, TASK:SPLIT:NUMBER, or the path of a plan
    layout: str = "paper"
    # easy, medium, hard or huge, in place of --layout: the building with the number of --seed
    difficulty: DifficultyName = ""
    task: TaskName = ""  # a task of active SLAM in place of a difficulty: ActiveHalls-v0, ActiveCorridors-v0, ...
    split: SplitName = "test"  # of these buildings: train, validation or test
    seed: Seed = 0  # of start, noise and policy
    steps: Steps | None = None  # control steps of 0.4 s, at most; by default 3000, in a task 1500
    estimator: Estimator = "slam"  # known: known correspondences; truth: ground-truth pose
    # random: anywhere in free space; by default layout, in a task random
    start: Literal["layout", "random"] | None = None
    replay: Path | None = None  # folder for the page that plays the episode
    trust: bool = False  # load a model file of Stable-Baselines3 (.zip), which may run arbitrary code

    def run(self, line: Line) -> int:
        """Run the episode; one line per drive, then the metrics."""
        import gymnasium as gym

        from mecp_env.policies.registry import calls_of, make_policy
        from mecp_env.policies.rollout import masks_of, options_of
        from mecp_env.wrappers import EveryStep, RecordReplay

        building, options = self._building()
        self.check_map(self.layout, self.estimator)
        policy = make_policy(self.policy, self.trust)
        given = {"max_steps": self.steps, "start": self.start}
        fields = options_of(policy) | {name: value for name, value in given.items() if value is not None}
        env = gym.make(**building, estimator=self.estimator, **fields)
        recording = self.recording(env.get_wrapper_attr("config").robot.period_s)
        env = env if recording is None else EveryStep(env, recording.look)
        env = env if self.replay is None else RecordReplay(env, check_folder(self.replay, "--replay"))
        observation, info = env.reset(seed=self.seed, options=options)
        with calls_of(self.policy):
            policy.reset(self.seed)
        masks = masks_of(env)
        base: Any = env.unwrapped
        terminated = truncated = False
        while not (terminated or truncated):
            mask, goals = masks(), dict(zip(base.goal_actions.tolist(), base.goals.rows(len(base.goals)), strict=True))
            with calls_of(self.policy):
                action = policy.act(observation, mask)
                observation, _, terminated, truncated, info = env.step(action)
            if policy.actions == "goal":
                echo(drive_line(goals, int(action), info))
        echo("", end_line(terminated, info), "")
        echo(*(f"{name:26s}{value:10.4g}" for name, value in env.get_wrapper_attr("summary")().items()))
        code = self.keep_map(env.unwrapped)
        env.close()
        self.end_recording(recording)
        return code

    def _building(self) -> tuple[dict[str, Any], dict[str, int] | None]:
        """The id of the environment with the building that it makes, and the options of its reset.

        Raises `ConfigError` or `LayoutError`.
        """
        buildings = self.task or self.difficulty
        place = f"{buildings}:{self.split}:{self.seed}" if buildings else self.layout
        if place.count(":") != 2:
            return {"id": "mecp_env/Layout-v0", "layout": self.reading.resolve(place)}, None
        return self._generated(*place.split(":"))

    def _generated(self, difficulty: str, split: str, number: str) -> tuple[dict[str, Any], dict[str, int] | None]:
        """As `_building`, of a generated building."""
        known = {difficulty: (*DIFFICULTIES, *TASKS), split: SPLITS}
        wrong = [guess(word, words) for word, words in known.items() if word not in words]
        if wrong or not number.isdecimal():
            raise ConfigError(f"layout: {self.layout!r:.80}, {EXPECTED}{''.join(wrong[:1])}")
        rooms = {"id": "mecp_env/Rooms-v0", "difficulty": difficulty}
        made = {"id": f"mecp_env/{difficulty}"} if difficulty in TASKS else rooms
        return made | {"split": split}, {"building": int(number)}


def drive_line(goals: Mapping[int, Any], row: int, info: Mapping[str, Any]) -> str:
    """The result of a drive to a goal, of those that there were when it was chosen, by their row."""
    from mecp_env.policies.registry import KINDS

    where = f"no goal in row {row}"
    if row in goals:
        where = f"{KINDS[goals[row].kind]} of room {goals[row].room}, {goals[row].path_m:.1f} m away"
    result = f"{info['event']} after {info['periods']} steps"
    return f"{where:44s}{result:28s}{info['coverage']:7.1%} seen {info['metres']:7.1f} m driven"


def end_line(terminated: bool, info: Mapping[str, Any]) -> str:
    """How the episode ended."""
    reason = "no goal is left" if terminated else "the filter diverged" if info["diverged"] else "out of steps"
    return f"{reason} after {info['period']} control steps"


@dataclass(frozen=True)
class RecordDataset(WithModules):
    """Record episodes of a policy as a Minari dataset, one building per episode. A policy is random_goal,
    random_walk, bfs, nearest, gain, maskable_ppo, the folder of a training run, or a custom class as module:Class.

    Examples:
        mecp-env record-dataset bfs --episodes 100
        mecp-env record-dataset gain --actions velocity --difficulty easy
        mecp-env record-dataset maskable_ppo --observation dict --out runs/datasets
        mecp-env record-dataset nearest --task ActiveHalls-v0 --name my/halls-v0
    """

    fixes: ClassVar[Mapping[str, Sequence[str]]] = {"task": ("difficulty",)}

    policy: Annotated[str, tyro.conf.Positional]
    observation: Literal["flat", "dict", "image"] = "flat"  # format of the observations (docs/observations.md)
    actions: Literal["own", "velocity"] = "own"  # velocity: every control step of a policy that selects goals
    episodes: Annotated[int, Field(ge=1, le=1_000_000)] = 20
    seed: Seed = 0  # number of the first building, and seed of its start and noise; the next ones follow
    difficulty: DifficultyName = "medium"  # easy, medium, hard or huge
    split: SplitName = "train"  # of the buildings: train, validation or test
    task: TaskName = ""  # a task of active SLAM in place of a difficulty: ActiveHalls-v0, ActiveCorridors-v0, ...
    estimator: Estimator = "slam"
    max_steps: Steps = 3000  # control steps of 0.4 s per episode, at most
    name: str = ""  # id of the dataset, as my/rooms-v0; by default from the options
    out: Path | None = None  # folder of the datasets; by default that of minari
    trust: bool = False  # load a model file of Stable-Baselines3 (.zip), which may run arbitrary code

    def run(self, line: Line) -> int:
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
