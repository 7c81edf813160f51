"""One scan of an exploration, stage by stage, as pictures (docs/one-scan.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mecp_env.slam.pipeline
from mecp_env.config import EnvConfig
from mecp_env.demo import Run
from mecp_env.errors import ConfigError
from mecp_env.render.figures import save
from mecp_env.render.stages import stage_figures

pipeline: Any = mecp_env.slam.pipeline


class _Reached(Exception):
    """The period that is wanted has come."""


def draw(config: EnvConfig, seed: int, period: int, folder: Path) -> list[Path]:
    """Explore until `period` and write a PNG for each stage of its scan; returns their paths.

    Raises `ConfigError` when the exploration ends before.
    """
    run = Run.begin(config, seed)

    def stop(run: Run) -> None:
        if run.periods == period:
            raise _Reached

    try:
        run.explore(stop)
    except _Reached:
        report = run.env.view().report
    else:
        raise ConfigError(f"period: {period} is past the end of the exploration ({run.periods} periods)")
    slam = run.env.config.estimator_config
    clusters = pipeline.cluster_beams(report.beams, slam.clustering, slam.sensor)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, (name, figure) in enumerate(stage_figures(report, clusters).items(), start=1):
        paths.append(folder / f"{number}-{name}.png")
        save(figure, paths[-1], dpi=80)
    return paths
