"""`mecp-env one-scan`: the stages of one scan as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from mecp_env.cli.base import OutFolder, Seed
from mecp_env.cli.buildings import Reading, ReadingOptions
from mecp_env.cli.exit_codes import echo
from mecp_env.cli.options import WithModules
from mecp_env.core.errors import ConfigError

if TYPE_CHECKING:
    from mecp_env.cli.explore import Run
    from mecp_env.slam.output import SlamOutput


@dataclass(frozen=True)
class OneScan(WithModules):
    """Follow one scan through the stages: one picture each, as in docs/one-scan.md."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env one-scan",
        "mecp-env one-scan --layout hard:7",
        "mecp-env one-scan --layout office --step 10 --out runs/office-scan",
    )

    layout: str = "paper"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a plan
    seed: Seed = 0  # the same seed gives the same run
    step: Annotated[int, Field(ge=0)] = 40  # the first scan from here on in which a polygon of the map is recognised
    out: OutFolder = Path("runs/one-scan")  # folder for the pictures
    reading: ReadingOptions = field(default_factory=Reading)

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Write the pictures of one scan's stages, and say where they are."""
        from mecp_env.cli.buildings import resolve
        from mecp_env.cli.explore import Run  # pictures and physics are loaded only here
        from mecp_env.env import MecpEnv
        from mecp_env.render.figures import save
        from mecp_env.render.stages import DPI, stage_figures
        from mecp_env.slam.frontend.clustering import cluster_beams

        run = Run(MecpEnv(layout=resolve(self.layout, self.reading)), self.seed)
        output, slam = recognition(run, self.step), run.env.config.estimator_config
        united = slam.clustering.united(run.env.config.laser.sweeps)
        clusters = cluster_beams(output.beams, slam.clustering, slam.segments, slam.sensor, united)
        self.out.mkdir(parents=True, exist_ok=True)
        for number, (name, figure) in enumerate(stage_figures(output, clusters).items(), start=1):
            path = self.out / f"{number}-{name}.png"
            save(figure, path, dpi=DPI)
            echo(path)
        return 0


class _Reached(Exception):
    """The step that is wanted has come."""


def recognition(run: Run, step: int) -> SlamOutput:
    """The first scan of an exploration from `step` on in which a polygon of the map is recognised.

    Raises `ConfigError` when the exploration ends before.
    """

    def stop(run: Run) -> None:
        if run.steps >= step and run.env.slam_output.match.known >= 0:
            raise _Reached

    try:
        run.explore(stop)
    except _Reached:
        return run.env.slam_output
    raise ConfigError(f"step: no polygon is recognised from {step} on; the exploration ends at {run.steps}")
