"""Maps on disk: everything that a pipeline knows, as checked plain data in one file, and where to begin in it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.settings import shown
from mecp_env.core.snapshot import StateError, damage_refused, decode, encode
from mecp_env.core.snapshot_check import check_fields, examples_of
from mecp_env.core.snapshot_file import FileKind, load_snapshot, save_snapshot
from mecp_env.core.snapshot_shapes import FAR, check_shapes
from mecp_env.core.version import __version__
from mecp_env.slam.association.oracle import NoCorrespondences, OracleAssociator
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.filters.mounting import mount
from mecp_env.slam.filters.oracle import OraclePoseFilter
from mecp_env.slam.messages import UNKNOWN_ROOM, SemanticGrid
from mecp_env.slam.state_shapes import SHAPES, check_pipeline

FILE = FileKind("mecp_env map", 8, __version__)

MapStart = Literal["saved", "unknown"] | Sequence[float] | Array
Pipeline = TypeVar("Pipeline")


class MapError(StateError):
    """A map is damaged, foreign, of another version, or holds what no map can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class SlamMap:
    """A whole map: landmarks with their joint covariance, features, polygons, rooms, doors, path, grid, configuration.

    Plain data that shares no memory with a pipeline: any number of pipelines can begin in it.
    """

    state: dict[str, Any]  # a pipeline, as `encode` made it
    source: str = "map"  # the file, for errors

    @classmethod
    def of(cls, pipeline: Any) -> Self:
        """The map of a pipeline. Ground truth and injected parts stay out. Raises `MapError`."""
        try:
            made = cls(encode(_own_parts(pipeline)))
        except TypeError as error:
            raise MapError(f"map: {error}") from None
        made.restore(type(pipeline))  # no map is written that cannot be read
        return made

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The map in a file. Raises `MapError`; `restore` checks what is in it."""
        try:
            return cls(load_snapshot(Path(path), FILE), str(path))
        except StateError as error:
            raise MapError(str(error)) from None

    def save(self, path: str | Path) -> None:
        """Write the map into a file, whole or not at all. Raises `OSError` that names it."""
        save_snapshot(Path(path), FILE, self.state)

    def restore(self, make: Callable[[SlamConfig], Pipeline]) -> Pipeline:
        """A pipeline that goes on where the saved one was; `make` makes an empty one. Raises `MapError`."""
        try:
            return _checked(self.state, make)
        except MecpError as error:
            raise MapError(f"{self.source}: {error}") from None


def _checked(state: Any, make: Callable[[SlamConfig], Pipeline]) -> Pipeline:
    """The pipeline that is encoded in a state. Raises `StateError`."""
    with damage_refused():
        pipeline = decode(state)
        fresh = make(pipeline.config)
        check_fields(pipeline, type(fresh), "map", examples_of(fresh))
        check_shapes(pipeline, SHAPES, "map", check_pipeline(pipeline, "map"))
        return pipeline  # type: ignore[no-any-return]  # `check_fields` has compared its class


def _own_parts(pipeline: Any) -> Any:
    """The pipeline with the parts that its configuration names, without ground truth."""
    own, fresh = copy.copy(pipeline), type(pipeline)(pipeline.config)
    if isinstance(own.filter, OraclePoseFilter):
        own.filter = own.filter.inner
    if type(own.filter) is not type(fresh.filter):
        raise MapError(f"filter: {type(own.filter).__name__} was injected; a map holds that of its configuration")
    if type(own.associator) is not type(fresh.associator):
        own.associator = fresh.associator
    if isinstance(own.associator, OracleAssociator):
        own.associator = replace(own.associator, correspondences=NoCorrespondences())
    return own


def begin(pipeline: Any, start: MapStart, sigmas: Sequence[float]) -> None:
    """Let a restored pipeline begin at `start`, as `SlamPipeline.from_map` describes. Raises `ConfigError`."""
    if isinstance(start, str):
        if start not in ("saved", "unknown"):
            raise ConfigError(f'start: {shown(start)}, expected "saved", "unknown" or a pose x, y, heading')
        if start == "unknown":
            pipeline.lose_pose()
        return
    T_map_robot = _numbers(start, "start", -FAR, "x, y in m and heading in rad")
    pose_cov = np.diag(_numbers(sigmas, "sigmas", 0.0, "sigmas of x, y in m and heading in rad") ** 2)
    place(pipeline, T_map_robot, pose_cov)
    mount(pipeline.filter, pipeline.config.sensor)


def place(pipeline: Any, T_map_robot: Array, pose_cov: Array) -> None:
    """The robot was put at a pose (3,) with a covariance (3,3), and did not drive there: what it just saw is void."""
    pipeline.filter.set_pose(T_map_robot, pose_cov)
    pipeline.guard.trust()
    pipeline.divergence.found = False
    pipeline.rooms.place(room_at(pipeline.grid.canvas.grid, T_map_robot[:2], pipeline.rooms.current))
    pipeline.map.forget_tracks(pipeline.step_count, pipeline.rooms.resolve)
    pipeline.recent.forget(pipeline.filter)


def room_at(grid: SemanticGrid, p_map: Array, otherwise: int) -> int:
    """The room of the cell nearest to `p_map` (2,) that has one; `otherwise` without any."""
    cells = np.argwhere(grid.room != UNKNOWN_ROOM)
    if not len(cells):
        return otherwise
    offset = (cells[:, ::-1] + 0.5) * grid.resolution_m + grid.origin - p_map
    row, column = cells[np.hypot(*offset.T).argmin()]
    return int(grid.room[row, column])


def _numbers(given: Any, name: str, least: float, expected: str) -> Array:
    """(3,) the numbers that were given. Raises `ConfigError`."""
    try:
        numbers = np.array(given, np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not ((numbers > least) & (numbers < FAR)).all():
        raise ConfigError(f"{name}: {shown(given)}, expected {expected}, above {least:g} and below {FAR}")
    return numbers
