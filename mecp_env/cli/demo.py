"""The commands `demo`, `one-scan` and `replay`: explore a building by the robot's map, and look at what was kept."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from pydantic import Field

from mecp_env.cli.base import INTERRUPTED, Command, Line, OutFolder, Seed, check_folder, check_writable, echo
from mecp_env.cli.options import Fields, KeepsMap, ReadsPlans, WithModules, configuration, spare_sources, stem
from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import read_json

if TYPE_CHECKING:
    from mecp_env.cli.runs import Run
    from mecp_env.slam.output import SlamOutput

PAGE, MOST_BYTES = "replay.html", 5_000_000  # of a configuration
REMEDY = "name the folder of a run of `mecp-env demo` or `mecp-env slam`, or a page that one wrote"


@dataclass(frozen=True)
class Demo(KeepsMap, ReadsPlans):
    """Explore a building by the robot's own map, breadth first; keep pictures, figures and paths.

    Examples:
        mecp-env demo --layout two_rooms
        mecp-env demo --layout office --seed 3 --render human
        mecp-env demo --layout hard:7
        mecp-env demo --layout scan.png --resolution-m 0.05 --free-above 230
        mecp-env demo --config.slam.filter.kind ekf --out runs/ekf
        mecp-env demo --config.laser.preset urg04lx --config.odometry.preset turtlebot
    """

    layout: str = "paper"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a plan
    seed: Seed = 0  # the same seed gives the same run
    render: Literal["none", "human"] = "none"  # human: watch it in a window
    out: Path | None = None  # folder for what is kept; default: runs/LAYOUT-SEED
    replay: bool = True  # keep the page that plays the run in a browser
    config: Fields = field(default_factory=Fields)  # any field of the configuration

    def run(self, line: Line) -> int:
        """Explore with a progress bar; after Ctrl-C, what there is is kept all the same."""
        from mecp_env.cli.runs import FILES, Run, print_figures  # here, so that help and errors come at once
        from mecp_env.core.warm_up import prepare
        from mecp_env.env import MecpEnv
        from mecp_env.render.replay import Recorder
        from mecp_env.render.window import require_display

        building = self.reading.one(self.layout)
        folder = check_folder(self.out or Path("runs") / f"{stem(building)}-{self.seed}")
        spare_sources([folder / name for name in FILES], [self.layout])
        config = configuration(self.reading.resolve(self.layout), self.config, line)
        self.check_map(building, config.estimator)
        if self.render == "human":
            require_display()
        prepare()
        recording = self.recording(config.robot.period_s)
        env = MecpEnv(config, None if self.render == "none" else "human")
        run = Run(env, self.seed, Recorder(config.robot.period_s) if self.replay else None, recording)
        run.watched()
        self.end_recording(recording)
        if not run.estimated:
            return INTERRUPTED
        metrics = run.keep_data(folder)
        code = self.keep_map(env)
        run.keep_pictures(folder)
        ended = "over, no goal left" if run.ended == "complete" else run.ended  # by the belief, not the truth
        print_figures(f"exploration {ended}", metrics, folder)
        env.close()
        return {"interrupted": INTERRUPTED}.get(run.ended, code)


@dataclass(frozen=True)
class OneScan(WithModules, ReadsPlans):
    """Follow one scan through the stages: one picture each, as in docs/one-scan.md.

    Examples:
        mecp-env one-scan
        mecp-env one-scan --layout hard:7
        mecp-env one-scan --layout office --step 10 --out runs/office-scan
    """

    layout: str = "paper"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a plan
    seed: Seed = 0  # the same seed gives the same run
    step: Annotated[int, Field(ge=0)] = 40  # the first scan from here on in which a polygon of the map is recognised
    out: OutFolder = Path("runs/one-scan")  # folder for the pictures

    def run(self, line: Line) -> int:
        """Write the pictures of one scan's stages, and say where they are."""
        from mecp_env.cli.runs import Run
        from mecp_env.env import MecpEnv
        from mecp_env.render.figures import save
        from mecp_env.render.stages import DPI, stage_figures
        from mecp_env.slam.frontend.beams import Beams
        from mecp_env.slam.frontend.clustering import cluster_beams
        from mecp_env.slam.messages import Clusters

        run = Run(MecpEnv(layout=self.reading.resolve(self.layout)), self.seed)
        output, slam = recognition(run, self.step), run.env.config.estimator_config
        united = slam.clustering.united(run.env.config.laser.sweeps)
        rules = slam.clustering.record, slam.segments.record, slam.sensor.record
        clusters = Clusters(*cluster_beams(Beams.of(output.beams), *rules, united))
        self.out.mkdir(parents=True, exist_ok=True)
        for number, (name, figure) in enumerate(stage_figures(output, clusters).items(), start=1):
            path = self.out / f"{number}-{name}.png"
            save(figure, path, dpi=DPI)
            echo(path)
        return 0


