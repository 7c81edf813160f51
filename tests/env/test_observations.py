import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from mecp_env.core.se2 import to_robot
from mecp_env.episode import observation_arrays, observations
from mecp_env.episode.observation_arrays import COLUMNS, COV_MAX, EXTENT_M, PREDICTED
from mecp_env.episode.observations import (
    GOALS,
    GRID,
    LANDMARKS,
    GridWindows,
    TravelledPath,
    make_space,
    rooms_after_merges,
)
from mecp_env.slam.messages import Belief, Cell
from tests.env.helpers import episode_of, started
from tests.slam import make as carriers

LAYER = {name: index for index, name in enumerate(observation_arrays.LAYERS)}


def random_grid(rng, rows=37, cols=53):
    label = rng.integers(0, 4, (rows, cols)).astype(np.uint8)
    return label, rng.random((rows, cols)) < 0.3, rng.integers(-1, 3, (rows, cols)).astype(np.int16)


def test_cell_codes_against_a_plain_twin():
    label, polygon, room = random_grid(np.random.default_rng(0))
    codes = observation_arrays.cell_codes(np.pad(label, 1), polygon, room, 1)
    layers = codes >> np.arange(8)[:, None, None] & 1
    unknown = np.pad(label == Cell.UNKNOWN, 1, constant_values=True)
    expected = {
        "free": np.isin(label, (Cell.FREE, Cell.DOOR)),
        "polygon": polygon,
        "occupied": label == Cell.OCCUPIED,
        "unknown": label == Cell.UNKNOWN,
        "door": label == Cell.DOOR,
        "room": room == 1,
        "frontier": (label == Cell.FREE) & ndimage.binary_dilation(unknown)[1:-1, 1:-1],
        "path": np.zeros_like(polygon),
    }
    for name, layer in expected.items():
        assert np.array_equal(layers[LAYER[name]], layer), name
    assert not (observation_arrays.cell_codes(np.pad(label, 1), polygon, room, -1) & observation_arrays.ROOM).any()


@pytest.mark.parametrize("width", [1, 2, 3, 8])
def test_pooling_against_a_plain_twin(width):
    rng = np.random.default_rng(1)
    codes = rng.integers(0, 128, (21, 17)).astype(np.uint8)
    padded = np.pad(codes, width - 1, constant_values=observation_arrays.UNKNOWN)
    pooled = observation_arrays.pool_codes(codes, width)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (width, width))
    assert np.array_equal(pooled, np.bitwise_or.reduce(windows, axis=(2, 3)))


def test_a_window_shows_what_lies_ahead_in_its_first_row_and_left_in_its_first_column():
    for heading in (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi):
        codes, pose = np.zeros((100, 100), np.uint8), np.array([5.05, 5.05, heading])
        c, s = round(math.cos(heading)), round(math.sin(heading))
        codes[50 + 4 * s, 50 + 4 * c] = observation_arrays.OCCUPIED  # ahead
        codes[50 + 3 * c, 50 - 3 * s] = observation_arrays.DOOR  # on the left
        path = pose[None, :2] - 0.4 * np.array([[c, s]])  # behind
        layers = observation_arrays.window_layers(codes, (0, 0, 100, 100), np.zeros(2), 0.1, pose, (9, 0.1), path)
        shown = sorted(map(tuple, np.argwhere(layers).tolist()))
        assert shown == sorted([(LAYER["occupied"], 0, 4), (LAYER["door"], 4, 1), (LAYER["path"], 8, 4)])


def belief_of(n: int) -> Belief:
    rng = np.random.default_rng(2)
    a = rng.normal(size=(n, 2, 2)) * 0.1
    covs = a @ a.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    return carriers.belief((1.0, -2.0, 2.5), rng.uniform(-20, 20, (n, 2)), pose_cov=1e-3, covs=covs)


