"""`mecp-env export`: what is in a saved map, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

    examples: ClassVar[tuple[str, ...]] = ("mecp-env export map.zip --landmarks x.csv --rooms x.geojson",)

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    landmarks: Path | None = None  # .csv: position and covariance of each landmark
    rooms: Path | None = None  # .geojson: outlines of rooms and doors, in metres of the map frame
    g2o: Path | None = None  # .g2o: the pose and the landmarks as a graph
    grid: Path | None = None  # .yaml: the grid for map_server, with its .pgm beside it

    def run(self, line: Sequence[str]) -> int:
        """Read the map, write every file that is asked for, a line each."""
        wanted = {name: path for name in WRITERS if (path := getattr(self, name)) is not None}
        if not wanted:
            raise ConfigError(f"export: name what to write, one or more of {', '.join(f'--{n}' for n in WRITERS)}")
        for name, path in wanted.items():
            check_writable(path, f"--{name}")
        if self.grid is not None and self.grid.suffix != ".yaml":
            raise ConfigError(f"--grid: {self.grid}: a name that ends in .yaml expected")
        images = [self.grid.with_suffix(".pgm")] if self.grid is not None else []
        spare_sources([*wanted.values(), *images], [str(self.source)])
        self._write(wanted)
        return 0

    def _write(self, wanted: dict[str, Path]) -> None:
        from mecp_env.floorplans import exporters, map_export
        from mecp_env.slam import SlamMap, SlamPipeline
        from mecp_env.slam.filters.mounting import robot_belief

        slam = SlamMap.load(self.source).restore(SlamPipeline)
        belief, grid = robot_belief(slam.filter.belief(), slam.config.sensor), slam.grid.canvas.grid
        writers: dict[str, Callable[[Path], object]] = {
            "landmarks": lambda path: map_export.save_landmarks(belief, path),
            "rooms": lambda path: map_export.save_rooms(belief, slam.rooms.graph(), grid, path),
            "g2o": lambda path: map_export.save_g2o(belief, path),
            "grid": lambda path: exporters.save_map_server(grid, path.with_suffix("")),
        }
        for name, path in wanted.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            writers[name](path)
            echo(f"{name}: {path}")


WRITERS = ("landmarks", "rooms", "g2o", "grid")
