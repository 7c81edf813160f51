"""One scan of an exploration, stage by stage, as pictures (docs/one-scan.md)."""

from __future__ import annotations

from pathlib import Path

from mecp_env.cli.exploration import Run
from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.render.figures import save
from mecp_env.render.stages import stage_figures
from mecp_env.slam.frontend.clustering import cluster_beams
from mecp_env.slam.messages import SlamOutput


class _Reached(Exception):
    """The step that is wanted has come."""


def draw(config: EnvConfig, seed: int, step: int, folder: Path) -> list[Path]:
    """Write a PNG for each stage of a scan; returns their paths.

    The scan is the first from `step` on in which a polygon of the map is recognised. Raises `ConfigError` for a
    negative step or seed, and when the exploration ends before.
    """
    if step < 0:
        raise ConfigError(f"step: {step}, at least 0")
    run = Run.begin(config, seed)
    output = recognition(run, step)
    slam = run.env.config.estimator_config
    clusters = cluster_beams(output.beams, slam.clustering, slam.segments, slam.sensor)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, (name, figure) in enumerate(stage_figures(output, clusters).items(), start=1):
        paths.append(folder / f"{number}-{name}.png")
        save(figure, paths[-1], dpi=80)
    return paths


def recognition(run: Run, step: int) -> SlamOutput:
    """Explore until the first scan from `step` on in which a polygon is recognised."""

    def stop(run: Run) -> None:
        if run.steps >= step and run.env.slam_output.match.known >= 0:
            raise _Reached

    try:
        run.explore(stop)
    except _Reached:
        return run.env.slam_output
    raise ConfigError(f"step: no polygon is recognised from {step} on; the exploration ends at {run.steps}")
