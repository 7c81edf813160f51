"""The grid planner: clearance and paths against brute force, corners, doors."""

import math

import numpy as np
import pytest
import shapely
from scipy import ndimage, sparse

from mecp_env.core import grid_paths
from mecp_env.planning.config import PathsConfig
from mecp_env.planning.navigator import CostToGoField, cost_to_go_field
from mecp_env.slam.messages import Cell
from tests.slam import make

CONFIG = PathsConfig()
RADIUS_M = CONFIG.radius_m


def costs_from(label: np.ndarray, cell: tuple[int, int], tight: bool = False) -> CostToGoField:
    grid = make.grid(label, origin=(-1.0, 2.0))
    start = grid.origin + (np.array([cell[1], cell[0]]) + 0.5) * 0.1
    return cost_to_go_field(grid, np.array([*start, 0.3]), CONFIG, tight=tight)


def random_label(rng: np.random.Generator, height: int = 50, width: int = 80) -> np.ndarray:
    label = np.full((height, width), Cell.FREE, np.uint8)
    for _ in range(12):
        r, c = rng.integers(0, height - 6), rng.integers(0, width - 6)
        label[r : r + rng.integers(1, 8), c : c + rng.integers(1, 8)] = rng.choice([Cell.OCCUPIED, Cell.UNKNOWN])
    label[[0, -1], :] = label[:, [0, -1]] = Cell.OCCUPIED
    return label


