"""An estimated map in files for other programs: landmarks, joint covariance, rooms and doors, a graph, the grid.

`SlamOutput.export`, `SlamPipeline.export` and `mecp-env export` write them by `save`.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.settings import guess
from mecp_env.slam.messages import Belief, Cell, Door, RoomGraph, SemanticGrid

Ring = Array  # (n,2), closed: the last point is the first; counter-clockwise around floor, clockwise around a hole
Vertex = tuple[int, int]  # column, row of a corner of a cell
COLUMNS = ("id", "x_m", "y_m", "var_x_m2", "cov_xy_m2", "var_y_m2")
PathLike = str | os.PathLike[str]
SUFFIXES = {"grid": (".yaml",), "joint_covariance": (".npz", ".csv")}


def room_outline(grid: SemanticGrid, room: int) -> list[list[Ring]]:
    """The parts of a room, each as its outer ring and those of its holes, in metres of the map frame."""
    labels, count = ndimage.label(grid.room == room)
    parts = [rings_of(labels == part) for part in range(1, count + 1)]
    return [[ring * grid.resolution_m + grid.origin for ring in rings] for rings in parts]


def rings_of(cells: Bools) -> list[Ring]:
    """The rings around connected cells (H,W), the outer one first; none touches itself."""
    after = _edges(cells)
    rings = [_corners(np.array(ring, np.float64)) for first in sorted(after) for ring in _loops(after, first)]
    return sorted(rings, key=area, reverse=True)


def area(ring: Ring) -> float:
    """The area in a ring, negative where it is clockwise."""
    x, y = ring.T
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


def _edges(cells: Bools) -> dict[Vertex, list[Vertex]]:
    """From each vertex to the next ones along the edges of the cells, which have the cell on their left."""
    inside = np.pad(cells, 1)
    after: dict[Vertex, list[Vertex]] = defaultdict(list)
    for (dx, dy), (x, y) in (((0, -1), (0, 0)), ((1, 0), (1, 0)), ((0, 1), (1, 1)), ((-1, 0), (0, 1))):
        beyond = np.roll(inside, (-dy, -dx), (0, 1))[1:-1, 1:-1]
        for row, column in np.argwhere(cells & ~beyond).tolist():
            start = column + x, row + y
            after[start].append((start[0] - dy, start[1] + dx))
    return after


def _loops(after: dict[Vertex, list[Vertex]], first: Vertex) -> list[list[Vertex]]:
    """The closed walks from a vertex on, cut where they come back to one; each edge is taken out of `after`."""
    loops, path, on_path = [], [first], {first}
    while after[path[-1]]:
        vertex = after[path[-1]].pop()
        path.append(vertex)
        if vertex in on_path:
            begin = path.index(vertex)
            loops.append(path[begin:])
            del path[begin + 1 :]
            on_path.difference_update(loops[-1][1:-1])
        on_path.add(vertex)
    return loops


def _corners(ring: Ring) -> Ring:
    """The ring without the points between its corners."""
    before, points, after = np.roll(ring[:-1], 1, axis=0), ring[:-1], np.roll(ring[:-1], -1, axis=0)
    turns = ((points - before) != (after - points)).any(axis=1)
    kept = points[turns]
    return np.concatenate([kept, kept[:1]])


def door_outline(belief: Belief, door: Door, cell_m: float) -> Ring:
    """The ring through the jambs of both faces; of one face, or of two that are one line, a strip as wide as a cell."""
    faces = [belief.p_map[belief.rows(np.array(pair))] for pair in (door.jambs, door.other_face) if pair]
    around = np.concatenate(faces)
    offset = around - around.mean(axis=0)
    ring = around[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    ring = np.concatenate([ring, ring[:1]])
    return ring if area(ring) > cell_m**2 else _strip(faces[0][0], faces[0][1], cell_m)


def _strip(right: Array, left: Array, width_m: float) -> Ring:
    """The rectangle along a face, half of its width on each side."""
    along = (left - right) / max(math.dist(left, right), 1e-9)
    side = 0.5 * width_m * np.array([-along[1], along[0]])
    return np.array([right - side, left - side, left + side, right + side, right - side])


class Level(IntEnum):
    """Grey levels as map_server's own saver writes them."""

    OCCUPIED = 0
    UNKNOWN = 205
    FREE = 254


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Pose of the robot's centre and all landmarks, with their joint covariance."""

    ids: Ints  # (N,) of the landmarks
    mean: Array  # (3+2N,) x, y, heading, then x, y of each landmark: m and rad, map frame
    cov: Array  # (3+2N,3+2N)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedMap:
    """What can be written; the joint covariance only where the filter is at hand."""

    belief: Belief
    graph: RoomGraph
    grid: SemanticGrid
    joint: Callable[[], Joint] | None = None


