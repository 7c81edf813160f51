"""The map compared with ground truth: rooms and doors found, and how well the grid covers the free area."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.arrays import rows_by_id
from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.se2 import inverse, to_map
from mecp_env.evaluation import metric_arrays
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.slam.messages import NO_ID, Belief, Cell, Door, SemanticGrid
from mecp_env.slam.output import SlamOutput

DOOR_GATE_M = 0.3


def doors_found(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> tuple[int, int]:
    """How many true doors are in the map (within 0.3 m, one to one), and how many of its doors are no true one.

    A door of the map whose jambs are no longer landmarks counts as none.
    """
    p_world = to_map(T_world_map, door_centres(output.graph.doors, output.belief))
    found = len(nearest_pairs(_from_doorways(truth, p_world), DOOR_GATE_M))
    return found, len(p_world) - found


def _from_doorways(truth: GroundTruth, p_world: Array) -> Array:
    """(n,D) m, of the points p_world (n,2) from the line through each true doorway, between the middles of its faces.

    Of a door in a thick wall one face may be all that is known: it is as right as the centre. inf: beyond the gate.
    """
    doors = truth.outline.doors
    x, y = (p_world[:, None] - doors.centre).transpose(2, 0, 1)
    far = np.full(x.shape, np.inf)
    point, door = np.nonzero(x * x + y * y < (2.0 * DOOR_GATE_M + doors.thickness) ** 2)
    x, y, normal = x[point, door], y[point, door], doors.normal[door]
    ahead = np.abs(x * np.cos(normal) + y * np.sin(normal)) - 0.5 * doors.thickness[door]
    far[point, door] = np.hypot(np.maximum(ahead, 0.0), x * np.sin(normal) - y * np.cos(normal))
    return far


def door_centres(doors: tuple[Door, ...], belief: Belief) -> Array:
    """(d,2) m, map frame: the middle of each door's jambs; nan where none of them is a landmark."""
    jambs = np.array([door.jambs + (door.other_face or (NO_ID, NO_ID)) for door in doors], np.int64).reshape(-1, 4)
    rows = np.where(jambs == NO_ID, -1, rows_by_id(belief.ids, jambs)[jambs])
    places = np.concatenate((belief.p_map, np.zeros((1, 2))))[rows]  # the last one, of none, adds nothing
    count = (rows >= 0).sum(axis=1, keepdims=True)
    centres: Array = (places[:, 0] + places[:, 1] + places[:, 2] + places[:, 3]) / np.where(count > 0, count, np.nan)
    return centres


