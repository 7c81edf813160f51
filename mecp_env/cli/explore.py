"""`mecp-env explore`: one episode of a policy, option by option.

One exploration, breadth first, of which pictures, figures and paths are kept.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import tyro

from mecp_env.cli.base import Seed, Steps, check_folder, check_word
from mecp_env.cli.buildings import Reading, ReadingOptions, resolve
from mecp_env.cli.exit_codes import echo, exit_code
from mecp_env.cli.options import WithModules, check_map, named_options, save_map
from mecp_env.cli.stopwatch import Stopwatch
from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import naming, write_atomic
from mecp_env.core.se2 import compose, inverse
from mecp_env.core.settings import guess
from mecp_env.env import MecpEnv
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.trajectory import tum
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.render.curves import Moment, curves_figure, moment_of
from mecp_env.render.figures import map_figure, save
from mecp_env.render.film import Film
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.rerun_log import RerunLog
from mecp_env.render.screen import Screen, ScreenConfig
from mecp_env.render.shapes import SceneView, summary
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS
from mecp_env.wrappers import GoalActions, Step

FILES = (  # what a run leaves behind
    *("map.png", "curves.png", "run.gif", "replay.html", "belief.yaml", "belief.pgm", "belief.svg"),
    *("metrics.json", "trajectory.tum", "truth.tum", "config.json"),
)
FILM_WIDTH = 960  # px


@dataclass
class Run:
    """An exploration in progress, and what is kept of each of its steps."""

    env: MecpEnv
    seed: int
    recorder: Recorder | None = field(default_factory=Recorder)  # None: no replay
    rerun: RerunLog | None = None  # the recording of the rerun viewer, where one is wanted
    film: Film = field(default_factory=Film)
    screen: Screen | None = None  # of the film; made when the building is known
    estimated: list[Array] = field(default_factory=list)  # (3,) T_map_robot as believed, one a step
    true: list[Array] = field(default_factory=list)  # (3,) T_map_robot in truth
    moments: list[Moment] = field(default_factory=list)  # what the curves show
    ended: str = "interrupted"
    save_map: Callable[[], None] | None = None  # called by `keep` between the data and the pictures

    @property
    def steps(self) -> int:
        return max(len(self.estimated) - 1, 0)

    def explore(self, after_step: Callable[[Run], None]) -> None:
        """Explore to the end; `after_step` is called after every control step, and once before the first."""

        def look(step: Step | None = None) -> None:
            self.look(step[4] if step else None)
            after_step(self)

        policy, goals = BreadthFirst(), GoalActions(self.env, callback=look)
        observation, _ = goals.reset(seed=self.seed)
        policy.reset()
        look()
        terminated = truncated = False
        while not (terminated or truncated):
            action = policy.act(observation, goals.action_masks())
            observation, _, terminated, truncated, info = goals.step(action)
        self.ended = "complete" if terminated else "diverged" if info["diverged"] else "out of steps"

    def look(self, info: dict[str, Any] | None = None) -> None:
        """Keep what belongs to the present step."""
        view = self.env.view()
        self.estimated.append(view.slam_output.belief.T_map_robot.copy())
        self.true.append(compose(inverse(view.T_world_map), view.T_world_robot))
        self.moments.append(moment_of(view))
        if self.recorder is not None:
            self.recorder.look(view, info)
        if self.rerun is not None:
            self.rerun.look(view, info)
        self.film.offer(self.steps, lambda: self.picture(view))

    def keep(self, folder: Path, watch: Stopwatch) -> dict[str, Any]:
        """Write `FILES`, everything there is, into `folder`; returns the metrics."""
        folder.mkdir(parents=True, exist_ok=True)
        metrics = self.metrics(watch)
        self._keep_data(folder, metrics)
        self._keep_pictures(folder, self.env.view())
        return metrics

    def _keep_data(self, folder: Path, metrics: dict[str, Any]) -> None:
        """What cannot be made again from other files comes first, so that a full disk keeps it."""
        recipe = {"seed": self.seed, "policy": "breadth_first", "config": self.env.config.to_dict()}
        for name, data in (("metrics.json", metrics), ("config.json", recipe)):
            write_atomic(folder / name, (json.dumps(data, indent=2) + "\n").encode())
        for name, poses in (("trajectory.tum", self.estimated), ("truth.tum", self.true)):
            times = [step * self.env.config.robot.period_s for step in range(len(poses))]
            write_atomic(folder / name, tum(times, poses).encode())
        if self.save_map is not None:
            self.save_map()

    def _keep_pictures(self, folder: Path, view: SceneView) -> None:
        with naming(folder / "belief.pgm"):
            save_map_server(view.slam_output.grid, folder / "belief")
        with naming(folder / "belief.svg"):
            save_svg(view.slam_output.grid, folder / "belief.svg")
        with naming(folder / "map.png"):
            save(map_figure(view), folder / "map.png")
        with naming(folder / "curves.png"):
            save(curves_figure(self.title, self.env.config.robot.period_s, self.moments), folder / "curves.png")
        self.film.frames.append(self.picture(view))  # the last step, whether its turn has come or not
        with naming(folder / "run.gif"):
            self.film.save(folder / "run.gif")
        (folder / "replay.html").unlink(missing_ok=True)  # of an earlier run
        if self.recorder is not None:
            write_page(self.replay(), folder / "replay.html")

    def picture(self, view: SceneView) -> Bytes:
        """A frame of the film, whose size fits the building."""
        self.screen = self.screen or Screen(ScreenConfig.around(view.bounds, FILM_WIDTH))
        return self.screen.frame(view)

    def replay(self) -> dict[str, Any]:
        """The run as its page plays it."""
        assert self.recorder is not None
        found = ", ".join(f"{name} {value}" for name, value in summary(self.env.view().metrics))
        return self.recorder.run(self.title, f"{self.ended}: {found}")

    @property
    def title(self) -> str:
        """The building, the estimator and the seed."""
        return f"{self.env.view().title.partition(', step')[0]}, seed {self.seed}"

    def metrics(self, watch: Stopwatch) -> dict[str, Any]:
        """The figures of the run so far, measured on the truth, and its times."""
        times = {name: round(value, 1) for name, value in watch.microseconds().items()}
        speed = {"steps_per_s": round(watch.steps_per_s, 1), "us_per_period": times}
        return {"ended": self.ended, **self.env.summary(), **speed}


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

        from mecp_env.cli.options import end_rerun, rerun_log
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
    from mecp_env.policies.registry import KINDS

    where = f"no goal in row {row}"
    if row < len(goals):
        where = f"{KINDS[goals.kind[row]]} of room {goals.room[row]}, {goals.path_m[row]:.1f} m away"
    result = f"{info['event']} after {info['periods']} steps"
    return f"{where:44s}{result:28s}{info['coverage']:7.1%} seen {info['metres']:7.1f} m driven"


def end_line(terminated: bool, info: Mapping[str, Any]) -> str:
    """How the episode ended."""
    reason = "no goal is left" if terminated else "the filter diverged" if info["diverged"] else "out of steps"
    return f"{reason} after {info['period']} control steps"