def save(what: EstimatedMap, paths: dict[str, PathLike | None]) -> list[Path]:
    """Write each file of `paths`, a name of `WRITERS` -> where; None is left out. The files that were written.

    Each is written whole or not at all. Raises `ConfigError` for a name that ends otherwise than `SUFFIXES` says, for
    one file given twice, and for nothing to write, before the first is written; `OSError` that names the file.
    """
    wanted = checked(paths)
    return [file for name, path in wanted.items() for file in WRITERS[name](what, path)]


def checked(paths: dict[str, PathLike | None]) -> dict[str, Path]:
    """The files that are wanted. Raises `ConfigError` as `save` does."""
    wanted = {name: Path(path) for name, path in paths.items() if path is not None}
    for name, path in wanted.items():
        if name not in WRITERS:
            raise ConfigError(f"export: {name}, one of {', '.join(WRITERS)} expected{guess(name, WRITERS)}")
        if path.suffix not in SUFFIXES.get(name, (path.suffix,)):
            raise ConfigError(f"{name}: {path}: a name that ends in {' or '.join(SUFFIXES[name])} expected")
    _check_apart(wanted)
    if not wanted:
        raise ConfigError(f"export: name what to write, one or more of {', '.join(WRITERS)}")
    return wanted


def _check_apart(wanted: dict[str, Path]) -> None:
    """Raise `ConfigError` for a file that is wanted twice."""
    writers = dict[Path, str]()
    files = [(file, name) for name, path in wanted.items() for file in _files(name, path)]
    for file, name in files:
        other = writers.setdefault(file, name)
        if other != name:
            raise ConfigError(f"{name}: {file} is written by {other} too; name another file")


def _files(name: str, path: Path) -> list[Path]:
    """Where what has that name is written: of the grid the image, too."""
    return [file.resolve() for file in ([path, path.with_suffix(".pgm")] if name == "grid" else [path])]


def save_landmarks(what: EstimatedMap, path: Path) -> list[Path]:
    """Write a line per landmark: id, position in the map frame (m), and its marginal covariance (m2)."""
    belief, lines = what.belief, [COLUMNS]
    for i, (x, y), cov in zip(belief.ids.tolist(), belief.p_map.tolist(), belief.covs.tolist(), strict=True):
        lines.append((i, x, y, cov[0][0], cov[0][1], cov[1][1]))
    return _write(path, _csv(lines))


def save_joint(what: EstimatedMap, path: Path) -> list[Path]:
    """Write the joint covariance as arrays `ids`, `mean`, `cov`, or as a table with a row for each number."""
    if what.joint is None:
        raise ConfigError("joint_covariance: it is the filter's, which an output does not hold: SlamPipeline.export")
    joint = what.joint()
    if path.suffix == ".npz":
        file = io.BytesIO()
        np.savez_compressed(file, ids=joint.ids, mean=joint.mean, cov=joint.cov)
        return _write(path, file.getvalue())
    names = ["pose.x_m", "pose.y_m", "pose.heading_rad", *(f"{i}.{u}_m" for i in joint.ids.tolist() for u in "xy")]
    rows = zip(names, joint.mean.tolist(), joint.cov.tolist(), strict=True)
    return _write(path, _csv([("", "mean", *names), *((name, mean, *cov) for name, mean, cov in rows)]))


