"""The laser: rays against a brute-force twin, noise as named, sweeps interleaved."""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scipy.stats import norm

from mecp_env.world import laser as module
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.outline import Outline, random_free_pose
from tests.slam.scans import cast
from tests.world.rays import cast_rays

Array = NDArray[np.float64]
IDEAL = LaserConfig(preset="ideal", sweeps=1)
SLANTED: dict[str, Any] = {"range_sigma_m": 0.0, "bearing_sigma_deg": math.degrees(0.03)}


def brute_force(segments: Array, pose: Array, bearings: Array) -> Array:
    """Range (B,) along each bearing: every ray against every face, from whichever side."""
    ranges: Array = cast(segments - pose[:2], pose[2] + bearings)
    return ranges


def poses(outline: Outline, count: int, seed: int = 0) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [random_free_pose(outline, rng, 0.22) for _ in range(count)]


def check(outline: Outline, fields: dict[str, Any], seed: int = 0, mounting: Any = lambda pose: pose) -> None:
    """Each beam of scans with these settings has the range of its true direction, from where the laser is."""
    laser, sigma = Laser(outline, LaserConfig(**fields)), math.radians(fields.get("bearing_sigma_deg", 0.0))
    for number, pose in enumerate(poses(outline, 4, seed=seed)):
        scan = laser.scan(pose, np.random.default_rng(number))
        noise = bearing_noise(number, scan.bearings.size).reshape(-1, len(scan.bearings)).T
        far = laser.config.max_range_m
        for ranges, hit, bearings in zip(scan.ranges, scan.hit, scan.bearings + sigma * noise, strict=True):
            true = brute_force(outline.segments, mounting(pose), bearings)
            np.testing.assert_allclose(ranges, np.minimum(true, far), rtol=1e-6)
            assert np.array_equal(hit, true < far)


def on_its_mounting(pose: Array) -> Array:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose + np.array([0.15 * c + 0.1 * s, 0.15 * s - 0.1 * c, math.radians(75.0)])


def test_rays_agree_with_the_brute_force_twin(outline: Outline) -> None:
    """With large bearing noise too, where no face is missed at its ends, nor a beam at the ends of the view."""
    check(outline, {"preset": "ideal", "sweeps": 4, "max_range_m": 2.5})
    check(outline, SLANTED | {"sweeps": 2}, seed=2)
    check(outline, SLANTED | {"sweeps": 1, "beams": 90, "field_of_view_deg": 200.0}, seed=9)
    mounting = {"x_m": 0.15, "y_m": -0.1, "heading_deg": 75.0}
    check(outline, {"preset": "ideal", "sweeps": 1} | mounting, 10, on_its_mounting)


def bearing_noise(seed: int, count: int) -> NDArray[np.float32]:
    """(N,) in sigmas, of the first scan of a generator, which draws quantiles of bearings and then of ranges."""
    quantiles = np.random.default_rng(seed).integers(module.QUANTILES, size=(2, count), dtype=np.uint16)[0]
    return np.clip(norm.ppf((quantiles + 0.5) / module.QUANTILES), -4.0, 4.0).astype(np.float32)


@pytest.mark.parametrize(("view", "sweeps"), [(360.0, 8), (359.0, 4), (33.0, 1)])
def test_beams_are_within_the_view_and_sweeps_are_interleaved(two_rooms: Outline, view: float, sweeps: int) -> None:
    fields = {"preset": "ideal", "sweeps": sweeps, "beams": 181, "field_of_view_deg": view}
    check(two_rooms, fields, seed=8)
    scan = Laser(two_rooms, LaserConfig(**fields)).scan(np.array([2.0, 2.0, 1.0]), np.random.default_rng(0))
    step, burst = math.radians(view) / (181 * sweeps), scan.bearings.T.ravel()
    assert scan.ranges.shape == (sweeps, 181)
    assert burst[[0, -1]] == pytest.approx([step - math.radians(view) / 2.0, math.radians(view) / 2.0])
    assert np.diff(burst) == pytest.approx(np.full(181 * sweeps - 1, step))


