import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from scipy import ndimage
from scipy.spatial.distance import cdist

from mecp_env.core.se2 import compose, inverse, to_map, to_robot
from mecp_env.core.sensors import LaserView
from mecp_env.evaluation import metric_arrays
from mecp_env.evaluation.ground_truth import (
    CELL_M,
    NO_OBSTACLES,
    DynamicObstacles,
    GroundTruth,
    correct_coverage,
    door_centres,
    doors_found,
    grid_iou,
    labels_at,
    nearest_pairs,
    room_centres,
    rooms_found,
)
from mecp_env.evaluation.metrics import AssociationLog, EpisodeMetrics
from mecp_env.slam.messages import Cell
from mecp_env.world.laser import line_of_sight
from mecp_env.world.layout import load_layout
from mecp_env.world.moving_obstacles import box_corners, moving_faces
from mecp_env.world.outline import build_outline, random_free_pose
from tests.env.helpers import episode_of, make
from tests.slam.make import belief, corners, door, graph, grid, match, output, polar


@pytest.fixture(scope="module", params=["two_rooms", "paper"])
def truth(request):
    return GroundTruth(build_outline(load_layout(request.param)), 30.0)


def test_what_the_robot_sees_is_what_has_a_line_of_sight(truth):
    rng = np.random.default_rng(0)
    for _ in range(5):
        pose = random_free_pose(truth.outline, rng, 0.3)
        seen = np.zeros_like(truth.free)
        new = truth.sweep(pose, seen)
        cells = np.ascontiguousarray(truth.centres[truth.free])
        visible = line_of_sight(truth.outline.segments, pose[0], pose[1], cells)
        agree = visible == seen[truth.free]
        assert new == seen.sum()
        assert not seen[~truth.free].any()
        assert agree.mean() > 0.985  # cells half behind an edge
        assert (visible & ~seen[truth.free]).sum() < 0.01 * visible.sum()
        assert truth.sweep(pose, seen) == 0


def test_with_half_a_view_only_what_is_ahead_is_seen(truth):
    half = GroundTruth(truth.outline, 30.0, LaserView(field_of_view_deg=180.0, x_m=0.1, heading_deg=90.0))
    pose = random_free_pose(truth.outline, np.random.default_rng(0), 0.3)
    pose[2] = 0.7
    seen, around = np.zeros_like(truth.free), np.zeros_like(truth.free)
    half.sweep(pose, seen)
    GroundTruth(truth.outline, 30.0, LaserView(x_m=0.1)).sweep(pose, around)
    left = to_robot(compose(pose, np.array([0.1, 0.0, np.pi / 2.0])), truth.centres[around])[:, 0]
    agree = seen[around] == (left > 0.0)
    assert not (seen & ~around).any()
    assert agree[np.abs(left) > CELL_M].all()


def recorded(corners, *steps):
    """The log after these steps: ids and decisions of corners, landmarks of the belief, true corners."""
    log = AssociationLog(corners)
    for number, (ids, decision, landmarks, true) in enumerate(steps, start=1):
        known = belief(p_map=np.zeros((len(landmarks), 2)), ids=landmarks)
        log.record(output(step=number, match=match(ids, decision), belief=known), np.array(true))
    return log


def test_association_counts_by_the_book():
    steps = [
        (([0, 1], [2, 2], [], [0, 1]), [0, 0, 0, 2]),  # two new ones: nothing was known
        (([0, 1], [1, 1], [0, 1], [0, 1]), [0, 0, 0, 4]),  # provisional; they become landmarks
        (([0, 1], [0, 0], [0, 1], [0, 1]), [2, 0, 0, 4]),  # both right
        (([1, 2], [0, 2], [0, 1], [0, 1]), [2, 1, 1, 4]),  # 0 paired with 1; 1 taken for new
        (([0, -1], [0, 3], [0, 1], [-1, -1]), [2, 2, 1, 5]),  # spurious paired; spurious ignored
    ]
    for number, (_, counts) in enumerate(steps, start=1):
        assert recorded(4, *(step for step, _ in steps[:number])).counts.tolist() == counts
    assert recorded(4, *(step for step, _ in steps)).final_counts().tolist() == [2, 2, 1, 5]


