"""Ground truth of a layout: rasters of free area and rooms, corners, doors; the floor that is mapped in its place.

The map compared with it: rooms and doors found, and how well the grid covers the free area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from mecp_env.core.carriers import Array, Bools, Bytes, Ints, carrier
from mecp_env.core.se2 import compose, inverse, to_map
from mecp_env.core.sensors import LaserView
from mecp_env.evaluation import metric_arrays
from mecp_env.slam.messages import NO_ID, Belief, Cell, Corners, Door, SemanticGrid, rows_by_id
from mecp_env.slam.output import SlamOutput
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.outline import Outline

SPACING_M = 0.1  # between the points of a wall
CELL_M = metric_arrays.CELL_M
MARGIN_M = 1.0  # of the rasters around the building
BEAMS = 720
BEARINGS = -np.pi + 2.0 * np.pi / BEAMS * np.arange(1, BEAMS + 1)
DIRECTIONS = np.stack([np.cos(BEARINGS), np.sin(BEARINGS)])  # (2,B)
NO_NOISE = np.random.default_rng(0)  # an ideal laser draws nothing from it
IDENTITY_GATE_M = 0.3
DOOR_GATE_M = 0.3


class FloorAndWalls(NamedTuple):
    """The free cells of a building, and the place on a wall that is nearest to each."""

    p_world: Array  # (n,2) m, centres of the free cells
    wall: Ints  # (n,) index of the nearest of `p_walls`
    p_walls: Array  # (w,2) m


def correct_coverage(floor: FloorAndWalls, grid: SemanticGrid, T_world_map: Array) -> float:
    """Share of the true free cells that the map calls FREE or DOOR, and whose nearest true wall is in the map.

    A wall is in the map where a cell within 0.25 m of the place of the true wall is OCCUPIED. Nothing is fitted: the
    map lies where the robot believed to start, so a part of it that slid off does not count.
    """
    place = np.array([*grid.origin.tolist(), grid.resolution_m])
    T_map_world = inverse(T_world_map)
    correct: int = metric_arrays.count_correct(*floor, T_map_world, grid.label, place)
    return correct / max(1, len(floor.p_world))


@dataclass(slots=True, eq=False)
class MapQuality:
    """Correct coverage and map error at the last comparison, and the areas under the former until now; plain state."""

    correct_coverage: float = 0.0
    map_error_m: float = 0.0  # RMSE of the landmarks
    over_steps: float = 0.0  # sum over the control steps
    over_metres: float = 0.0  # m, integral over the metres driven, up to the budget
    metres: float = 0.0  # driven, up to the budget

    def drive(self, metres: float, budget_m: float) -> None:
        """Count one control step of that length."""
        counted = min(metres, budget_m - self.metres)
        self.metres += counted
        self.over_steps += self.correct_coverage
        self.over_metres += counted * self.correct_coverage


class DynamicObstacles(NamedTuple):
    """The dynamic obstacles of one step, in the world frame."""

    faces: Array  # (m,2,2) m, free space on the left
    corners: Array  # (c,2) m, corners of boxes, which may have moved
    walking: Array  # (n,3) m, position and radius of pedestrians and boxes


NO_OBSTACLES = DynamicObstacles(np.empty((0, 2, 2)), np.empty((0, 2)), np.empty((0, 3)))


@carrier
class TrueCorrespondences:
    """True correspondences of the corners of a scan from a true pose; plain data."""

    T_world_laser: Array  # (3,)
    p_world: Array  # (C,2) m, true corners: those of boxes come after those of the building
    segments: Array  # (S,2,2) m, world: faces that may hide them

    def __call__(self, corners: Corners) -> Ints:
        """(n,) index of the true corner of each corner, or -1 for a spurious one.

        The nearest true corner that is visible from the pose and within 0.3 m, one to one.
        """
        return metric_arrays.identify_corners(
            corners.z, self.T_world_laser, self.p_world, self.segments, IDENTITY_GATE_M
        )


def true_correspondences(
    T_world_laser: Array, outline: Outline, obstacles: DynamicObstacles = NO_OBSTACLES
) -> TrueCorrespondences:
    """The correspondences of a scan taken by a laser at a pose (3,) in the building, with what moves in it."""
    true, segments = outline.corners.p_world, outline.segments
    if len(obstacles.faces):
        true = np.concatenate([true, obstacles.corners]) if len(obstacles.corners) else true
        segments = np.concatenate([segments, obstacles.faces])
    return TrueCorrespondences(T_world_laser, true, segments)


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """An outline with its rasters: derived from a layout, constant."""

    outline: Outline
    max_range_m: float
    view: LaserView = field(default_factory=LaserView)  # of the robot's laser

    @cached_property
    def laser(self) -> Laser:
        """A laser without noise."""
        return Laser(self.outline, LaserConfig(preset="ideal", sweeps=1, beams=BEAMS, max_range_m=self.max_range_m))

    @cached_property
    def T_robot_laser(self) -> Array:
        """(3,) m, rad: where the laser sits on the robot."""
        return self.view.T_robot_laser

    @property
    def sees_all_around(self) -> bool:
        """True when what is visible does not depend on the heading."""
        return self.view.field_of_view_deg == 360.0

    @cached_property
    def corner(self) -> Array:
        """(2,) m, world frame: the lower left corner of the rasters."""
        return np.array(self.outline.bounds[:2]) - MARGIN_M

    @cached_property
    def centres(self) -> Array:
        """(H,W,2) m, world frame: the centres of the cells."""
        size = np.array(self.outline.bounds[2:]) + MARGIN_M - self.corner
        cols, rows = np.ceil(size / CELL_M).astype(np.int64)
        x, y = (low + (np.arange(n) + 0.5) * CELL_M for low, n in zip(self.corner, (cols, rows), strict=True))
        x, y = np.meshgrid(x, y)
        return np.stack([x, y], axis=-1)

    @cached_property
    def free(self) -> Bools:
        """(H,W) whether the centre of the cell is in free space."""
        area = shapely.force_2d(self.outline.free_area)  # a copy: a prepared shape is not for several threads
        shapely.prepare(area)
        inside: Bools = shapely.contains_xy(area, self.centres[..., 0], self.centres[..., 1])
        return inside

    @cached_property
    def room(self) -> Ints:
        """(H,W) index of the room that contains the centre of the cell, or -1."""
        return self.outline.room_at(self.centres.reshape(-1, 2)).reshape(self.free.shape)

    @cached_property
    def free_cells(self) -> int:
        """How many cells are free."""
        return int(self.free.sum())

    @cached_property
    def floor_and_walls(self) -> FloorAndWalls:
        """The free cells, each with the place on a wall that is nearest to it."""
        p_world = np.ascontiguousarray(self.centres[self.free])
        lines = shapely.segmentize(shapely.linestrings(self.outline.segments), SPACING_M)
        p_walls = shapely.get_coordinates(lines)
        _, wall = cKDTree(p_walls).query(p_world)
        return FloorAndWalls(p_world, np.asarray(wall, np.int64), p_walls)

    def room_at(self, p_world: Array) -> int:
        """Index of the room at `p_world` (2,), or -1."""
        (left, low), (p_x, p_y) = self.corner.tolist(), p_world.tolist()
        x, y = p_x - left, p_y - low
        room, row, col = self.room, int(y / CELL_M), int(x / CELL_M)
        inside = y >= 0.0 and x >= 0.0 and row < room.shape[0] and col < room.shape[1]
        return int(room[row, col]) if inside else -1

    def sweep(self, T_world_robot: Array, seen: Bools) -> int:
        """Mark in `seen` (H,W) the free cells visible from the true pose (3,); returns the number of new ones."""
        x, y, heading = compose(T_world_robot, self.T_robot_laser).tolist()
        level = np.array([x, y, 0.0])
        ranges = self.laser.scan(level, NO_NOISE).ranges[0]
        if not self.sees_all_around:
            ahead = np.cos(BEARINGS - heading) >= math.cos(0.5 * self.view.field_of_view_rad)
            ranges = np.where(ahead, ranges, 0.0)
        return metric_arrays.sweep(ranges, DIRECTIONS, level, self.corner, self.free, seen)

    def correspondences(self, T_world_robot: Array, obstacles: DynamicObstacles = NO_OBSTACLES) -> TrueCorrespondences:
        """Which true corner each corner of a scan is, for a scan taken at a robot's pose (3,)."""
        return true_correspondences(compose(T_world_robot, self.T_robot_laser), self.outline, obstacles)

    def identify(self, corners: Corners, T_world_robot: Array, obstacles: DynamicObstacles = NO_OBSTACLES) -> Ints:
        """(n,) index of the true corner that each corner of a scan is, or -1 (see `TrueCorrespondences`)."""
        return self.correspondences(T_world_robot, obstacles)(corners)