def recognition(run: Run, step: int) -> SlamOutput:
    """The first scan of an exploration from `step` on in which a polygon of the map is recognised.

    Raises `ConfigError` when the exploration ends before.
    """
    run.explore(lambda run: run.steps >= step and run.env.slam_output.match.known >= 0)
    if run.ended != "interrupted":
        raise ConfigError(f"step: no polygon is recognised from {step} on; the exploration ends at {run.steps}")
    return run.env.slam_output


@dataclass(frozen=True)
class Replay(Command):
    """Make the page that plays a run: world and belief side by side, with a time slider, why each corner was matched or
    not, and curves. RUN is the folder of a run, or its page, which gets the player of this version. A folder of `demo`
    without a page is explored again, with the same bits.

    Examples:
        mecp-env replay runs/paper-0
        mecp-env replay runs/paper-0 --browser
        mecp-env replay runs/training/replays/episode-0003.html --out best.html
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(name="RUN", metavar="RUN")]
    out: Path | None = None  # file of the page; default: replay.html in the folder of the run, or the page itself
    browser: bool = False  # show it in the browser

    def run(self, line: Line) -> int:
        """Write the page. Raises `ConfigError` and `ReplayError`."""
        from mecp_env.render.replay_page import read_page, write_page

        page = self.run_folder / PAGE if self.run_folder.is_dir() else self.run_folder
        out = check_writable(self.out or page)
        if not self.run_folder.exists():
            raise ConfigError(f"{self.run_folder}: there is no such file or folder; {REMEDY}")
        played = read_page(page) if page.exists() else explored_again(self.run_folder)
        if not played:
            return INTERRUPTED
        write_page(played, out)
        echo(f"{len(played['frames'])} frames: {out}")
        if self.browser:
            webbrowser.open(out.absolute().as_uri())
        return 0


def explored_again(folder: Path) -> dict[str, Any]:
    """The run that `demo` kept in a folder, by its configuration; nothing after Ctrl-C. Raises `ConfigError`."""
    from mecp_env.cli.runs import Run
    from mecp_env.env import MecpEnv

    recipe = recipe_of(folder)
    run = Run(MecpEnv(EnvConfig.build(recipe["config"])), recipe["seed"])
    run.watched()
    return run.replay() if run.ended != "interrupted" else {}


def recipe_of(folder: Path) -> dict[str, Any]:
    """`config.json` of a run of `demo`. Raises `ConfigError` where there is none, or another kind of file."""
    path = folder / "config.json"
    try:
        recipe = read_json(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: neither {PAGE} nor a config.json that can be read ({error}); {REMEDY}") from None
    known = isinstance(recipe, dict) and recipe.get("policy") == "breadth_first"
    if not (known and isinstance(recipe.get("seed"), int) and isinstance(recipe.get("config"), dict)):
        raise ConfigError(f"{path}: no run of `mecp-env demo`; {REMEDY}")
    return dict(recipe)
