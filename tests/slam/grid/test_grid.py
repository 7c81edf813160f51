"""The semantic grid against ground truth: bounds, thin walls, rooms, moved landmarks; cells against brute force."""

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from scipy import ndimage

from mecp_env.core.se2 import to_map
from mecp_env.slam.config import GridConfig, SensorModel
from mecp_env.slam.grid import cells
from mecp_env.slam.grid.canvas import find_pockets
from mecp_env.slam.grid.cells import split_outline
from mecp_env.slam.grid.key_scans import free_and_walls, seen_floor
from mecp_env.slam.messages import Cell, RoomGraph, SemanticGrid
from tests.slam import make
from tests.toy import LANDMARKS, Toy, free_iou, labels_at, layer_at, look

TOUR = [(1.0, 2.0), (3.0, 1.0), (5.0, 2.0), (5.5, 1.95), (6.06, 1.95), (6.6, 1.95), (8.0, 2.5)]
TOUR += [(x, 1.2 if x < 13.0 else 2.6) for x in np.arange(9.0, 32.0, 1.5)]
FREE, OCCUPIED, DOOR = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.DOOR)


def drive(toy: Toy, places: list[tuple[float, float]] = TOUR) -> Toy:
    for step, (x, y) in enumerate(places):
        toy.T_world_robot = np.array([x, y, 0.7 * step])
        toy.last = toy.output()
    return toy


def paint(toy: Toy, graph: RoomGraph, polygons: Any = ()) -> SemanticGrid:
    """The grid after a scan at the place of the robot, with other rooms than those of the toy."""
    belief = toy.belief()
    return toy.painter.paint(belief, *look(toy.T_world_robot), belief.ids, polygons, graph)


@pytest.fixture(scope="module")
def tour() -> Toy:
    return drive(Toy(np.array([1.0, 2.0, 0.0])))


def test_a_long_map_is_free_where_the_floor_is(tour: Toy) -> None:
    assert tour.last.grid.label.shape[1] > 256 > tour.last.grid.label.shape[0]
    assert free_iou(tour.last.grid) > 0.97
    assert labels_at(tour.last.grid, np.array([[30.0, 2.0], [2.0, 30.0]])).tolist() == [Cell.FREE, Cell.UNKNOWN]


@pytest.mark.parametrize("seed", range(2))
def test_a_thin_wall_stays_closed_under_noise(seed: int) -> None:
    toy = drive(Toy(np.array([1.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.3 * seed]), 0.05, 0.02, seed=seed), TOUR[:9] * 2)
    assert free_iou(toy.last.grid, toy.T_map_world, (0.0, 0.0, 8.0, 4.0)) > 0.95
    for y in np.concatenate([np.arange(0.1, 1.4, 0.02), np.arange(2.5, 3.9, 0.02)]):
        across = np.stack([np.arange(5.85, 6.27, 0.01), np.full(42, y)], axis=1)
        assert (labels_at(toy.last.grid, to_map(toy.T_map_world, across)) == Cell.OCCUPIED).any(), y


def test_a_door_is_open_until_a_scan_shows_the_wall_in_it() -> None:
    toy = Toy(np.array([3.0, 1.0, 0.0]))
    true, labels = toy.graph().doors[0], []
    doors = (true, replace(true, id=1, jambs=(5, 2), other_face=None))  # the second one is the wall beside the first
    for _ in range(3):
        grid = paint(toy, make.graph(doors=doors))
        labels.append(labels_at(grid, np.array([[6.06, 1.95], [6.06, 3.2]])).tolist())
    assert labels == [[Cell.DOOR, Cell.DOOR]] + [[Cell.DOOR, Cell.OCCUPIED]] * 2


def test_rooms_end_at_the_door(tour: Toy) -> None:
    grid = tour.last.grid
    x, y = np.meshgrid(np.arange(0.2, 31.9, 0.2), np.arange(0.2, 3.9, 0.2))
    p = np.stack([x.ravel(), y.ravel()], axis=1)
    p = p[(labels_at(grid, p) == Cell.FREE) & (np.abs(p[:, 0] - 6.06) > 0.3)]
    assert len(p) > 2000
    assert (layer_at(grid, grid.room, p) == (p[:, 0] > 6.06)).all()


