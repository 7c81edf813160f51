"""Maps on disk: everything that a pipeline knows, as checked plain data in one file, and where to begin in it.

The shapes of the arrays of the estimator, per class, as `mecp_env.core.snapshot_check` reads them.

Capital letters: F features, P polygons of the map.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.provenance import __version__
from mecp_env.core.settings import shown
from mecp_env.core.snapshot import StateError, damage_refused, decode, encode
from mecp_env.core.snapshot_check import (
    FAR,
    LONG,
    NEAR,
    Shapes,
    check_declared,
    check_fields,
    check_shapes,
    examples_of,
)
from mecp_env.core.snapshot_file import FileKind, load_snapshot, save_snapshot
from mecp_env.slam.association.oracle import NoCorrespondences, OracleAssociator
from mecp_env.slam.config import GridConfig, SlamConfig
from mecp_env.slam.filters.core import LandmarkFilter
from mecp_env.slam.filters.mounting import mount
from mecp_env.slam.filters.oracle import OraclePoseFilter
from mecp_env.slam.filters.update import FIRST_PROBE
from mecp_env.slam.messages import FEATURE, NO_ID, UNKNOWN_ROOM, FeatureState, SemanticGrid

SHAPES: Shapes = {
    "Belief": {
        "T_map_robot": f"3 in {NEAR}",
        "pose_cov": "3 3",
        "ids": "n in 0:F",
        "p_map": f"n 2 in {NEAR}",
        "covs": "n 2 2",
    },
    "FeatureTable": {"rows": "F"},
    "SlamPipeline": {"step_count": f" in 0:{10**15}"},
    "MapPolygon": {"ids": "k in 0:F", "intervals": "i 4", "room": " in -1:32768"},
    "PolygonGroup": {"ids": "n k in 0:F", "index": "n in 0:P"},
    "DoorMap": {"ids": "n", "jambs": "n 4 in -1:F"},
    "Passage": {"frame": f"5 in {NEAR}"},
    "Trail": {"places": f"n 4 in -{LONG}:{10**15}"},
    "Canvas": {
        "layers": "7 h w",
        "grid.label": "h w",
        "grid.polygon": "h w",
        "grid.room": "h w",
        "grid.origin": "2",
        "lattice": f"2 in -{LONG}:{LONG}",
        "mask": "h w+1 in 0:1",
        "dirty": "4",
    },
    "SemanticGrid": {"label": "h w in 0:8", "polygon": "h w", "room": "h w in -1:32768", "origin": "2"},
    "ScanLayer": {
        "T_map_robot": f"n 3 in {NEAR}",
        "room": "n in -1:32768",
        "step": "n",
        "anchor": "n k in -1:F",
        "p_robot": f"n k 2 in {NEAR}",
        "outline[]": f"n | m 2 in {NEAR}",
        "strips[]": f"n | m 4 2 in {NEAR}",
        "has_room": "n",
    },
    "PaintedPolygon": {"ring": f"k 2 in {NEAR}"},
    "DoorLayer": {"quads": "n 4 2", "lines": "c 2 2"},
    "GridPainter": {"p_landmark": "n 2"},
    "SlamOutput": {"T_robot_laser": f"3 in {NEAR}", "T_map_scans": f"k 3 in {NEAR}", "scan_rooms": "k"},
    "MergedScan": dict.fromkeys(("ranges", "bearings", "hit", "count"), "b")
    | dict.fromkeys(("raw_ranges", "raw_bearings"), "r"),
    "Segments": {"points": "s 2 2", "line": "s 2", "cov": "s 2 2"} | dict.fromkeys(("cluster", "first", "last"), "s"),
    "Corners": {
        "z": "n 2",
        "cov": "2n 2n",
        "kind": "n",
        "convex": "n",
        "normals": "n 2",
        "beyond": "n in -1:n",
        "sites": "n",
        "doorways.jambs": "d 2 in -1:n",
    },
    "Doorways": {"jambs": "d 2", "width": "d", "confirmable": "d"},
    "Candidate": {"ends": "2 2"},
    "Rest": {"slot_ids": "n", "state": "4+2n 3+2n", "at_work": "a in 0:n", "factor": "3+2a 3+2a", "belief.ids": "m"}
    | {"is_at_rest": "m", "variance": "m"},
    "FirstEstimateEkf": {"slot_ids": "n", "first": f"3+2n in {NEAR}"},
    "RecentScan": {"marks": "2", "ids": "n in -1:F", "still": "n"},
    "Registered": {"T_past_now": f"3 in {NEAR}", "cov": "3 3"},
    "Surfaces": {"points": f"n 2 in {NEAR}", "normals": "n 2", "sigmas": "n"},
    "PoseGuard": {"correction": f"3 in {NEAR}"},
    "Polygon": {"corners": "k", "intervals": "i 4"},
    "Match": {"ids": "n in -2:F", "decision": "n", "reason": "n", "nis": "n"},
}


def check_pipeline(pipeline: Any, where: str) -> dict[str, int]:
    """The sizes that the capital letters stand for. Raises `StateError` unless map, polygons and filter agree."""
    rows = pipeline.map.features.rows
    if rows.dtype != FEATURE or rows.ndim != 1:
        raise StateError(f"{where}.map.features.rows: another kind of rows")
    landmarks = np.flatnonzero(rows["state"] == FeatureState.LANDMARK)
    if not np.isin(landmarks, pipeline.filter.ids).all():
        raise StateError(f"{where}.map.features.rows: a landmark that is not in the filter")
    check_polygons(pipeline.map.polygons, f"{where}.map.polygons")
    if isinstance(pipeline.filter, LandmarkFilter):  # a custom filter stores what it likes
        check_filter(pipeline.filter, len(rows), marks_of(pipeline, where), f"{where}.filter")
    check_grid(pipeline.grid, pipeline.config.grid, len(rows), f"{where}.grid")
    doors = pipeline.rooms.door_map
    check_declared(np.array([*doors.row.values()], np.int64), "n in 0:d", {"d": len(doors.doors)}, f"{where}.doors.row")
    return {"F": len(rows), "P": len(pipeline.map.polygons.polygons)}


def marks_of(pipeline: Any, where: str) -> list[int]:
    """The ids of the marks of recent scans. Raises `StateError` unless all differ and are in the filter."""
    marks = [int(mark) for scan in pipeline.recent.scans for mark in scan.marks]
    if len({mark for mark in marks if mark < NO_ID} & set(pipeline.filter.slot_ids.tolist())) < len(marks):
        raise StateError(f"{where}.recent.scans: a mark that is not in the filter")
    return marks


def check_polygons(store: Any, where: str) -> None:
    """Raise `StateError` unless polygons have vertices, and are grouped by their number."""
    if any(group.ids.shape[1:] != (k,) for k, group in store.groups.items()):
        raise StateError(f"{where}.groups: polygons of another number of vertices")
    if any(len(polygon.ids) < 3 for polygon in store.polygons):
        raise StateError(f"{where}.polygons: one of fewer than three vertices")


def check_grid(grid: Any, config: GridConfig, features: int, where: str) -> None:
    """Raise `StateError` unless cells are of the configured size, completed rooms can be, and layers are consistent."""
    if {grid.canvas.resolution_m, grid.canvas.grid.resolution_m} != {config.resolution_m}:
        raise StateError(f"{where}.canvas.resolution_m: {grid.canvas.resolution_m!r}, configured {config.resolution_m}")
    if any(part.config != config for part in (grid, grid.scans, grid.doors)):
        raise StateError(f"{where}: a layer of another configuration")
    painted = np.array([i for ids in grid.polygons.painted for i in ids], np.int64)
    check_declared(painted, "n in 0:F", {"F": features}, f"{where}.polygons.painted")
    check_declared(np.array(grid.completed + grid.filled), "n in 0:32768", {}, f"{where}.completed")
    check_layers(grid, where)


def check_layers(grid: Any, where: str) -> None:
    """Raise `StateError` unless painted polygons have a place per vertex, and painted doors, where known, are near."""
    if any(np.shape(painted.ring) != (len(ids), 2) for ids, painted in grid.polygons.painted.items()):
        raise StateError(f"{where}.polygons.painted: a ring of another number of vertices")
    if any(len(polygon.ids) < 3 for polygon in grid.polygons.waiting):
        raise StateError(f"{where}.polygons.waiting: one of fewer than three vertices")
    if len(grid.doors.key) != len(grid.doors.quads):
        raise StateError(f"{where}.doors.quads: {len(grid.doors.quads)} for {len(grid.doors.key)} doors")
    if not np.nanmax(np.abs(grid.doors.quads), initial=0.0) < FAR:
        raise StateError(f"{where}.doors.quads: expected places nearer than {FAR} m")


def probes_needed(filter_: Any) -> int:
    """How many probes the submap of a filter has, 0 without one."""
    return sum(1 + len(rest.factor) for rest in getattr(filter_, "divided", ()))


def check_filter(filter_: Any, features: int, marks: list[int], where: str) -> None:
    """Raise `StateError` unless the filter has a slot per landmark and a row and column per number."""
    ids, state = filter_.slot_ids, filter_.state
    slots = ((len(state) if state.ndim else 0) - 4) // 2
    if state.shape != (4 + 2 * slots, 3 + 2 * slots) or ids.ndim != 1 or not len(ids) <= slots:
        raise StateError(f"{where}: state {state.shape} for slot_ids {ids.shape}")
    probes = int((ids <= FIRST_PROBE).sum())
    if probes != probes_needed(filter_):
        raise StateError(f"{where}.slot_ids: {probes} probes, expected one for each number in work")
    if len(set(ids.tolist()) & {*range(features), *marks}) < len(ids) - probes:
        raise StateError(f"{where}.slot_ids: expected different ids of features, and of marks of recent scans")
    used = 3 + 2 * len(ids)
    if not (np.abs(state[0, :used]).max() < FAR and np.isfinite(state[1 : 1 + used, :used]).all()):
        raise StateError(f"{where}.state: not finite, or too far away")


FILE = FileKind("mecp_env map", 13, __version__)

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
        except (TypeError, StateError) as error:
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
