"""One exploration, breadth first, of which pictures, figures and paths are kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mecp_env.cli.stopwatch import Stopwatch
from mecp_env.core.array_types import Array, Bytes
from mecp_env.core.paths import naming, write_atomic
from mecp_env.core.se2 import compose, inverse
from mecp_env.env import MecpEnv
from mecp_env.evaluation.trajectory import tum
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.render.curves import Moment, curves_figure, moment_of
from mecp_env.render.figures import map_figure, save
from mecp_env.render.film import Film
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.rerun_log import RerunLog
from mecp_env.render.screen import Screen, ScreenConfig
from mecp_env.render.view import SceneView, summary
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