def test_a_door_found_late_takes_the_room_off_what_was_seen_through_it() -> None:
    toy = Toy(np.array([2.0, 1.95, 0.0]))
    behind, before = np.array([[8.0, 1.95]]), np.array([[5.0, 1.95]])
    grid = paint(toy, make.graph())
    assert layer_at(grid, grid.room, behind) == [0]
    grid = paint(toy, toy.graph())
    assert layer_at(grid, grid.room, behind) == [-1]
    assert layer_at(grid, grid.room, before) == [0]


def test_merged_rooms_get_one_name(tour: Toy) -> None:
    toy = copy.deepcopy(tour)
    grid = paint(toy, make.graph(doors=toy.graph().doors, merged={1: 0}))
    assert set(np.unique(grid.room)) == {-1, 0}


def test_what_was_painted_since_a_room_was_entered_unnoticed_becomes_that_room() -> None:
    toy = Toy(np.array([1.0, 2.0, 0.0]))
    for x in (1.0, 3.0, 8.0, 9.0):
        toy.T_world_robot = np.array([x, 2.0, 0.0])
        paint(toy, make.graph())
    grid = paint(toy, make.graph(1, (0, 1), doors=toy.graph().doors, parted={1: (0, 3)}))
    places = np.array([[1.0, 1.0], [3.0, 3.0], [7.5, 1.0], [9.0, 3.0]])
    assert layer_at(grid, grid.room, places).tolist() == [0, 0, 1, 1]


def test_polygons_cover_their_interior_and_bring_their_room() -> None:
    toy = Toy(np.array([1.0, 2.0, 0.0]))
    toy.add_polygon([0, 1, 2, 3], 0)
    grid = toy.output().grid
    area = grid.polygon.sum() * grid.resolution_m**2
    assert area == pytest.approx(24.0, rel=0.02)
    all_landmarks, known, toy.p_map = toy.p_map, tuple(toy.polygons), toy.p_map[:2]
    toy.polygons.clear()
    assert not paint(toy, make.graph()).polygon.any()
    assert not paint(toy, make.graph(), known).polygon.any()  # it waits for its landmarks
    toy.p_map = all_landmarks
    assert paint(toy, make.graph(), known).polygon.any()


def test_a_loop_closure_redraws_the_map() -> None:
    toy = drive(Toy(np.array([1.0, 2.0, 0.0])))
    toy.add_polygon([0, 1, 2, 3], 0)
    toy.output()
    shift = np.array([0.9, -0.4, 0.05])
    toy.T_map_world, toy.p_map = shift, to_map(shift, LANDMARKS)
    grid = toy.output().grid
    assert free_iou(grid, shift) > 0.96
    assert labels_at(grid, to_map(shift, np.array([[6.06, 1.95]]))) == [Cell.DOOR]
    corners = to_map(shift, np.array([[0.1, 0.1], [5.9, 3.9], [6.3, 2.0]]))
    assert layer_at(grid, grid.polygon, corners).tolist() == [1, 1, 0]


def test_only_what_hangs_on_a_moved_landmark_moves() -> None:
    toy = drive(Toy(np.array([1.0, 2.0, 0.0])))
    before = toy.last.grid
    toy.p_map[8:] += 0.02  # less than half a cell
    assert (toy.output().grid.label == before.label).all()


def test_votes_taken_back_leave_nothing() -> None:
    toy = drive(Toy(np.array([1.0, 2.0, 0.3]), np.array([0.37, 0.11, 0.2])))
    there, back = toy.p_map + np.array([5.03, 2.01]), toy.p_map.copy()
    label = toy.last.grid.label.copy()
    toy.painter.p_landmark = np.empty((0, 2))
    for landmarks in (there, back):
        toy.p_map = landmarks
        grid = toy.output().grid
    offset = np.round((toy.last.grid.origin - grid.origin) / grid.resolution_m).astype(int)
    again = grid.label[offset[1] : offset[1] + label.shape[0], offset[0] : offset[0] + label.shape[1]]
    assert (again != label).mean() < 1e-3
    assert (grid.label != 0).sum() == pytest.approx((label != 0).sum(), abs=20)


