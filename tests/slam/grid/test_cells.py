"""Filling and flooding of the grid against brute force: cell centres in polygons, pockets of unknown cells."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mecp_env.slam.grid import cells
from mecp_env.slam.grid.canvas import apart_from, find_pockets
from mecp_env.slam.messages import Cell
from tests.slam import make

FREE, OCCUPIED, DOOR = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.DOOR)


@pytest.mark.parametrize("seed", range(20))
def test_a_polygon_covers_the_cells_whose_centre_it_contains(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width, lattice = 30, 41, np.array([-7, 12])
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 12)))
    reach = rng.uniform(1.0, 25.0, len(angle))  # partly outside of the grid
    ring = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1) + lattice + rng.uniform(5.0, 25.0, 2)
    columns, rows = np.meshgrid(np.arange(width) + 0.5 + lattice[0], np.arange(height) + 0.5 + lattice[1])
    inside = np.array(shapely.contains_xy(shapely.Polygon(ring).buffer(0.0), columns, rows))
    raster = make.raster(height, width, lattice)
    layer = np.full((height, width), 5, np.int16)
    cells.fill_polygon(layer, ring, cells.ADD, 2, raster)
    assert (layer == np.where(inside, 7, 5)).all()
    assert not raster.mask.any()
    touched = np.argwhere(inside)
    if len(touched):
        assert (raster.dirty[[0, 2]] <= touched.min(axis=0)).all()
        assert (raster.dirty[[1, 3]] > touched.max(axis=0)).all()
    cells.fill_polygon(layer, ring, cells.CLEAR, 7, raster)
    assert (layer == np.where(inside, -1, 5)).all()
    cells.fill_polygon(layer, ring, cells.SET, 3, raster)
    assert (layer == np.where(inside, 3, 5)).all()


def flooded(label: np.ndarray, room: np.ndarray, complete: np.ndarray) -> np.ndarray:
    """(H,W) the pockets, by a flood fill cell by cell."""
    pockets, seen = np.zeros(label.shape, np.bool_), np.zeros(label.shape, np.bool_)
    for first in map(tuple, np.argwhere(label == 0)):
        if seen[first]:
            continue
        seen[first], part, rooms, closed = True, [first], set(), True
        for row, column in part:
            for at in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
                if not (0 <= at[0] < label.shape[0] and 0 <= at[1] < label.shape[1]) or label[at] == DOOR:
                    closed = False
                elif label[at]:
                    rooms |= {int(room[at])} - {-1}
                elif not seen[at]:
                    seen[at] = True
                    part.append(at)
        if closed and len(rooms) == 1 and min(rooms) < len(complete) and complete[min(rooms)]:
            pockets[tuple(np.array(part).T)] = True
    return pockets


@pytest.mark.parametrize("seed", range(5))
def test_pockets_are_unknown_cells_within_one_complete_room(seed: int) -> None:
    rng, found = np.random.default_rng(seed), 0
    for _ in range(40):
        label = rng.choice(
            np.array([0, FREE, OCCUPIED, DOOR], np.uint8), rng.integers(3, 25, 2), p=[0.3, 0.3, 0.37, 0.03]
        )
        room = np.where(label > 0, rng.choice([-1, 0, 1], label.shape, p=[0.2, 0.75, 0.05]), -1).astype(np.int16)
        complete = rng.random(rng.integers(0, 3)) < 0.8
        expected = flooded(label, room, complete)
        assert (find_pockets(label, room, complete) == expected).all()
        found += int(expected.any())
    assert found > 5


def test_a_pocket_beside_the_laser_is_where_the_robot_stands():
    """A laser with a blind side does not see the floor under the robot; other pockets become walls."""
    pockets = np.zeros((8, 10), np.bool_)
    pockets[2:4, 2:4] = pockets[5:7, 7:9] = True
    beside = np.array([[4, 4], [40, -3]])  # column and row, the second one outside of the grid
    kept = apart_from(pockets, beside)
    assert not kept[:4].any()
    assert kept[5:7, 7:9].all()
    assert (apart_from(pockets, np.array([[5, 2]])) == pockets).all()


def narrowed(wall: np.ndarray, quad: np.ndarray) -> bool:
    """Plain twin: some line across the door has no run of cells without a wall that is half as long as the line."""
    count, lines = (int(np.ceil(2.0 * np.hypot(*(quad[corner] - quad[0])))) for corner in (1, 3))
    for deep in (np.arange(lines) + 0.5) / lines:
        right, left = quad[0] + deep * (quad[3] - quad[0]), quad[1] + deep * (quad[2] - quad[1])
        at = np.floor(right + ((np.arange(count) + 0.5) / max(count, 1))[:, None] * (left - right)).astype(int)
        free = "".join("#" if wall[row, column] else "." for column, row in at).split("#")
        if 2 * max(map(len, free)) < count:
            return True
    return False


@pytest.mark.parametrize("seed", range(20))
def test_a_door_is_walled_up_where_no_half_of_it_is_free(seed: int) -> None:
    rng, lattice = np.random.default_rng(seed), np.array([-20, 30])
    layers = np.zeros((7, 40, 50), np.int16)
    layers[cells.HITS], layers[cells.FREE] = rng.integers(0, 2 + seed % 3, (2, 40, 50))
    layers[cells.HITS] *= rng.random((40, 50)) < 0.4
    wall = (layers[cells.HITS] > 0) & (layers[cells.HITS] >= 0.34 * (layers[cells.FREE] + layers[cells.HITS]))
    right, turn = rng.uniform([15.0, 12.0], [30.0, 25.0], (30, 2)), rng.uniform(0.0, 2.0 * np.pi, 30)
    across = np.stack([np.cos(turn), np.sin(turn)], axis=1) * rng.uniform(0.0, 10.0, (30, 1))
    onward = 0.2 * across[:, ::-1] * [1.0, -1.0]
    quads = np.stack([right, right + across, right + across + onward, right + onward], axis=1)
    raster = make.raster(40, 50, lattice)
    expected = [narrowed(wall, quad) for quad in quads]
    assert cells.are_walled_up(layers, quads + lattice, 0.34, raster).tolist() == expected
    assert 0 < sum(expected) < 30
