"""`mecp-env export`: what is in a saved map, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from mecp_env.cli.base import Command, check_writable
from mecp_env.cli.buildings import spare_sources
from mecp_env.cli.exit_codes import echo
from mecp_env.core.errors import ConfigError


@dataclass(frozen=True)
class Export(Command):
    """Write landmarks, rooms, a graph or the grid of a saved map (--save-map) for other programs."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env export map.zip --landmarks x.csv --rooms x.geojson",
        "mecp-env export map.zip --joint-covariance x.npz",
    )

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    landmarks: Path | None = None  # .csv: position and covariance of each landmark
    joint_covariance: Path | None = None  # .npz or .csv: of the pose and all landmarks
    rooms: Path | None = None  # .geojson: outlines of rooms and doors, in metres of the map frame
    g2o: Path | None = None  # .g2o: the pose and the landmarks as a graph
    grid: Path | None = None  # .yaml: the grid for map_server, with its .pgm beside it

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Read the map, write every file that is asked for, a line each."""
        from mecp_env.slam import SlamMap, SlamPipeline
        from mecp_env.slam.export import checked

        wanted = {name: path for name in NAMES if (path := getattr(self, name)) is not None}
        if not wanted:
            raise ConfigError(f"export: name what to write, one or more of {', '.join(map(option, NAMES))}")
        checked({**wanted})
        for name, path in wanted.items():
            check_writable(path, option(name))
        images = [self.grid.with_suffix(".pgm")] if self.grid is not None else []
        spare_sources([*wanted.values(), *images], [str(self.source)])
        pipeline = SlamMap.load(self.source).restore(SlamPipeline)
        for name, path in wanted.items():
            pipeline.export(**{name: path})
            echo(f"{name}: {path}")
        return 0


def option(name: str) -> str:
    """The option of a field."""
    return f"--{name.replace('_', '-')}"


NAMES = ("landmarks", "joint_covariance", "rooms", "g2o", "grid")