def test_scans_whose_landmarks_are_gone_are_dropped() -> None:
    toy = drive(Toy(np.array([1.0, 2.0, 0.0])))
    beams, segments = look(toy.T_world_robot)
    emptied = make.belief(toy.T_world_robot)
    grid = toy.painter.paint(emptied, beams, segments, emptied.ids, (), make.graph(1, (0, 1)))
    assert labels_at(grid, np.array([[2.0, 2.0]])) == [Cell.UNKNOWN]
    assert len(toy.painter.scans.room) == 1


def test_a_pocket_of_a_completed_room_is_filled(tour: Toy) -> None:
    toy = copy.deepcopy(tour)
    pillar = np.array([[12.2, 2.0]])
    assert labels_at(toy.output().grid, pillar) == [Cell.UNKNOWN]
    assert labels_at(toy.output(completed=(1,)).grid, pillar) == [Cell.OCCUPIED]
    p = np.stack([np.arange(-0.9, 33.0, 0.1), np.full(339, 4.9)], axis=1)
    assert (labels_at(toy.output(completed=(0, 1)).grid, p) == Cell.UNKNOWN).all()  # the outside is not a pocket


def test_the_version_tells_when_a_cell_changed(tour: Toy) -> None:
    toy = copy.deepcopy(tour)
    first = toy.output().grid
    assert toy.output().grid is first
    toy.p_map = toy.p_map + 0.3
    assert toy.output().grid.version > first.version


def test_a_beam_without_return_clears_what_the_laser_is_sure_of() -> None:
    beams, segments = look(np.array([1.0, 2.0, 0.0]))
    empty = np.zeros(len(beams.hit), np.bool_)
    empty[::3] = True
    lost = replace(beams, hit=beams.hit & ~empty, ranges=np.where(empty, beams.max_range_m, beams.ranges))
    sure = SensorModel(no_return="unknown").free_without_return_m
    assert seen_floor(lost, SensorModel()) is lost
    weak = seen_floor(lost, SensorModel(no_return="unknown"))
    np.testing.assert_array_equal(weak.ranges, np.where(empty, sure, beams.ranges))
    outlines = [free_and_walls(scan, segments, GridConfig())[0] for scan in (lost, weak)]
    near = [(np.hypot(*outline.T) < sure + 1e-9).sum() for outline in outlines]
    assert near[0] == 0
    assert near[1] == empty.sum()


def test_free_space_is_cut_at_a_door() -> None:
    angle = np.linspace(-np.pi, np.pi, 361)[1:]
    outline = 5.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + 1.0
    eye, door = np.ones(2), np.array([[3.0, 0.5], [3.0, 1.7]])
    for ends in (door, door[::-1].copy()):
        front, behind = split_outline(outline, eye, ends)
        assert area(front) + area(behind) == pytest.approx(area(outline), rel=1e-9)
        inner = 0.5 * 2.0 * 1.2
        wedge = area(outline) * (np.arctan2(0.7, 2.0) + np.arctan2(0.5, 2.0)) / (2 * np.pi)
        assert area(behind) == pytest.approx(wedge - inner, rel=1e-3)
    unseen = np.array([[9.0, 0.5], [9.0, 1.7]])
    assert len(split_outline(outline, eye, unseen)[1]) == 0


def area(ring: np.ndarray) -> float:
    x, y = ring[:, 0], ring[:, 1]
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def test_asked_to_look_again_it_paints_a_scan_from_the_same_place() -> None:
    toy = Toy(np.array([2.0, 2.0, 0.0]))
    drive(toy, [(2.0, 2.0)])
    scans = len(toy.painter.scans.room)
    toy.painter.look_again()
    drive(toy, [(2.0, 2.0), (2.0, 2.0)])
    assert len(toy.painter.scans.room) == scans + 1