def test_a_post_that_is_only_named_is_not_missed():
    """A corner with the id of a feature of the map that is no landmark (`use_posts` off) is no missed pair."""
    steps = [([0, 1], [2, 2], [0, 1], [0, 1]), ([0, 1], [0, 1], [0, 1], [0, 1])]  # the last is a post, and named
    log = recorded(2, *steps)
    assert log.counts.tolist() == log.final_counts().tolist() == [1, 0, 0, 3]
    log = recorded(2, *steps, ([0, 2], [0, 2], [0, 1], [0, 1]))  # here it was taken for new
    assert log.counts.tolist() == log.final_counts().tolist() == [2, 0, 1, 3]


def test_identity_is_the_majority_not_the_birth_and_two_of_one_are_duplicates():
    log = recorded(3, ([0], [2], [0], [2]), *[([0], [0], [0], [1])] * 4)  # born from a jamb taken for corner 2
    assert log.features[0, 0] == 1
    assert log.counts.tolist()[:2] == [3, 1]  # at the time: a tie is for the earlier
    assert log.final_counts().tolist() == [4, 0, 0, 1]
    log = recorded(3, ([0, 1, 2, 3], [2, 2, 2, 2], [0, 1, 2, 3], [0, 0, 1, -1]))
    assert [log.duplicates(np.array(ids, np.int64)) for ids in ([0, 1, 2, 3], [1, 2, 3], [])] == [1, 0, 0]


def test_nees_of_the_pose():
    rng, none = np.random.default_rng(0), np.zeros(3)
    a = rng.normal(size=(3, 3))
    cov, error = a @ a.T + np.eye(3), rng.normal(size=3)
    assert metric_arrays.pose_errors(error, none, cov)[2] == pytest.approx(error @ np.linalg.solve(cov, error))
    assert metric_arrays.pose_errors(none, none, 0.0 * cov)[2] == 0.0
    for unsound in (-cov, 0.0 * cov, np.nan * cov):
        assert metric_arrays.pose_errors(error, none, unsound)[2] == 1e9


def nothing_seen(believed):
    """A step in which no corner was seen."""
    return output(corners=corners(), match=match([]), belief=believed, graph=graph(), grid=grid(np.zeros((0, 0))))


def test_the_pose_error_is_measured_in_the_map_frame(truth):
    start = np.array(truth.outline.starts[0])
    metrics = EpisodeMetrics.begin(truth, start)
    moved, seen = compose(start, np.array([1.0, 0.5, 3.0])), nothing_seen(belief((1.03, 0.46, -3.2), pose_cov=0.01))
    metrics.look(truth, moved, seen)
    assert np.allclose(metrics.T_map_robot, [1.0, 0.5, 3.0])
    assert metrics.pose_error_m == pytest.approx(0.05)
    assert metrics.heading_error_rad == pytest.approx(2 * math.pi - 6.2)


def perfect_map(truth, T_world_map, resolution=0.1):
    """A perfect grid, graph and belief; the map frame is rotated relative to the world frame."""
    outline = truth.outline
    p_map = to_map(inverse(T_world_map), shapely.get_coordinates(outline.free_area))
    low, high = p_map.min(axis=0) - 0.5, p_map.max(axis=0) + 0.5
    x, y = np.meshgrid(*(np.arange(*ends, resolution) for ends in zip(low, high, strict=True)))
    p_world = to_map(T_world_map, np.column_stack([x.ravel(), y.ravel()]) + 0.5 * resolution)
    free = shapely.contains_xy(outline.free_area, *p_world.T).reshape(x.shape)
    room = np.where(free, outline.room_at(p_world).reshape(x.shape), -1).astype(np.int16)
    painted = grid(free, room, free, origin=low, resolution_m=resolution)
    centre, width, normal, d = outline.doors.centre, outline.doors.width, outline.doors.normal, len(outline.doors)
    half = 0.5 * width[:, None] * np.stack([-np.sin(normal), np.cos(normal)], axis=1)
    p_jambs = to_map(inverse(T_world_map), np.concatenate([centre - half, centre + half]))
    doors = tuple(door(i, (i, d + i), rooms=tuple(outline.doors.rooms[i].tolist())) for i in range(d))
    rooms = graph(rooms=tuple(range(len(outline.rooms))), doors=doors)
    return output(grid=painted, graph=rooms, belief=belief(p_map=p_jambs))


