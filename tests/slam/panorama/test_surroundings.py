"""What past scans show of the place, compiled, against finite differences and plain twins."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.core.se2 import compose, inverse, polar_to_points, to_map
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.messages import UNKNOWN_ROOM, FeatureState
from mecp_env.slam.panorama import is_in_room, marks_seen, poses_of_marks, rooms_like, seen_from
from mecp_env.slam.panorama.registration import surfaces_of
from mecp_env.slam.panorama.surroundings import are_new, moved_measurements, ranges_of
from tests.slam import make
from tests.slam.frontend.make import PAPER, front_end, on_walls
from tests.slam.scans import ring, take_scan

T = np.array([0.4, -0.3, 0.8])
MARKS = np.array([-2, -3])
TINY = np.eye(3) * 1e-12
POSE, SPREAD = (
    np.array([1.2, -0.4, 0.7]),
    np.array([[0.02, 0.003, 0.001], [0.003, 0.01, -0.002], [0.001, -0.002, 0.004]]),
)


def seen(z: np.ndarray, T_now_past: np.ndarray) -> np.ndarray:
    x, y = to_map(T_now_past, polar_to_points(z)).T
    return np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=1)


@pytest.mark.parametrize("count", [0, 4])
def test_moved_corners_have_the_covariance_of_measurement_and_pose(count):
    rng = np.random.default_rng(count)
    z, root = (
        np.stack([rng.uniform(1.0, 4.0, count), rng.uniform(-1.0, 1.0, count)], 1),
        rng.normal(size=(2 * count, 9)),
    )
    R = 1e-4 * root @ root.T
    moved, cov = moved_measurements(z, R, T, SPREAD)
    assert np.allclose(moved, seen(z, T))
    if count:
        by_z = make.slopes(lambda x: seen(x.reshape(-1, 2), T).ravel(), z.ravel())
        by_pose = make.slopes(lambda x: seen(z, x).ravel(), T)
        assert np.allclose(cov, by_z @ R @ by_z.T + by_pose @ SPREAD @ by_pose.T, rtol=1e-6, atol=1e-9)


def test_a_corner_is_new_outside_of_sight_and_away_from_those_taken():
    rng = np.random.default_rng(0)
    z = np.stack([rng.uniform(0.5, 4.0, 200), rng.uniform(-math.pi, math.pi, 200)], 1)
    taken = 3.0 * rng.normal(size=(20, 2))
    new, places = are_new(z, T, (-1.2, 1.3), taken, 0.4)
    points = to_map(T, polar_to_points(z))
    bearing, far = np.arctan2(points[:, 1], points[:, 0]), np.linalg.norm(points[:, None] - taken, axis=2)
    expected = ((bearing < -1.2) | (bearing > 1.3)) & ~(far < 0.4).any(axis=1)
    assert (new == expected).all()
    assert np.allclose(places, points[expected])
    assert 20 < expected.sum() < 180


def test_ranges_lie_on_the_lines_between_points_of_one_wall():
    rng, bearings = np.random.default_rng(0), np.sort(np.random.default_rng(1).uniform(-math.pi, math.pi, 300))
    points = to_map(np.zeros(3), rng.uniform(0.5, 3.0, (80, 1)) * rng.normal(size=(80, 2)))
    far, meets = ranges_of(points, bearings, 1.0)
    at = np.arctan2(points[:, 1], points[:, 0])
    order = np.argsort(at)
    apart = np.append(np.linalg.norm(np.diff(points[order], axis=0), axis=1), np.inf)
    left = np.searchsorted(at[order], bearings, side="right") - 1
    expected = (left >= 0) & (apart[left] < 1.0)
    assert (meets == expected).all()
    assert 20 < meets.sum() < 280
    assert np.allclose(far[meets], np.interp(bearings, at[order], np.hypot(*points[order].T))[meets])
    assert not ranges_of(np.empty((0, 2)), bearings, 1.0)[1].any()


def test_a_corner_is_in_the_room_of_its_feature_else_in_that_of_its_scan():
    ids, beyond = np.array([0, 1, 2, 3, -1, -1, -1]), np.array([-1, -1, -1, -1, -1, 2, -1])
    still = np.array([True, True, True, False, True, True, False])
    dead, alive = int(FeatureState.DEAD), int(FeatureState.LANDMARK)
    features = np.array([5, 6, 5, 5]), np.array([alive, alive, dead, alive])
    corners = ids, beyond, still
    assert is_in_room(corners, 5, features, np.array([5])).tolist() == [True, False, False, False, True, False, False]
    assert is_in_room(corners, 6, features, np.array([5, 6])).tolist() == [True, True, False, False, True, False, False]
    assert is_in_room(corners, UNKNOWN_ROOM, features, np.array([5])).tolist() == [True] + [False] * 6


def test_surfaces_are_hits_on_walls_with_the_normals_of_their_segments():
    body = ring((1.0, -0.2), (1.1, -0.2), (1.1, -0.1), (1.0, -0.1))
    faces = np.concatenate((ring((-2.0, -1.5), (3.0, -1.5), (3.0, 2.5), (-2.0, 2.5)), body))
    beams, clusters, segments, _ = front_end(take_scan(faces, seed=3, max_range_m=2.6))
    fewer = {name: getattr(segments, name)[1:] for name in ("points", "line", "cov", "cluster", "first", "last")}
    segments, wall = replace(segments, **fewer), on_walls(clusters, beams)  # a wall without a line is not flat
    found, normals = surfaces_of(beams, segments, wall, PAPER), np.zeros((len(beams.ranges), 2))
    for first, last, (alpha, _) in zip(segments.first, segments.last, segments.line, strict=True):
        normals[(segments.roll + np.arange(first, last + 1)) % len(normals)] = -math.cos(alpha), -math.sin(alpha)
    flat = normals.any(axis=1)
    solid = beams.hit & (wall | flat)
    sigmas = np.maximum(
        np.maximum(PAPER.range_sigma_m, PAPER.range_sigma_share * beams.ranges), PAPER.least_range_sigma_m
    )
    sigmas = sigmas / np.sqrt(np.maximum(beams.count, 1)) * np.where(flat, 1.0, PAPER.noise_sigmas)
    points = polar_to_points(np.stack([beams.ranges, beams.bearings], axis=1))
    assert np.array_equal(found.points, points[solid])
    assert np.array_equal(found.normals, normals[solid])
    assert np.allclose(found.sigmas, sigmas[solid], rtol=1e-15)
    assert 0 < flat[solid].sum() < solid.sum() < len(solid)


def test_corners_of_rooms_that_were_merged_into_the_present_one_are_of_it():
    graph = make.graph(2, (2, 4), merged={0: 1, 1: 2, 3: 4})
    new, none, still = np.full(1, -1), np.empty(0, np.int64), np.ones(1, dtype=bool)
    kept = [bool(is_in_room((new, new, still), room, (none, none), rooms_like(graph))[0]) for room in range(5)]
    assert kept == [True, True, True, False, False]


def drive(landmark_filter, increments, sigma_m=0.03, sigma_rad=0.02):
    landmark_filter.predict(make.odometry(increments, (sigma_m, sigma_rad)))


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
def test_a_clone_knows_the_motion_since(kind):
    drives = [[(0.5, 0.3), (0.4, -0.6)], [(0.2, 1.0)]]
    since = make_filter(FilterConfig(kind=kind, prior_sigma_m=1e-5, prior_sigma_rad=1e-6))
    for increments in drives:
        drive(since, increments)
    cloned = make_filter(FilterConfig(kind=kind))
    drive(cloned, [(2.0, 0.8), (1.0, -0.5)], 0.1, 0.1)  # before: it does not matter how uncertain the past pose is
    cloned.augment(*marks_seen(np.zeros(3), TINY), MARKS)
    for increments in drives:
        drive(cloned, increments)
    poses, covs = poses_of_marks(*cloned.marginal(MARKS))
    expected = since.belief()
    assert np.allclose(poses[0], expected.T_map_robot, atol=1e-9)
    assert np.allclose(covs[0], expected.pose_cov, atol=2e-6)


def test_the_covariance_of_marks_is_that_of_the_pose():
    J = make.slopes(lambda T: marks_seen(T, TINY)[0].ravel(), POSE)
    expected = J @ SPREAD @ J.T
    assert np.allclose(marks_seen(POSE, SPREAD)[1] - marks_seen(POSE, TINY)[1], expected, rtol=1e-5, atol=1e-8)


def test_the_inverse_motion_has_its_covariance():
    J = make.slopes(inverse, POSE)
    T_now_past, cov = seen_from(POSE, SPREAD)
    assert np.allclose(compose(T_now_past, POSE), 0.0, atol=1e-12)
    assert np.allclose(cov, J @ SPREAD @ J.T, atol=1e-8)


def test_poses_since_have_the_covariance_of_pose_and_marks():
    """Two past poses, whose marks are seen from afar and a little bent."""
    rng = np.random.default_rng(0)
    mean = np.array([1.0, 2.0, 0.4, 11.0, -1.0, -8.0, 3.0, 4.0, 12.0, 2.0, -7.5])
    root = rng.normal(size=(11, 30))
    cov = 1e-3 * root @ root.T
    poses, covs = poses_of_marks(mean, cov)
    for k in range(2):
        J = make.slopes(lambda x, k=k: poses_of_marks(x, cov)[0][k], mean)
        assert np.allclose(covs[k], J @ cov @ J.T, rtol=1e-5, atol=1e-7)
        middle, axis = 0.5 * (mean[3 + 4 * k : 5 + 4 * k] + mean[5 + 4 * k : 7 + 4 * k]), mean[3 + 4 * k : 5 + 4 * k]
        axis = axis - middle
        past = np.array([*middle, math.atan2(axis[1], axis[0])])
        assert np.allclose(compose(past, poses[k]), mean[:3])