def test_rays_through_vertices_and_in_line_with_walls_find_a_wall(outline: Outline) -> None:
    """None slips through between two faces."""
    inner, lines = outline.free_area.buffer(-0.01), np.unique(outline.segments[:, 0, 0])
    in_line = [(x, y) for x in lines for y in (2.0, 7.6, 11.0) if inner.contains(shapely.Point(x, y))]
    for x, y in [*in_line, *(pose[:2] for pose in poses(outline, 5, seed=3))]:
        for vertex in outline.segments[:, 0]:
            heading = math.atan2(vertex[1] - y, vertex[0] - x)
            assert np.isfinite(cast_rays(outline.segments, np.array([x, y, heading]), beams=4)).all()
        assert np.isfinite(cast_rays(outline.segments, np.array([x, y, 0.0]))).all()


def test_faces_are_seen_from_their_left_only_in_any_order(paper: Outline) -> None:
    pose, shuffled = poses(paper, 1)[0], np.random.default_rng(0).permutation(paper.segments)
    assert np.array_equal(cast_rays(paper.segments, pose), cast_rays(shuffled, pose))
    wall = np.array([[[2.0, -1.0], [2.0, 1.0]]])
    assert cast_rays(wall, np.zeros(3), beams=8)[3] == pytest.approx(2.0)
    assert np.isinf(cast_rays(wall[:, ::-1], np.zeros(3), beams=8)).all()


@pytest.mark.parametrize("sigma", [0.05, 0.01])
def test_the_range_noise_is_as_named(two_rooms: Outline, sigma: float) -> None:
    """On beams square to a wall, where the bearing noise does not matter."""
    laser, rng = Laser(two_rooms, LaserConfig(range_sigma_m=sigma)), np.random.default_rng(1)
    pose = np.array([2.0, 2.5, 0.0])
    square = np.abs(laser.scan(pose, rng).bearings) < math.radians(1.0)
    true = (5.0 - 0.06 - 2.0) / np.cos(laser.scan(pose, rng).bearings[square])
    errors = np.concatenate([laser.scan(pose, rng).ranges[square] - true for _ in range(400)]) / sigma
    assert errors.mean() == pytest.approx(0.0, abs=4.0 / math.sqrt(len(errors)) + 0.01)
    assert errors.std() == pytest.approx(1.0, abs=0.03)
    assert np.mean(np.abs(errors) > 1.96) == pytest.approx(0.05, abs=0.01)


def test_the_bearing_noise_is_as_named(two_rooms: Outline) -> None:
    """On slanting beams the range errors grow by r tan(incidence) times the bearing's sigma."""
    laser, rng = Laser(two_rooms, LaserConfig(preset="paper")), np.random.default_rng(2)
    pose = np.array([2.0, 4.0, 0.0])
    bearings = laser.scan(pose, rng).bearings
    slanting = np.abs(bearings - math.radians(-150.0)) < math.radians(1.0)  # meets the west wall
    true = (2.0 - 0.075) / -np.cos(bearings[slanting])
    errors = np.concatenate([laser.scan(pose, rng).ranges[slanting] - true for _ in range(400)])
    sigma = math.hypot(0.05, true.mean() * math.tan(math.radians(30.0)) * math.radians(0.3))
    assert errors.std() == pytest.approx(sigma, rel=0.03)


def test_line_of_sight_agrees_with_the_rays(outline: Outline) -> None:
    laser, points = Laser(outline, IDEAL), outline.corners.p_world
    for pose in poses(outline, 20, seed=7):
        away = points - pose[:2]
        distance = np.hypot(*away.T)
        free = brute_force(outline.segments, np.array([*pose[:2], 0.0]), np.arctan2(away[:, 1], away[:, 0]))
        clear = np.abs(free - distance + 1e-3) > 1e-6  # not at the very border of what counts as seen
        assert np.array_equal(laser.visible(points, pose)[clear], (free > distance - 1e-3)[clear])