@pytest.mark.parametrize("seed", range(5))
def test_clearance_is_the_distance_to_the_nearest_wall(seed: int) -> None:
    label = random_label(np.random.default_rng(seed))
    expected = np.minimum(ndimage.distance_transform_edt(label != Cell.OCCUPIED), 6.0)
    assert grid_paths.clearance(label, 6.0) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_the_field_is_dijkstra(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cost = grid_paths.cell_costs(label := random_label(rng), grid_paths.clearance(label, 6.0), 3.2, 6.0, 6.0)
    row, column = rng.choice(np.argwhere(cost > 0))
    total, step = grid_paths.cost_to_go(cost, int(row), int(column))
    assert (total == dijkstra(cost, int(row), int(column))).all()
    for r, c in rng.choice(np.argwhere(total < grid_paths.FAR), 20):
        cells = trace_back(step, int(r), int(c))
        assert cells[0].tolist() == [row, column]
        assert cells[-1].tolist() == [r, c]
        stride = np.abs(np.diff(cells, axis=0)).sum(axis=1)
        (length,) = grid_paths.path_lengths(total, step, np.array([[c + 0.5, r + 0.5, 0.1]]))
        assert length == (stride == 1).sum() * 10 + (stride == 2).sum() * 14


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_reached_cell_is_that_of_all_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    total = np.where(rng.random((30, 20)) < 0.5, rng.integers(0, 10**5, (30, 20)), grid_paths.FAR).astype(np.int32)
    row, column = np.indices(total.shape)
    for x, y, reach in rng.uniform((-2.0, -2.0, 0.2), (22.0, 32.0, 4.0), (200, 3)):
        far = np.hypot(column + 0.5 - x, row + 0.5 - y) + 1e-9 * total
        best = np.unravel_index(np.where(total < grid_paths.FAR, far, math.inf).argmin(), total.shape)
        expected = best if total[best] < grid_paths.FAR and far[best] < reach else (-1, -1)
        assert grid_paths.nearest_reached(total, x, y, reach) == expected


def trace_back(step: np.ndarray, row: int, column: int) -> np.ndarray:
    """(n,2) the cells, row and column, from the source to a reached cell."""
    cells = [(row, column)]
    while (k := step[cells[-1]]) != 8:
        cells.append((int(cells[-1][0] - grid_paths.DROW[k]), int(cells[-1][1] - grid_paths.DCOL[k])))
    return np.array(cells[::-1])


def dijkstra(cost: np.ndarray, row: int, column: int) -> np.ndarray:
    """The costs of all cells by SciPy: between the middles of cells, straight or diagonal, round no corner."""
    inner, number = np.pad(cost[1:-1, 1:-1].astype(np.int64), 1), np.arange(cost.size).reshape(cost.shape)
    edges = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = np.roll(inner, (-dr, -dc), (0, 1))
        passable = np.minimum.reduce([inner, there, np.roll(inner, -dr, 0), np.roll(inner, -dc, 1)]) > 0
        length = (7 if dr and dc else 5) * (inner + there)
        edges.append(np.stack([length, number, np.roll(number, (-dr, -dc), (0, 1))])[:, passable])
    length, here, there = np.concatenate(edges, axis=1)
    graph = sparse.coo_array((length, (here, there)), (cost.size, cost.size))
    total = sparse.csgraph.dijkstra(graph.tocsr(), directed=False, indices=number[row, column])
    return np.where(np.isinf(total), grid_paths.FAR, total).reshape(cost.shape)


@pytest.mark.parametrize("seed", range(10))
def test_no_path_cuts_a_corner_nearer_than_the_radius(seed: int) -> None:
    rng = np.random.default_rng(seed)
    label = random_label(rng)
    open_cells = np.argwhere(grid_paths.clearance(label, 6.0) > 4.0)
    open_cells = open_cells[label[tuple(open_cells.T)] == Cell.FREE]
    start = tuple(rng.choice(open_cells).tolist())
    costs = costs_from(label, start)
    reached = np.argwhere(costs.total < grid_paths.FAR)
    path = shapely.LineString(costs.path(tuple(rng.choice(reached).tolist())))
    assert shapely.distance(path, squares(label, Cell.OCCUPIED)).min() >= RADIUS_M
    unknown = squares(label, Cell.UNKNOWN)
    beyond_body = shapely.distance(unknown, shapely.Point(path.coords[0])) > RADIUS_M + 0.1
    assert shapely.length(shapely.intersection(path, unknown[beyond_body])).max(initial=0.0) < 0.02  # a corner's tip


def squares(label: np.ndarray, kind: Cell) -> np.ndarray:
    """The cells of a kind, as polygons in the map."""
    x, y = np.argwhere(label == kind)[:, ::-1].T * 0.1 + [[-1.0], [2.0]]
    return shapely.box(x, y, x + 0.1, y + 0.1)


def test_a_robot_leaves_the_floor_that_its_laser_does_not_see() -> None:
    """Unknown cells under its body are no obstacle, unlike those farther away."""
    label = np.full((40, 40), int(Cell.FREE), np.uint8)
    label[[0, -1]] = label[:, [0, -1]] = int(Cell.OCCUPIED)
    label[19:22, 19:22] = int(Cell.UNKNOWN)
    label[19:22, 30:33] = int(Cell.UNKNOWN)
    total = costs_from(label, (20, 20)).total
    assert total[5, 5] < grid_paths.FAR
    assert total[20, 31] == grid_paths.FAR


def room_with_gap(cells: int) -> np.ndarray:
    """Two rooms with a gap of some cells between them."""
    label = np.full((40, 60), Cell.FREE, np.uint8)
    label[[0, -1], :] = label[:, [0, -1]] = Cell.OCCUPIED
    label[:, 30] = Cell.OCCUPIED
    label[15 : 15 + cells, 30] = Cell.DOOR
    return label


def test_the_way_through_a_door_is_in_its_middle_and_through_one_drawn_too_narrow_only_a_tight_one_leads() -> None:
    costs = costs_from(room_with_gap(9), (5, 10))
    path = costs.path(costs.nearest(np.array([4.05, 2.55]), 0.3))
    assert abs(np.interp(2.05, path[:, 0], path[:, 1]) - (2.0 + 1.95)) < 0.11
    unknown = room_with_gap(9)
    unknown[:, 35:50] = Cell.UNKNOWN
    for label, tight, passes in (
        *((room_with_gap(8), False, True), (room_with_gap(5), False, False), (unknown, False, False)),
        *((room_with_gap(5), True, True), (room_with_gap(3), True, False)),  # 3: too narrow for the robot
    ):
        assert (costs_from(label, (20, 10), tight).nearest(np.array([3.55, 4.05]), 0.3) is not None) == passes


def test_a_robot_in_a_niche_gets_out_though_the_first_step_is_a_diagonal() -> None:
    """Seen in `furnished`: the free cells around it are nearer to walls by less than a cell; no goal was left."""
    label = np.full((30, 30), Cell.FREE, np.uint8)
    label[:10, 14:] = label[4:9, 13] = label[:, 18:] = Cell.OCCUPIED  # the niche: a box, a wall beside it
    label[14, :5] = label[15, 4:12] = label[16, 10:18] = Cell.OCCUPIED  # a slanted wall on its other side
    costs = costs_from(label, (12, 12))
    assert (costs.total[2:10, 2:9] < grid_paths.FAR).all()


def test_a_wall_on_the_path_is_noticed() -> None:
    label = np.full((40, 60), Cell.FREE, np.uint8)
    path = np.array([[5.0, 20.5], [55.0, 20.5]])
    assert not grid_paths.wall_on_path(label, path, np.zeros(2), 1.0, 2.2)
    label[22, 30] = Cell.OCCUPIED
    assert grid_paths.wall_on_path(label, path, np.zeros(2), 1.0, 2.2)
    assert not grid_paths.wall_on_path(label, path, np.zeros(2), 1.0, 1.9)