def doors_found(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> tuple[int, int]:
    """How many true doors are in the map (within 0.3 m, one to one), and how many of its doors are no true one.

    A door of the map whose jambs are no longer landmarks counts as none.
    """
    found = len(_true_doors(truth, output, T_world_map))
    return found, len(output.graph.doors) - found


def _true_doors(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> list[tuple[int, int]]:
    """Row of each door of the map that is a true one, and of that one."""
    p_world = to_map(T_world_map, door_centres(output.graph.doors, output.belief))
    return nearest_pairs(_from_doorways(truth, p_world), DOOR_GATE_M)


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
    return (places[:, 0] + places[:, 1] + places[:, 2] + places[:, 3]) / np.where(count > 0, count, np.nan)


def door_error(truth: GroundTruth, output: SlamOutput, T_world_map: Array) -> float:
    """Mean distance (m) of the doors found from the truth: of the middle of each face that is known; 0 without one."""
    doors, found = output.graph.doors, _true_doors(truth, output, T_world_map)
    errors = [_face_error(truth, doors[d], output.belief, T_world_map, true) for d, true in found]
    return float(np.mean(errors)) if errors else 0.0


def _face_error(truth: GroundTruth, door: Door, belief: Belief, T_world_map: Array, true: int) -> float:
    """Mean distance (m) of the middles of the door's known faces from the nearer face of the true door."""
    true_doors = truth.outline.doors
    ahead = np.array([np.cos(true_doors.normal[true]), np.sin(true_doors.normal[true])])
    faces = true_doors.centre[true] + np.outer((0.5, -0.5), ahead * true_doors.thickness[true])
    known = [face for face in (door.jambs, door.other_face) if face is not None]
    p_map = np.array([belief.p_map[belief.rows(np.array(face))].mean(axis=0) for face in known])
    return float(cdist(to_map(T_world_map, p_map), faces).min(axis=1).mean())


def covers(truth: GroundTruth, grid: SemanticGrid, T_world_map: Array) -> tuple[float, float]:
    """Share of the true free area that lies under polygons, and share that the grid calls FREE or DOOR."""
    p_map = to_map(inverse(T_world_map), truth.centres[truth.free])
    free = np.isin(labels_at(grid, p_map), (int(Cell.FREE), int(Cell.DOOR)))
    return float(cells_at(grid.polygon, grid.origin, grid.resolution_m, p_map, False).mean()), float(free.mean())


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
    return grid.origin + (metric_arrays.room_middles(grid.room, rooms) + 0.5) * grid.resolution_m


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
    return cells_at(grid.label, grid.origin, grid.resolution_m, p_map, np.uint8(Cell.UNKNOWN))


def cells_at(layer: NDArray[Any], corner: Array, cell_m: float, points: Array, outside: Any) -> NDArray[Any]:
    """(n,) the values of a raster (H,W) with its lower left corner (2,) at points (n,2) of the same frame."""
    cells = np.floor((points - corner) / cell_m).astype(np.int64)
    rows, cols = layer.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
    values = np.full(len(points), outside, layer.dtype)
    values[inside] = layer[cells[inside, 1], cells[inside, 0]]
    return values


def nearest_pairs(far: Array, gate: float) -> list[tuple[int, int]]:
    """Pairs (row, column) nearest first, one to one, none as far as `gate`; nan is never near."""
    near = np.argwhere(far < gate)
    pairs: dict[int, int] = {}
    for row, column in near[np.argsort(far[far < gate], kind="stable")].tolist():
        if row not in pairs and column not in pairs.values():
            pairs[row] = column
    return list(pairs.items())