def door_error(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> float:
    """Mean distance (m) of the doors found from the truth: of the middle of each face that is known; 0 without one."""
    doors = output.graph.doors
    p_world = to_map(T_world_map, door_centres(doors, output.belief))
    found = nearest_pairs(_from_doorways(truth, p_world), DOOR_GATE_M)
    errors = [_face_error(truth, doors[d], output.belief, T_world_map, true) for d, true in found]
    return float(np.mean(errors)) if errors else 0.0


def _face_error(truth: GroundTruth, door: Door, belief: Belief, T_world_map: Array, true: int) -> float:
    """Mean distance (m) of the middles of the door's known faces from the nearer face of the true door."""
    true_doors = truth.outline.doors
    ahead = np.array([np.cos(true_doors.normal[true]), np.sin(true_doors.normal[true])])
    faces = true_doors.centre[true] + np.outer((0.5, -0.5), ahead * true_doors.thickness[true])
    known = [face for face in (door.jambs, door.other_face) if face is not None]
    p_map = np.array([belief.p_map[belief.rows(np.array(face))].mean(axis=0) for face in known])
    return float(distances(to_map(T_world_map, p_map), faces).min(axis=1).mean())


def landmark_errors(p_world: Array, belief: Belief, corner: Ints, T_world_map: Array) -> Array:
    """(N,) m: distance of each landmark from the true corner that it is of, nan for one that is of none.

    `p_world` (C,2) are the true corners, `corner` (N,) is the index of that of each landmark, -1 for none. Measured in
    the map frame, which is where the robot believed to start: nothing is fitted, so that a map that slides off counts.
    """
    away = to_map(T_world_map, np.ascontiguousarray(belief.p_map)) - p_world[corner]
    errors: Array = np.where(corner >= 0, np.hypot(away[:, 0], away[:, 1]), np.nan)
    return errors


def covers(truth: GroundTruth, grid: SemanticGrid, T_world_map: Array) -> tuple[float, float]:
    """Share of the true free area that lies under polygons, and share that the grid calls FREE or DOOR."""
    p_map = to_map(inverse(T_world_map), truth.centres[truth.free])
    free = np.isin(labels_at(grid, p_map), (int(Cell.FREE), int(Cell.DOOR)))
    return float(cells_at(grid, grid.polygon, p_map, False).mean()), float(free.mean())


def rooms_found(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> tuple[int, int]:
    """How many true rooms hold the centre of a room of the map (one to one), and how many rooms hold none.

    The centre of a room of the map is its cell farthest from every other room, so that the centre of a U-shaped room
    lies well inside it. A room that no cell was painted of yet counts as neither.
    """
    p_map = room_centres(output.grid, np.array(output.graph.rooms, np.int64))
    p_world = to_map(T_world_map, p_map[~np.isnan(p_map[:, 0])])
    rooms = [truth.room_at(centre) for centre in p_world]
    found = len(set(rooms) - {-1})
    return found, len(rooms) - found


def room_centres(grid: SemanticGrid, rooms: Ints) -> Array:
    """(n,2) m, map frame: the cell of each room (n,) farthest from every other room; nan without a cell."""
    if not len(rooms) or not grid.room.size:
        return np.full((len(rooms), 2), np.nan)
    centres: Array = grid.origin + (metric_arrays.room_middles(grid.room, rooms) + 0.5) * grid.resolution_m
    return centres


def grid_iou(truth: GroundTruth, grid: SemanticGrid, T_world_map: Array) -> float:
    """Intersection over union of the free cells (doors included) of the map's grid and of the truth.

    Counted on the truth's raster, which reaches 1 m beyond the building.
    """
    p_map = to_map(inverse(T_world_map), truth.centres.reshape(-1, 2))
    believed = np.isin(labels_at(grid, p_map), (int(Cell.FREE), int(Cell.DOOR)))
    true = truth.free.reshape(-1)
    return float((believed & true).sum()) / float((believed | true).sum())


def labels_at(grid: SemanticGrid, p_map: Array) -> Bytes:
    """(n,) the label of the cell that each point (n,2) of the map frame lies in; UNKNOWN outside."""
    return cells_at(grid, grid.label, p_map, np.uint8(Cell.UNKNOWN))


def cells_at(grid: SemanticGrid, layer: NDArray[Any], p_map: Array, outside: Any) -> NDArray[Any]:
    """(n,) the values of a layer (H,W) of the grid at the points (n,2) of the map frame."""
    cells = np.floor((p_map - grid.origin) / grid.resolution_m).astype(np.int64)
    rows, cols = layer.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
    values = np.full(len(p_map), outside, layer.dtype)
    values[inside] = layer[cells[inside, 1], cells[inside, 0]]
    return values


def distances(a: Array, b: Array) -> Array:
    """(n,m) m, of the points a (n,2) from the points b (m,2)."""
    far: Array = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2))
    return far


def nearest_pairs(far: Array, gate: float) -> list[tuple[int, int]]:
    """Pairs (row, column) nearest first, one to one, none as far as `gate`; nan is never near."""
    near = np.argwhere(far < gate)
    pairs: dict[int, int] = {}
    for row, column in near[np.argsort(far[far < gate], kind="stable")].tolist():
        if row not in pairs and column not in pairs.values():
            pairs[row] = column
    return list(pairs.items())