def test_a_pocket_that_a_scan_was_taken_in_is_no_wall(tour: Toy) -> None:
    """A laser with a blind side does not see the floor that the robot stands on."""
    toy = copy.deepcopy(tour)
    canvas, pillar, complete = toy.painter.canvas, np.array([[12.2, 2.0]]), np.array([False, True])
    outside = np.array([[-50.0, 3.0]])  # the grid
    for p_laser, label in ((np.array([[9.0, 1.2], *outside]), Cell.OCCUPIED), (pillar, Cell.UNKNOWN)):
        canvas.fill_pockets(complete, toy.painter.config.occupied_ratio, p_laser)
        assert labels_at(canvas.publish(toy.painter.config.occupied_ratio), pillar) == [label]


@pytest.mark.parametrize(("reach", "through"), [(4.0, True), (1.5, False)])
def test_an_edge_of_free_space_may_pass_behind_a_door_where_no_point_of_it_is(reach: float, through: bool) -> None:
    angle = np.radians([-20.0, 20.0, 140.0, -140.0])
    outline, door = reach * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.array([[2.0, -0.4], [2.0, 0.4]])
    assert bool(len(split_outline(outline, np.zeros(2), door)[1])) == through


def test_beams_that_fit_a_line_are_put_onto_it() -> None:
    beams, segments = look(np.array([3.0, 2.0, 0.0]), np.random.default_rng(0), 0.02)
    outline, _ = free_and_walls(beams, segments, GridConfig())
    assert len(outline) < 0.2 * len(beams.ranges)  # the ends of each line


def test_polygons_that_stayed_are_not_painted_again() -> None:
    toy = Toy(np.array([1.0, 2.0, 0.0]))
    toy.add_polygon([0, 1, 2, 3], 0)
    toy.add_polygon([8, 9, 10, 11], 1)
    toy.output()
    _, second = toy.painter.polygons.painted.values()
    toy.polygons.pop(0)
    toy.output()
    assert list(toy.painter.polygons.painted.values()) == [second]


@pytest.mark.parametrize("seed", range(4))
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


def flooded(label: np.ndarray, room: np.ndarray, complete: np.ndarray, stood: np.ndarray) -> np.ndarray:
    """(H,W) the pockets, part by part, each with what is around it; beyond the grid everything is open."""
    rows, columns = np.indices(label.shape)
    near = (np.abs(np.stack([columns, rows], axis=-1) - stood[:, None, None]).max(axis=-1) <= 1).any(axis=0)
    pockets, (parts, count) = np.zeros(label.shape, np.bool_), ndimage.label(label == 0)
    label, room = np.pad(label, 1, constant_values=DOOR), np.pad(room, 1, constant_values=-1)
    for part in (parts == k for k in range(1, count + 1)):
        around = ndimage.binary_dilation(np.pad(part, 1)) & ~np.pad(part, 1)
        rooms = set(room[around].tolist()) - {-1}
        closed = not (label[around] == DOOR).any() and len(rooms) == 1
        pockets |= part & (closed and min(rooms) < len(complete) and bool(complete[min(rooms)] & ~near[part].any()))
    return pockets


@pytest.mark.parametrize("seed", range(3))
def test_pockets_are_unknown_cells_within_one_complete_room(seed: int) -> None:
    rng, found = np.random.default_rng(seed), 0
    for _ in range(40):
        label = rng.choice(
            np.array([0, FREE, OCCUPIED, DOOR], np.uint8), rng.integers(3, 25, 2), p=[0.3, 0.3, 0.37, 0.03]
        )
        room = np.where(label > 0, rng.choice([-1, 0, 1], label.shape, p=[0.2, 0.75, 0.05]), -1).astype(np.int16)
        complete = rng.random(rng.integers(0, 3)) < 0.8
        stood = rng.integers(-2, 27, (rng.integers(0, 4), 2))
        expected = flooded(label, room, complete, stood)
        assert (find_pockets(label, room, complete, stood) == expected).all()
        found += int(expected.any())
    assert found > 5


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


@pytest.mark.parametrize("seed", range(4))
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