@pytest.mark.parametrize("T_world_map", [np.zeros(3), np.array([3.0, 2.0, 0.7])], ids=["straight", "turned"])
def test_a_perfect_map_gets_full_marks(truth, T_world_map):
    perfect = perfect_map(truth, T_world_map)
    assert rooms_found(truth, perfect, T_world_map) == (len(truth.outline.rooms), 0)
    assert doors_found(truth, perfect, T_world_map) == (len(truth.outline.doors), 0)
    assert grid_iou(truth, perfect.grid, T_world_map) > 0.95


def test_one_face_of_a_door_in_a_thick_wall_is_that_door(truth):
    """In the double walls of KTH floors, 0.7 m thick, half of the right doors counted as false."""
    doors = truth.outline.doors
    thick = SimpleNamespace(outline=SimpleNamespace(doors=replace(doors, thickness=np.full(len(doors.thickness), 0.7))))
    ahead = np.stack([np.cos(doors.normal), np.sin(doors.normal)], axis=1)
    aside = ahead[:, ::-1] * (1.0, -1.0)
    for offset, found in ((0.35 * ahead, True), (0.6 * ahead, True), (0.7 * ahead, False), (0.35 * aside, False)):
        known = belief(p_map=np.repeat(doors.centre + offset, 2, axis=0))
        seen = output(belief=known, graph=graph(doors=[door(i, (2 * i, 2 * i + 1)) for i in range(len(doors))]))
        assert doors_found(thick, seen, np.zeros(3))[0] == found * len(doors)


