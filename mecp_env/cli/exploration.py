"""One exploration, breadth first, of which pictures, figures and paths are kept."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.cli.stopwatch import Stopwatch
from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.core.se2 import compose, inverse
from mecp_env.env import MecpEnv
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.render.figures import map_figure, save
from mecp_env.render.film import Film
from mecp_env.render.screen import Screen, ScreenConfig
from mecp_env.render.view import SceneView
from mecp_env.wrappers import GoalActions

Array = NDArray[np.float64]

FILES = (  # what a run leaves behind
    *("map.png", "run.gif", "belief.yaml", "belief.pgm", "belief.svg"),
    *("metrics.json", "trajectory.tum", "truth.tum", "config.json"),
)
FILM_SIZE = ScreenConfig(width_px=960, height_px=430)


@dataclass
class Run:
    """An exploration in progress, and what is kept of each of its steps."""

    env: MecpEnv
    seed: int
    film: Film = field(default_factory=Film)
    screen: Screen = field(default_factory=lambda: Screen(FILM_SIZE))
    estimated: list[Array] = field(default_factory=list)  # (3,) T_map_robot as believed, one a step
    true: list[Array] = field(default_factory=list)  # (3,) T_map_robot in truth
    ended: str = "interrupted"

    @classmethod
    def begin(cls, config: EnvConfig, seed: int, render_mode: str | None = None) -> Run:
        """A run at its first observation. Raises `ConfigError` for a negative seed, as for a wrong configuration."""
        if seed < 0:
            raise ConfigError(f"seed: {seed}, at least 0")
        return cls(MecpEnv(config, render_mode), seed)

    @property
    def steps(self) -> int:
        return max(len(self.estimated) - 1, 0)

    def explore(self, after_step: Callable[[Run], None]) -> None:
        """Explore to the end; `after_step` is called after every control step, and once before the first."""

        def look(*_: Any) -> None:
            self.look()
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

    def look(self) -> None:
        """Keep what belongs to the present step."""
        view = self.env.view()
        self.estimated.append(view.slam_output.belief.T_map_robot.copy())
        self.true.append(compose(inverse(view.T_world_map), view.T_world_robot))
        self.film.offer(self.steps, lambda: self.screen.frame(view))

    def keep(self, folder: Path, watch: Stopwatch) -> dict[str, Any]:
        """Write `FILES`, everything there is, into `folder`; returns the metrics."""
        folder.mkdir(parents=True, exist_ok=True)
        view, metrics = self.env.view(), self.metrics(watch)
        save(map_figure(view), folder / "map.png")
        self._film_end(view)
        self.film.save(folder / "run.gif")
        save_map_server(view.slam_output.grid, folder / "belief")
        save_svg(view.slam_output.grid, folder / "belief.svg")
        (folder / "metrics.json").write_text(json.dumps(metrics, indent=2) + "\n")
        (folder / "config.json").write_text(json.dumps(self._recipe(), indent=2) + "\n")
        period_s = self.env.config.robot.period_s
        (folder / "trajectory.tum").write_text(tum(self.estimated, period_s))
        (folder / "truth.tum").write_text(tum(self.true, period_s))
        return metrics

    def metrics(self, watch: Stopwatch) -> dict[str, Any]:
        """The figures of the run so far, measured on the truth, and its times."""
        times = {name: round(value, 1) for name, value in watch.microseconds().items()}
        return {
            "ended": self.ended,
            **self.env.summary(),
            "steps_per_s": round(watch.steps_per_s, 1),
            "us_per_period": times,
        }

    def _film_end(self, view: SceneView) -> None:
        """The film ends with the last step, whether its turn has come or not."""
        self.film.frames.append(self.screen.frame(view))

    def _recipe(self) -> dict[str, Any]:
        return {"seed": self.seed, "policy": "breadth_first", "config": self.env.config.to_dict()}


def tum(poses: list[Array], period_s: float) -> str:
    """Poses (3,) as lines `time x y z qx qy qz qw`, the format that `evo` reads."""
    lines = ["# time x y z qx qy qz qw (s, m, quaternion), map frame"]
    for step, (x, y, heading) in enumerate(poses):
        turn = f"0 0 {math.sin(heading / 2):.9f} {math.cos(heading / 2):.9f}"
        lines.append(f"{step * period_s:.3f} {x:.6f} {y:.6f} 0 {turn}")
    return "\n".join(lines) + "\n"
