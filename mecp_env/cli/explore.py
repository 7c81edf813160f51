"""`mecp-env explore`: one episode of a policy, option by option."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import tyro

from mecp_env.cli.base import Seed, Steps, check_folder, check_word
from mecp_env.cli.buildings import Reading, ReadingOptions, resolve
from mecp_env.cli.exit_codes import echo, exit_code
from mecp_env.cli.fields import named_options
from mecp_env.cli.map_option import check_map, save_map
from mecp_env.cli.with_option import WithModules
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess
from mecp_env.episode.tasks import TASKS
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS

Estimator = Literal["slam", "known", "truth"]
Start = Literal["layout", "random"]
EXPECTED = "expected DIFFICULTY:SPLIT:NUMBER, such as medium:test:3, or a task in place of the difficulty"


@dataclass(frozen=True)
class Explore(WithModules):
    """Explore one building with a policy, and print every drive and the metrics. A policy is bfs, nearest,
    next_best_view, gain, pause, returning, stachniss, random_goal, random_walk, maskable_ppo, the folder of a training
    run, or a custom class as module:Class."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env explore gain --layout office",
        "mecp-env explore gain --difficulty hard --seed 3",
        "mecp-env explore maskable_ppo --layout medium:test:3 --start random",
        "mecp-env explore pause --layout ActiveHalls-v0:validation:0 --replay runs/halls",
        "mecp-env explore nearest --layout office --save-map office.zip",
        "mecp-env explore runs/my-training --layout hard:7 --estimator truth",
    )
    choices: ClassVar[Mapping[str, Sequence[str]]] = {"--estimator": get_args(Estimator), "--start": get_args(Start)}

    policy: Annotated[str, tyro.conf.Positional]
    # a shipped name, DIFFICULTY:SEED, DIFFICULTY:SPLIT:NUMBER, TASK:SPLIT:NUMBER, or the path of a plan
    layout: str = "paper"
    difficulty: str = ""  # easy, medium, hard or huge, in place of --layout: the building with the number of --seed
    task: str = ""  # a task of active SLAM in place of a difficulty: ActiveHalls-v0, ActiveCorridors-v0, ...
    split: str = "test"  # of these buildings: train, validation or test
    seed: Seed = 0  # of start, noise and policy
    steps: Steps | None = None  # control steps of 0.4 s, at most; by default 3000, in a task 1500
    estimator: Estimator = "slam"  # known: known correspondences; truth: ground-truth pose
    start: Start | None = None  # random: anywhere in free space; by default layout, in a task random
    replay: Path | None = None  # folder for the page that plays the episode
    rerun: Path | None = None  # file for a recording of the rerun viewer (.rrd)
    save_map: Path | None = None  # file for the robot's map, which the estimator can localise in (a .zip)
    reading: ReadingOptions = field(default_factory=Reading)
    trust: bool = False  # load a model file of Stable-Baselines3 (.zip), which may run arbitrary code

    def check(self, line: Sequence[str]) -> None:
        """Raise `ConfigError` for two options that select the building, and for an unknown word."""
        named = named_options(line)
        ways = [name for name in ("layout", "difficulty", "task") if name in named]
        if len(ways) > 1:
            raise ConfigError(f"--{ways[1]}: --{ways[0]} selects the building, too; leave out one of the two")
        for name, known in (("difficulty", DIFFICULTIES), ("task", TASKS), ("split", SPLITS)):
            if name in named:
                check_word(name, getattr(self, name), known)
        if "split" in named and not {"difficulty", "task"} & named:
            raise ConfigError(f"--split {self.split}: of the buildings of --difficulty or --task; name one")

    @property
    def keeps_results(self) -> bool:
        return any(path is not None for path in (self.replay, self.rerun, self.save_map))

    def run(self, line: Sequence[str]) -> int:
        """Run the episode; one line per drive, then the metrics."""
        import gymnasium as gym

        from mecp_env.cli.rerun_option import end_rerun, rerun_log
        from mecp_env.policies.registry import calls_of, make_policy
        from mecp_env.policies.rollout import masks_of, options_of
        from mecp_env.wrappers import EveryStep, RecordReplay

        building, options = self._building()
        check_map(self.save_map, self.layout, self.estimator)
        policy = make_policy(self.policy, self.trust)
        given = {"max_steps": self.steps, "start": self.start}
        fields = {name: value for name, value in given.items() if value is not None} | options_of(policy)
        env = gym.make(**building, estimator=self.estimator, **fields)
        recording = rerun_log(self.rerun, env.get_wrapper_attr("config").robot.period_s)
        env = env if recording is None else EveryStep(env, recording.look)
        env = env if self.replay is None else RecordReplay(env, check_folder(self.replay, "--replay"))
        observation, info = env.reset(seed=self.seed, options=options)
        with calls_of(self.policy):
            policy.reset(self.seed)
        masks = masks_of(env)
        base: Any = env.unwrapped
        terminated = truncated = False
        while not (terminated or truncated):
            mask, goals = masks(), base.goals
            with calls_of(self.policy):
                action = policy.act(observation, mask)
            observation, _, terminated, truncated, info = env.step(action)
            if policy.actions == "goal":
                echo(drive_line(goals, int(action), info))
        echo("", end_line(terminated, info), "")
        echo(*(f"{name:26s}{value:10.4g}" for name, value in env.get_wrapper_attr("summary")().items()))
        saved = save_map(env.unwrapped, self.save_map)
        env.close()
        end_rerun(recording, self.rerun)
        return exit_code(0, saved)

    def _building(self) -> tuple[dict[str, Any], dict[str, int] | None]:
        """The id of the environment with the building that it makes, and the options of its reset.

        Raises `ConfigError` or `LayoutError`.
        """
        buildings = self.task or self.difficulty
        place = f"{buildings}:{self.split}:{self.seed}" if buildings else self.layout
        if place.count(":") != 2:
            return {"id": "mecp_env/Layout-v0", "layout": resolve(place, self.reading)}, None
        return self._generated(*place.split(":"))

    def _generated(self, difficulty: str, split: str, number: str) -> tuple[dict[str, Any], dict[str, int] | None]:
        """As `_building`, of a generated building."""
        for word, known in ((difficulty, (*DIFFICULTIES, *TASKS)), (split, SPLITS)):
            if word not in known:
                raise ConfigError(f"layout: {self.layout!r:.80}, {EXPECTED}{guess(word, known)}")
        if not number.isdecimal():
            raise ConfigError(f"layout: {self.layout!r:.80}, {EXPECTED}")
        rooms = {"id": "mecp_env/Rooms-v0", "difficulty": difficulty}
        buildings = {"id": f"mecp_env/{difficulty}"} if difficulty in TASKS else rooms
        return buildings | {"split": split}, {"building": int(number)}


def drive_line(goals: Any, row: int, info: Mapping[str, Any]) -> str:
    """The result of a drive to a goal, of the environment's `Goals` when it was chosen."""
    from mecp_env.policies.policy import KINDS

    where = f"no goal in row {row}"
    if row < len(goals):
        where = f"{KINDS[goals.kind[row]]} of room {goals.room[row]}, {goals.path_m[row]:.1f} m away"
    result = f"{info['event']} after {info['periods']} steps"
    return f"{where:44s}{result:28s}{info['coverage']:7.1%} seen {info['metres']:7.1f} m driven"


def end_line(terminated: bool, info: Mapping[str, Any]) -> str:
    """How the episode ended."""
    reason = "no goal is left" if terminated else "the filter diverged" if info["diverged"] else "out of steps"
    return f"{reason} after {info['period']} control steps"