def save_g2o(what: EstimatedMap, path: Path) -> list[Path]:
    """Write the pose as vertex 0 and each landmark as vertex id + 1, with an edge to it from the pose.

    The information of an edge is the inverse of the landmark's marginal covariance, in the robot's frame.
    """
    belief = what.belief
    x, y, heading = belief.T_map_robot.tolist()
    cos, sin = math.cos(heading), math.sin(heading)
    R_robot_map = np.array([(cos, sin), (-sin, cos)])
    lines = [f"VERTEX_SE2 0 {x!r} {y!r} {heading!r}", "FIX 0"]
    for i, p_map, cov in zip(belief.ids.tolist(), belief.p_map, belief.covs, strict=True):
        px, py = (R_robot_map @ (p_map - belief.T_map_robot[:2])).tolist()
        (a, b), (_, c) = np.linalg.inv(R_robot_map @ cov @ R_robot_map.T).tolist()
        lines += [f"VERTEX_XY {i + 1} {p_map.item(0)!r} {p_map.item(1)!r}"]
        lines += [f"EDGE_SE2_XY 0 {i + 1} {px!r} {py!r} {a!r} {b!r} {c!r}"]
    return _write(path, "\n".join([*lines, ""]).encode())


def save_rooms(what: EstimatedMap, path: Path) -> list[Path]:
    """Write rooms and doors as outlines with ids, as GeoJSON (RFC 7946) with coordinates in metres of the map frame."""
    parts = {room: room_outline(what.grid, room) for room in what.graph.rooms}
    features = [_feature("room", room, outline, {}) for room, outline in parts.items() if outline]
    for door in what.graph.doors:
        ring = door_outline(what.belief, door, what.grid.resolution_m)
        rooms = [room for room in door.rooms if room >= 0]
        features.append(_feature("door", door.id, [[ring]], {"rooms": rooms}))
    return _write(path, json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False).encode())


def _feature(kind: str, number: int, parts: list[list[Ring]], more: dict[str, Any]) -> dict[str, Any]:
    rings = [[ring.tolist() for ring in part] for part in parts]
    one = len(rings) == 1
    geometry = {"type": "Polygon" if one else "MultiPolygon", "coordinates": rings[0] if one else rings}
    properties = {"kind": kind, "id": number, **more}
    return {"type": "Feature", "id": f"{kind}-{number}", "properties": properties, "geometry": geometry}


def save_grid(grid: SemanticGrid, path: Path) -> list[Path]:
    """Write the grid for map_server: `path` is the yaml, the image is beside it."""
    table = np.full(256, Level.UNKNOWN, dtype=np.uint8)
    table[[Cell.FREE, Cell.DOOR]], table[Cell.OCCUPIED] = Level.FREE, Level.OCCUPIED
    return save_levels(table[grid.label], grid.origin, grid.resolution_m, path)


def save_levels(levels: NDArray[np.uint8], origin: Array, resolution_m: float, path: Path) -> list[Path]:
    """Write grey levels (H,W), row 0 at the bottom, for map_server: `path` is the yaml, the image is beside it."""
    image = path.with_suffix(".pgm")
    x, y = origin.tolist()
    fields = {"image": image.name, "mode": "trinary", "resolution": round(resolution_m, 6)}
    fields |= {"origin": [round(x, 6), round(y, 6), 0.0], "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
    text = yaml.safe_dump(fields, sort_keys=False, allow_unicode=True, default_flow_style=None, width=math.inf)
    file = io.BytesIO()
    Image.fromarray(levels[::-1]).save(file, format="PPM")
    return _write(image, file.getvalue()) + _write(path, text.encode())


def _csv(rows: Any) -> bytes:
    file = io.StringIO(newline="")
    csv.writer(file).writerows(rows)
    return file.getvalue().encode()


def _write(path: Path, data: bytes) -> list[Path]:
    write_atomic(path, data)
    return [path]


WRITERS: dict[str, Callable[[EstimatedMap, Path], list[Path]]] = {
    "landmarks": save_landmarks,
    "rooms": save_rooms,
    "g2o": save_g2o,
    "grid": lambda what, path: save_grid(what.grid, path),
    "joint_covariance": save_joint,
}