@pytest.mark.parametrize("n", [60, LANDMARKS + 44])
def test_landmark_rows_against_a_plain_twin(n):
    """Where there are too many, the nearest are kept."""
    belief, rows = belief_of(n), np.zeros((LANDMARKS, 8), np.float32)
    merged = rooms_after_merges(carriers.graph(0, (0, 1, 2), merged={3: 1}))
    labels = (belief.ids, np.arange(n) % 4, np.arange(n) % 3, merged)
    observation_arrays.landmark_rows(belief.T_map_robot, belief.p_map, belief.covs, labels, rows)
    c, s = math.cos(belief.T_map_robot[2]), math.sin(belief.T_map_robot[2])
    turn, p_robot = np.array([[c, s], [-s, c]]), to_robot(belief.T_map_robot, belief.p_map)
    order = np.argsort(np.hypot(*p_robot.T))[:LANDMARKS]
    covs, shown = turn @ belief.covs @ turn.T, rows[: len(order)]
    assert np.allclose(shown[:, :2], p_robot[order], atol=1e-5)
    assert np.allclose(shown[:, 2:5], covs[order][:, [0, 0, 1], [0, 1, 1]], atol=1e-6)
    assert np.array_equal(shown[:, 5], np.where(order % 4 == 3, 1, order % 4))  # room 3 was merged into 1
    assert np.array_equal(shown[:, 6], order % 3)
    assert shown[:, 7].all()
    assert not rows[len(order) :].any()


def test_left_out_and_cut_values_are_counted_in_info():
    limits, rows = np.array([[9, -1, -1, -1], [9, 2, 2, 2]], np.float32), np.array([[np.nan, 3.0, -np.inf]], np.float32)
    assert observation_arrays.saturate(rows, limits, 1) == 3
    assert rows.tolist() == [[0.0, 2.0, -1.0]]
    env = started()
    episode = episode_of(env)
    far = belief_of(LANDMARKS + 5)
    far.p_map[:] = 2.0 * EXTENT_M
    far.covs[:, 0, 0] = 2.0 * COV_MAX
    episode.slam_output = replace(episode.slam_output, belief=far)
    episode.pipeline.map.features = carriers.features(LANDMARKS + 5)
    observation = env.observation()
    assert observation in env.observation_space
    assert episode.saturated >= 5 + 2 * LANDMARKS


def test_spaces_are_finite_of_the_promised_shapes_and_every_column_has_a_name():
    certain, uncertain = (make_space(True, 720, 30.0, uncertainty) for uncertainty in (False, True))
    shapes = {"budget": (1,), "pose": (4,), "pose_cov": (6,), "landmarks": (LANDMARKS, 8), "goals": (GOALS, 9)}
    shapes |= {"grid": (8, GRID[0], GRID[0]), "map": (8, 64, 64), "scan": (720,)}
    assert {name: box.shape for name, box in certain.items()} == shapes
    assert set(uncertain) == set(COLUMNS)
    assert {name: box.dtype for name, box in uncertain.items() if box.dtype != np.float32}.keys() == {"grid", "map"}
    for name, box in uncertain.items():
        assert np.isfinite([box.low, box.high]).all()
        columns = {"grid": box.shape[0], "map": box.shape[0], "scan": 1}.get(name, box.shape[-1])
        assert len(COLUMNS[name]) == columns, name
    assert COLUMNS["goals"][9:] == PREDICTED


@pytest.mark.parametrize("size", [(24, 0.2), (16, 0.8)])
def test_a_window_is_the_same_from_a_part_of_the_grid(size, monkeypatch):
    """Only the cells around the robot are coded; another block size takes another part."""
    rng = np.random.default_rng(3)
    label, polygon, room = random_grid(rng, 210, 330)
    grid = carriers.grid(label, room, polygon, origin=(-4.3, 2.1))
    trail = TravelledPath()
    for pose in rng.uniform((-9.0, -3.0, -3.0), (34.0, 28.0, 3.0), (40, 3)):
        output = carriers.output(grid=grid, belief=carriers.belief(pose), graph=carriers.graph(1))
        layers = []
        for block in (1000, 32, 1):
            monkeypatch.setattr(observations, "BLOCK", block)
            layers.append(GridWindows().layers(output, trail, size))
        assert np.array_equal(layers[0], layers[1])
        assert np.array_equal(layers[0], layers[2])