def test_false_doors_and_rooms_are_counted_once(truth):
    perfect = perfect_map(truth, np.zeros(3))
    doors = *perfect.graph.doors, door(99, perfect.graph.doors[0].jambs), door(98, (900, 901))
    more = replace(perfect, graph=graph(rooms=perfect.graph.rooms, doors=doors))
    assert doors_found(truth, more, np.zeros(3)) == (len(truth.outline.doors), 2)
    room = perfect.grid.room.copy()
    room[room == 1] = 0
    rows, cols = np.nonzero(room == 0)
    room[rows[: len(rows) // 4], cols[: len(cols) // 4]] = 77  # one room in two pieces, another one missing
    rooms = graph(rooms=(*range(len(truth.outline.rooms)), 77, 78))
    torn = output(grid=replace(perfect.grid, room=room), graph=rooms)
    found, false = rooms_found(truth, torn, np.zeros(3))
    assert found < len(truth.outline.rooms) + 1
    assert found + false == len(truth.outline.rooms)  # room 1 and room 78 have no cell


def test_the_centre_of_a_room_lies_as_deep_in_it_as_any_cell():
    """A U around another room: the cell nearest to its mean lay on the border, and counted for the room inside."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        room = np.full((40, 30), -1, np.int16)
        for number in range(4):
            row, column = rng.integers(1, 20, 2)
            room[row : row + rng.integers(4, 18), column : min(column + rng.integers(4, 18), 29)] = number
        painted = grid(np.ones(room.shape), room, resolution_m=1.0)
        for number in np.unique(room[room >= 0]).tolist():
            (x, y), *_ = room_centres(painted, np.array([number]))
            depth = ndimage.distance_transform_edt(np.pad(room == number, 1))[1:-1, 1:-1]
            assert room[int(y), int(x)] == number
            assert depth[int(y), int(x)] > 0.9 * depth.max() - 0.5
    assert np.isnan(room_centres(painted, np.array([9]))).all()
    assert room_centres(painted, np.empty(0, np.int64)).shape == (0, 2)


@pytest.mark.parametrize("seed", range(30))
def test_pairs_are_the_nearest_of_those_left(seed):
    rng, pose = np.random.default_rng(seed), np.array([0.5, 0.5, 0.0])
    a, b = rng.random((int(rng.integers(0, 9)), 2)), rng.random((int(rng.integers(0, 9)), 2))
    a[:1] = np.nan
    left, pairs = np.where(cdist(a, b) < 0.3, cdist(a, b), np.inf), []
    while np.isfinite(left).any():
        row, column = np.unravel_index(left.argmin(), left.shape)
        pairs.append((int(row), int(column)))
        left[row], left[:, column] = np.inf, np.inf
    assert sorted(nearest_pairs(cdist(a, b), 0.3)) == sorted(pairs)
    true = metric_arrays.identify_corners(polar(to_robot(pose, a)), pose, b, np.empty((0, 2, 2)), 0.3)
    assert [(row, column) for row, column in enumerate(true.tolist()) if column >= 0] == sorted(pairs)


def test_the_centre_of_a_door_takes_both_faces():
    known = belief(p_map=[[0, 0], [1, 0], [0, 2], [1, 2]], ids=[4, 7, 9, 2])
    centres = door_centres((door(0, (4, 7), (9, 2)), door(1, (4, 7)), door(2, (40, 1))), known)
    assert centres[:2].tolist() == [[0.5, 1.0], [0.5, 0.0]]
    assert np.isnan(centres[2]).all()
    assert door_centres((), known).shape == (0, 2)


def test_an_episode_adds_up_until_a_wrong_pose_makes_it_lost():
    env = make(estimator="slam")
    _, info = env.reset(seed=0)
    first, errors = info["correct_coverage"], []
    assert 0.1 < first < info["coverage"]
    for _ in range(30):
        *_, info = env.step(np.array([0.3, 0.5], np.float32))
        errors.append(info["pose_error_m"])
    summary = env.unwrapped.summary()
    assert (summary["periods"], summary["pose_error_final_m"], summary["lost"]) == (30, errors[-1], False)
    assert summary["pose_error_worst_m"] >= max(errors)
    assert 0.0 < summary["polygon_cover"] <= summary["grid_cover"] + 0.05
    assert 0.0 <= summary["door_error_m"] < 0.05
    assert all(math.isfinite(value) for value in summary.values())
    assert first < info["correct_coverage"] < info["coverage"]
    for area in ("correct_coverage_over_steps", "correct_coverage_over_metres"):
        assert first <= summary[area] < summary["correct_coverage"]
        assert info[area] == summary[area]
    assert 0.0 < info["map_error_m"] < 0.05
    episode_of(env).pipeline.filter.shift_pose(np.array([3.0, 0.0, 0.0]))
    info = env.step(np.zeros(2, np.float32))[-1]
    assert info["pose_error_m"] > 1.0
    assert info["lost"] is True


def test_the_error_of_the_map_is_measured_in_the_map_frame(truth):
    """A map that slid by 0.5 m, as after an unnoticed wrong pose, is 0.5 m wrong, however well its parts fit."""
    metrics, corners = EpisodeMetrics.begin(truth, np.array([1.0, 1.0, 0.5])), truth.outline.corners.p_world
    at = np.array([corners[0], corners[1] + [0.3, 0.4], corners[1], [1.0, 1.5]])
    metrics.association.features[:3, 0] = 0, 1, 1
    p_map = to_map(inverse(metrics.T_world_map), at)
    known = belief(p_map=p_map)
    rmse, false = metrics.map_error(truth, known)
    assert rmse == pytest.approx(0.5 / math.sqrt(3.0))
    assert false == 1
    assert metrics.association.duplicates(known.ids) == 1
    assert metrics.map_error(truth, belief(p_map=p_map[:1], ids=[10**6])) == (0.0, 1)
    assert EpisodeMetrics.begin(truth, np.zeros(3)).map_error(truth, known) == (0.0, 4)


def test_landmarks_where_somebody_walked_and_that_are_no_corner_sit_on_what_moves(truth):
    metrics = EpisodeMetrics.begin(truth, np.array([1.0, 1.0, 0.5]))
    corner = truth.outline.corners.p_world[0]
    for place in np.array([[2.0, 2.0, 0.25], [2.3, 2.0, 0.25], [*corner, 0.25]]):
        walking = NO_OBSTACLES._replace(walking=place[None])
        metrics.look(truth, np.array([1.0, 1.0, 0.5]), nothing_seen(belief()), walking)
    metrics.association.features[3:5, 0] = 0
    at = np.array([(2.0, 2.2), (2.6, 2.0), (2.0, 2.6), corner, corner + 0.05])
    p_map = to_map(inverse(metrics.T_world_map), at)
    known = belief(p_map=p_map)
    assert metrics.landmarks_on_movers(truth, known) == 2
    assert EpisodeMetrics.begin(truth, np.zeros(3)).landmarks_on_movers(truth, known) == 0


def test_the_corners_of_a_box_are_true_ones_where_they_are_seen(truth):
    pose, box, size = np.array([2.0, 2.0, 0.0]), np.array([[2.8, 2.0, 0.0]]), np.array([[0.4, 0.4]])
    at = box_corners(box, size)
    obstacles = DynamicObstacles(moving_faces(np.empty((0, 3)), box, size), at, np.empty((0, 3)))
    seen = corners(points=at - pose[:2])
    count = len(truth.outline.corners)
    assert sorted(truth.identify(seen, pose, obstacles)) == [-1, -1, count, count + 3]
    assert (truth.identify(seen, pose) == -1).all()


def test_correct_coverage_is_its_plain_twin(truth):
    rng, T_world_map = np.random.default_rng(0), np.array([1.0, 2.0, 0.4])
    floor = truth.floor_and_walls
    label = rng.choice(4, size=(70, 90), p=(0.2, 0.6, 0.05, 0.15)).astype(np.uint8)
    drawn = grid(label, origin=(-3.0, -2.5), resolution_m=0.13)
    occupied = drawn.origin + (np.argwhere(label == Cell.OCCUPIED)[:, ::-1] + 0.5) * drawn.resolution_m
    p_map, walls = (to_map(inverse(T_world_map), p) for p in (floor.p_world, floor.p_walls))
    known = cdist(walls, occupied).min(axis=1) <= 0.25
    free = np.isin(labels_at(drawn, p_map), (Cell.FREE, Cell.DOOR))
    expected = (free & known[floor.wall]).mean()
    assert 0.01 < expected < 0.9
    assert correct_coverage(floor, drawn, T_world_map) == expected
    assert correct_coverage(floor, perfect_map(truth, T_world_map).grid, T_world_map) == 0.0  # without a wall
    nearest = cdist(floor.p_world[:100], floor.p_walls)
    assert np.array_equal(nearest.min(axis=1), nearest[np.arange(100), floor.wall[:100]])


@pytest.mark.parametrize(("metres", "degrees"), [(1.01, 0.0), (0.0, 10.1), (0.0, -10.1)])
def test_lost_is_off_by_1_m_or_10_degrees_for_20_steps_or_at_the_end_or_diverged(metres, degrees):
    watch, lost = metric_arrays.LostWatch(), []
    for steps, share in ((3, 0.98), (19, 1.0), (1, 0.98), (20, 1.0), (4, 0.98)):
        for _ in range(steps):
            watch.look(share * metres, math.radians(share * degrees))
            lost.append(watch.is_lost(False))
    assert lost == [False] * 3 + [True] * 19 + [False] + [True] * 24
    assert metric_arrays.LostWatch().is_lost(True)
