"""What a step of the estimator saw and decided."""

from __future__ import annotations

from dataclasses import field
from os import PathLike
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Array, Ints, carrier
from mecp_env.core.se2 import compose
from mecp_env.slam.messages import (
    NO_ID,
    Belief,
    Corners,
    MapPolygon,
    Match,
    MergedScan,
    Polygon,
    RoomGraph,
    Segments,
    SemanticGrid,
)


@carrier
class SlamOutput:
    """Everything that one step of the pipeline saw and decided: for info, rendering and benchmarks."""

    step: int
    beams: MergedScan
    segments: Segments
    corners: Corners
    polygons: tuple[Polygon, ...]
    associated: Match  # as the associator decided
    match: Match  # after dynamic objects were left out, tracks were followed and landmarks merged
    belief: Belief
    graph: RoomGraph
    map_polygons: tuple[MapPolygon, ...]
    grid: SemanticGrid
    diverged: bool
    T_robot_laser: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) mounting pose of the laser, in whose frame beams, segments and corners are; `belief` is of the robot."""
    confidence: float = 1.0  # probability that the position error is below `localisation.error_m`
    localised: bool = True  # False while the pose is searched for, and nothing is mapped
    panorama: Corners | None = None  # corners of this scan and of recent ones, where those complete it
    unsure_from: int = NO_ID  # features from this id on were mapped after the pose was lost, and are not yet sure
    T_map_scans: Array = field(default_factory=lambda: np.empty((0, 3)))
    """(n,3) poses of the robot at the key scans that `grid` is painted from."""
    scan_rooms: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """(n,) the rooms where these were taken, UNKNOWN_ROOM for a doorway."""

    @property
    def polygon_corners(self) -> Corners:
        """The corners that `Polygon.corners` of `polygons` are indices of."""
        return self.corners if self.panorama is None else self.panorama

    def export(self, **paths: str | PathLike[str] | None) -> list[Path]:
        """Write files for other programs: `landmarks` (.csv), `rooms` (.geojson), `g2o` (.g2o), `grid` (.yaml).

        Each keyword is the path of a file; those that were written are returned. Raises `ConfigError` for an unknown
        keyword, and `OSError` that names the file. docs/estimator.md describes them.
        """
        from mecp_env.slam.export import EstimatedMap, save  # here, as a step writes none

        return save(EstimatedMap(self.belief, self.graph, self.grid), paths)

    @property
    def T_map_laser(self) -> Array:
        """(3,) the estimated pose of the laser."""
        T_map_laser: Array = compose(self.belief.T_map_robot, self.T_robot_laser)
        return T_map_laser
