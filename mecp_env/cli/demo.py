"""`mecp-env demo`: explore a building and keep what there is to see."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from mecp_env.cli.base import Seed, check_folder
from mecp_env.cli.buildings import Reading, ReadingOptions
from mecp_env.cli.exit_codes import INTERRUPTED, exit_code
from mecp_env.cli.options import Fields, WithModules, configuration


@dataclass(frozen=True)
class Demo(WithModules):
    """Explore a building by the robot's own map, breadth first; keep pictures, figures and paths."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env demo --layout two_rooms",
        "mecp-env demo --layout office --seed 3 --render human",
        "mecp-env demo --layout hard:7",
        "mecp-env demo --layout scan.png --resolution-m 0.05 --free-above 230",
        "mecp-env demo --config.slam.filter.kind ekf --out runs/ekf",
        "mecp-env demo --config.laser.preset urg04lx --config.odometry.preset turtlebot",
    )

    layout: str = "paper"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a plan
    seed: Seed = 0  # the same seed gives the same run
    render: Literal["none", "human"] = "none"  # human: watch it in a window
    out: Path | None = None  # folder for what is kept; default: runs/LAYOUT-SEED
    replay: bool = True  # keep the page that plays the run in a browser
    rerun: Path | None = None  # file for a recording of the rerun viewer (.rrd)
    save_map: Path | None = None  # file for the robot's map, which the estimator can localise in (a .zip)
    reading: ReadingOptions = field(default_factory=Reading)
    config: Fields = field(default_factory=Fields)  # any field of the configuration

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Explore with a progress bar; after Ctrl-C, what there is is kept all the same."""
        from mecp_env.cli.buildings import one, resolve, spare_sources, stem
        from mecp_env.cli.explore import FILES, Run  # pictures and physics are loaded only where they are used
        from mecp_env.cli.options import check_map, end_rerun, rerun_log, save_map
        from mecp_env.cli.progress import ExplorationBar, print_result
        from mecp_env.cli.stopwatch import timed_stages
        from mecp_env.core import warm_up
        from mecp_env.env import MecpEnv
        from mecp_env.render.replay import Recorder
        from mecp_env.render.window import require_display

        folder = check_folder(self.out or Path("runs") / f"{stem(one(self.layout, self.reading))}-{self.seed}")
        spare_sources([folder / name for name in FILES], [self.layout])
        config = configuration(resolve(self.layout, self.reading), self.config, line)
        check_map(self.save_map, one(self.layout, self.reading), config.estimator)
        if self.render == "human":
            require_display()
        warm_up.prepare()
        recording = rerun_log(self.rerun, config.robot.period_s)
        env = MecpEnv(config, None if self.render == "none" else "human")
        run = Run(env, self.seed, Recorder(config.robot.period_s) if self.replay else None, recording)
        with timed_stages() as watch, ExplorationBar(run, watch) as bar, suppress(KeyboardInterrupt):
            run.explore(bar.show)
        end_rerun(recording, self.rerun)
        if not run.estimated:
            return INTERRUPTED
        saved = list[bool]()
        run.save_map = lambda: saved.append(save_map(run.env, self.save_map))
        print_result(run.keep(folder, watch), folder)
        run.env.close()
        return exit_code({"interrupted": INTERRUPTED}.get(run.ended, 0), all(saved))
